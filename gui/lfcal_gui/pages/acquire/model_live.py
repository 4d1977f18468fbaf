"""Content of the live view. No Qt."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire import LiveFrame
from lfcal.base import InputError, LfcalError, format_seconds
from lfcal.camera import Microscope, PupilLenslets, ScanPlan, StageAxes
from lfcal.frames import Position
from lfcal.psf import Cutout, PSFMatrix
from lfcal_gui.pages.acquire.model_station import Look, cut

if TYPE_CHECKING:
    from lfcal.targets import TargetPlan

LATE_S, LATE = 1.0, 3.0
"""The next frame is late after its exposure plus one second or three frame intervals, whichever is longer."""

SAME_UM = 1.0
"""Largest difference between read-backs of the same position (µm)."""


@dataclass(frozen=True, eq=False)
class LivePicture:
    """A live frame ready to be drawn.

    Attributes
    ----------
    frame
        Frame ``(rows, columns)``; None if none arrived.
    numbers, spot
        Lines of text: levels; position and sharpness of the light.
    stage_um
        Read-back position of the stage (µm).
    window, point
        First pixel and shape of the predicted cutout, and the predicted image (row, column).
    seen, predicted
        Measured light in the predicted cutout ``(nt, ns)``, above the background, and the expected
        light; None if unknown.
    correlation
        Normalised correlation of the two; NaN if there is none.
    first
        Sensor pixel (row, column) of the frame's first pixel.
    taken_s
        Time at which the frame was read, by `time.monotonic` (s).
    due_s
        Age of this frame at which the next one is due (s).
    caption, readout
        Text over the image: its name; rate, exposure, peak and saturated pixels.
    target
        Planned image positions of a target ``(n, 2)``.
    """

    frame: NDArray[Any] | None
    numbers: str
    spot: str
    stage_um: tuple[float, float, float]
    window: tuple[int, int, int, int] | None = None
    point: tuple[float, float] | None = None
    seen: NDArray[Any] | None = None
    predicted: NDArray[Any] | None = None
    correlation: float = math.nan
    first: tuple[int, int] = (0, 0)
    taken_s: float = 0.0
    due_s: float = math.inf
    caption: str = ""
    readout: str = ""
    target: NDArray[np.float64] | None = None


class Pace:
    """Frame rate, measured over the last frames."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=16)

    def add(self, now_s: float) -> None:
        """Count a frame; after a break the measurement restarts."""
        if self._times and now_s - self._times[-1] > 5.0:
            self._times.clear()
        self._times.append(now_s)

    @property
    def rate(self) -> float:
        """Frames per second; NaN before the second frame."""
        times = tuple(self._times)
        span = times[-1] - times[0] if len(times) > 1 else 0.0
        return (len(times) - 1) / span if span > 0 else math.nan

    def due_s(self, exposure_s: float) -> float:
        """Return the age (s) of a frame at which the next one is due."""
        return exposure_s + max(LATE_S, LATE / self.rate if self.rate > 0 else 0.0)


def readout_words(rate: float, exposure_s: float, maximum: int, saturated: int, pixels: int, plan: ScanPlan) -> str:
    """Return rate, exposure, peak and saturation of a frame as two lines of text."""
    sensor = plan.camera.sensor
    peak = (maximum - sensor.black_level) / (sensor.max_value - sensor.black_level)
    pace = f"{rate:.1f} frames/s   " if rate > 0 else ""
    share = 100 * saturated / pixels
    over = "0 saturated" if not saturated else f"{max(share, 0.001):.2g} % saturated"
    return f"{pace}{format_seconds(exposure_s)}\npeak {100 * max(peak, 0.0):.0f} % of range   {over}"


def live_picture(look: Look, plan: ScanPlan, reference: PSFMatrix | None, exposure_s: float, pace: Pace) -> LivePicture:
    """Return the drawing of a live frame; ``reference`` is an H from which cutouts are predicted."""
    state, now = look.state, time.monotonic()
    if look.frame is None or state.levels is None:
        return LivePicture(None, state.trouble or "no frame", "", state.stage_um)
    frame, levels = look.frame.data, state.levels
    pace.add(now)
    mean = float((levels.histogram * np.arange(len(levels.histogram))).sum()) / frame.size
    made = LivePicture(
        frame,
        f"median <b>{levels.quantile(0.5)}</b>, mean <b>{mean:.1f}</b> counts",
        _spot_words(look),
        state.stage_um,
        first=(look.frame.roi.row, look.frame.roi.column),
        taken_s=now,
        due_s=pace.due_s(exposure_s),
        caption="Live",
        readout=readout_words(pace.rate, exposure_s, levels.maximum, levels.saturated, frame.size, plan),
    )
    return made if state.expected_px is None else _with_cutout(made, state.expected_px, plan, reference)


def recorded_picture(
    frame: LiveFrame, recorded: ScanPlan | TargetPlan, reference: PSFMatrix | None, pace: Pace
) -> LivePicture:
    """Return the drawing of a recorded frame; all its parts belong to this frame."""
    plan, where, now = recorded.scan, frame.position, time.monotonic()
    pace.add(now)
    point, target = places_px(recorded, where) if frame.what == "position" else (None, None)
    exposure_s = plan.exposures[0 if where is None else where.z]
    caption, stage_um = f"{frame.what} frame", (math.nan, math.nan, math.nan)
    if target is not None and where is not None:
        caption = f"frame {where.x + 1}: {len(target)} points as planned"
    elif point is not None and where is not None:
        caption = f"plane {where.z}, position y {where.y}, x {where.x}"
    if point is not None and where is not None:
        x, y, z = plan.stage_um(np.array(where)).tolist()
        stage_um = (x, y, z)
    maximum = int(frame.data.max())
    made = LivePicture(
        frame.data,
        f"maximum <b>{maximum}</b> counts",
        "–",
        stage_um,
        first=(frame.roi.row, frame.roi.column),
        taken_s=now,
        due_s=pace.due_s(exposure_s),
        caption=caption,
        readout=readout_words(pace.rate, exposure_s, maximum, frame.saturated, frame.data.size, plan),
        target=target,
    )
    if frame.cutout is None or target is not None:
        return made
    made = replace(made, window=(frame.cutout.row, frame.cutout.column, *frame.cutout.shape), point=point)
    # rays of every position would take the time that it is recorded in
    if point is None or reference is None or reference.shape != plan.shape:
        return _compared(made, None)
    return _compared(made, predicted_pattern(plan, reference, stage_um, point))


def places_px(
    plan: ScanPlan | TargetPlan, position: Position | None
) -> tuple[tuple[float, float] | None, NDArray[np.float64] | None]:
    """Return the planned image positions (px) of the point, or of a target's points; None if unknown."""
    if position is None:
        return None, None
    if not isinstance(plan, ScanPlan):
        return None, points_px(plan, position)
    row, column = plan.image_px(position).tolist()
    return (row, column), None


def points_px(plan: TargetPlan, position: Position) -> NDArray[np.float64]:
    """Return the planned image positions of a target frame ``(n, 2)`` (row, column; px)."""
    if position.z >= len(plan.offsets_px) or position.x >= len(plan.offsets_px[position.z]):
        raise InputError.expected(
            "frame of the target",
            "a frame of the plan of this target",
            f"frame {position.x} of plane {position.z}",
            "open the session of this plan",
        )
    return plan.points(position.z, position.x).pixels


def stage_arrows(axes: StageAxes) -> tuple[tuple[str, float, float], ...]:
    """Return label and direction (down, right) for each of the two stage axes that move the image sideways.

    The direction is that of the image for a move in the positive direction of the axis.
    """
    found = []
    for axis, move in ((axes.right, (0.0, 1.0)), (axes.down, (1.0, 0.0))):
        sign = 1.0 if axis[0] == "+" else -1.0
        found.append((f"+{axis[1]}", sign * move[0] + 0.0, sign * move[1] + 0.0))
    return tuple(sorted(found))


def _spot_words(look: Look) -> str:
    spot = look.state.spot
    if spot is None:
        return "no light above the background: check lamp, exposure and position"
    lines = [
        f"centroid row <b>{spot.row:.2f}</b>, column <b>{spot.column:.2f}</b> px",
        f"sharpness <b>{spot.sharpness:.3f}</b>, SNR <b>{spot.snr:.0f}</b>",
    ]
    offset = look.state.offset_px
    if offset is not None:
        lines.append(f"measured − predicted <b>{offset[0]:+z.2f}</b>, <b>{offset[1]:+z.2f}</b> px")
    return "<br>".join(lines)


def _with_cutout(
    made: LivePicture, point: tuple[float, float], plan: ScanPlan, reference: PSFMatrix | None
) -> LivePicture:
    nt, ns = Cutout.for_plan(plan).reach
    row, column = math.ceil(point[0] - 0.5) - nt // 2, math.ceil(point[1] - 0.5) - ns // 2
    made = replace(made, window=(row, column, nt, ns), point=point)
    return _compared(made, predicted_pattern(plan, reference, made.stage_um, point))


def _compared(made: LivePicture, predicted: NDArray[Any] | None) -> LivePicture:
    """Return the drawing with the measured and ``predicted`` patterns and their correlation."""
    assert made.frame is not None and made.window is not None
    (top, left), (row, column, nt, ns) = made.first, made.window
    seen = cut(made.frame, row - top, column - left, (nt, ns)).astype(np.float32)
    border = np.concatenate([seen[0], seen[-1], seen[:, 0], seen[:, -1]])
    seen -= np.median(border)
    correlation = math.nan
    if predicted is not None and predicted.shape == seen.shape:
        power = float(np.linalg.norm(seen)) * float(np.linalg.norm(predicted))
        correlation = float((seen * predicted).sum()) / power if power > 0 else math.nan
    return replace(made, seen=seen, predicted=predicted, correlation=correlation)


def age_words(
    seconds: float, frame_um: tuple[float, float, float], stage_um: tuple[float, float, float]
) -> tuple[str, bool]:
    """Return the age of a frame as text, with its position (µm) if the stage has moved since, and whether it moved."""
    age = f"{seconds:.1f} s old" if seconds < 10 else f"{format_seconds(seconds)} old"
    if not max(abs(a - b) for a, b in zip(frame_um, stage_um, strict=True)) > SAME_UM:
        return age, False
    x, y, z = (f"{value:,.1f}".replace(",", "\N{THIN SPACE}") for value in frame_um)
    return f"{age}, from x {x}, y {y}, z {z} µm", True


def plane_at(plan: ScanPlan, depth_um: float) -> int | None:
    """Return the plane within half a step of a depth (µm); None if there is none.

    For a single plane, the step is a virtual depth of one half. With lenslets in the pupil, the step moves the
    outermost spot by two pixels.
    """
    depths = np.array(plan.depths_um)
    z = int(np.argmin(np.abs(depths - depth_um)))
    if depths.size > 1:
        step = float(np.abs(np.delete(depths, z) - depths[z]).min())
        return z if abs(depths[z] - depth_um) <= step / 2 else None
    camera, lattice = plan.camera, plan.camera.lattice
    if isinstance(lattice, PupilLenslets):
        assert isinstance(camera.optics, Microscope)
        farthest_px = np.hypot(*np.array(lattice.lens_centres_um).T).max() / camera.sensor.pixel_um
        return z if farthest_px * abs(lattice.spread(camera.optics, depth_um - depths[z])) <= 1 else None
    try:
        own, there = (camera.virtual_depth(float(d)) for d in (depths[z], depth_um))
    except (LfcalError, ZeroDivisionError):
        return None
    return z if abs(own - there) <= 0.25 else None


def expected_words(picture: LivePicture, plan: ScanPlan) -> str:
    """Return the correlation of a cutout with the prediction as text, or why there is no prediction."""
    if not math.isnan(picture.correlation):
        return f"correlation {100 * max(picture.correlation, 0.0):.1f} %"
    near = plane_to_go(picture, plan) is None
    return "" if near else "No plane of the plan is near this depth."


def plane_to_go(picture: LivePicture, plan: ScanPlan) -> int | None:
    """Return the nearest plane of the plan if the frame belongs to no plane, else None."""
    depth = float(plan.stage.to_object(np.array(picture.stage_um))[2])
    if not math.isfinite(depth) or plane_at(plan, depth) is not None:
        return None
    return int(np.argmin(np.abs(np.array(plan.depths_um) - depth)))


_last: list[tuple[Any, NDArray[Any] | None]] = []


def predicted_pattern(
    plan: ScanPlan, reference: PSFMatrix | None, stage_um: tuple[float, float, float], point: tuple[float, float]
) -> NDArray[Any] | None:
    """Return the pattern expected in the cutout at ``point`` (row, column), ``(nt, ns)``; None if unknown.

    It is the pattern at the nearest position of ``reference`` if that has the shape of the plan, else a simulation with
    rays. Between planes there is no prediction, because a pattern of another depth would make a correct rig look
    faulty.
    """
    depth = float(plan.stage.to_object(np.array(stage_um))[2])
    if plane_at(plan, depth) is None:
        return None
    if reference is not None and reference.shape == plan.shape:
        z = int(np.argmin(np.abs(np.array(plan.depths_um) - depth)))
        steps = [round((p - a) * f) for p, a, f in zip(point, plan.anchor, plan.resample_factors, strict=True)]
        y, x = (k % n for k, n in zip(steps, plan.period, strict=True))
        pattern: NDArray[Any] = reference[z, y, x]
        return pattern
    key = (id(plan), round(depth, 1), round(point[0], 2), round(point[1], 2))
    if not _last or _last[0][0] != key:
        _last[:] = [(key, _rays(plan, depth, point))]
    return _last[0][1]


def _rays(plan: ScanPlan, depth: float, point: tuple[float, float]) -> NDArray[Any] | None:
    from lfcal.simulate import simulate_psf

    try:
        one = replace(
            plan,
            depths_um=(depth,),
            exposure_s=plan.exposures[0],
            period=(1, 1),
            anchor=point,
            resample=False,
            cutout=Cutout.for_plan(plan).reach,
        )
        pattern: NDArray[Any] = simulate_psf(one, (), "geometric", workers=1)[0, 0, 0]
    except (LfcalError, ZeroDivisionError):
        return None
    return pattern
