"""What the live view shows of a frame. No Qt."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import LfcalError, format_length, format_seconds
from lfcal.camera import ScanPlan, StageAxes
from lfcal.psf import Cutout, PSFMatrix
from lfcal_gui.pages.acquire.model_station import Look, cut

__all__ = [
    "LivePicture",
    "age_words",
    "expected_words",
    "live_picture",
    "plane_at",
    "predicted_pattern",
    "stage_arrows",
]

BINS = 256
SAME_UM = 1.0
"""Read-backs of one place differ by less (um)."""


@dataclass(frozen=True, eq=False)
class LivePicture:
    """A live frame as it is drawn.

    Attributes
    ----------
    frame
        ``(rows, columns)``; None where none came.
    edges, counts
        True histogram of all pixels (counts).
    numbers, spot
        Lines for people: levels; place and sharpness of the light.
    saturated
        Pixels at the maximum, counted one by one.
    window, point
        First pixel and shape of the predicted cutout, and the predicted image (row, column).
    seen, predicted
        ``(nt, ns)`` what the camera sees in the predicted cutout, above the background, and what it should
        see; None where not known.
    correlation
        Normalised correlation of the two, NaN where there is none.
    first
        Pixel (row, column) of the sensor that is the frame's first.
    taken_s
        When the frame was read, by `time.monotonic` (s).
    """

    frame: NDArray[Any] | None
    edges: NDArray[np.float64]
    counts: NDArray[np.float64]
    numbers: str
    spot: str
    saturated: int
    stage_um: tuple[float, float, float]
    window: tuple[int, int, int, int] | None = None
    point: tuple[float, float] | None = None
    seen: NDArray[Any] | None = None
    predicted: NDArray[Any] | None = None
    correlation: float = math.nan
    first: tuple[int, int] = (0, 0)
    taken_s: float = 0.0


def live_picture(look: Look, plan: ScanPlan, reference: PSFMatrix | None) -> LivePicture:
    """Return what to draw of a live frame; ``reference`` is an H that says what a cutout should look like."""
    state, now = look.state, time.monotonic()
    if look.frame is None or state.levels is None:
        return LivePicture(None, np.zeros(1), np.zeros(0), state.trouble or "no frame", "", 0, state.stage_um)
    frame = look.frame.data
    histogram = state.levels.histogram
    step = max(1, -(-len(histogram) // BINS))
    padded = np.pad(histogram, (0, -len(histogram) % step))
    counts = padded.reshape(-1, step).sum(axis=1).astype(float)
    edges = np.arange(len(counts) + 1, dtype=np.float64) * step
    levels = state.levels
    mean = float((histogram * np.arange(len(histogram))).sum()) / frame.size
    numbers = f"maximum <b>{levels.maximum}</b>, median <b>{levels.quantile(0.5)}</b>, mean <b>{mean:.1f}</b> counts"
    spot, first = _spot_words(look), (look.frame.roi.row, look.frame.roi.column)
    made = LivePicture(frame, edges, counts, numbers, spot, levels.saturated, state.stage_um, first=first, taken_s=now)
    return made if state.expected_px is None else _with_cutout(made, state.expected_px, plan, reference)


def stage_arrows(axes: StageAxes) -> tuple[tuple[str, float, float], ...]:
    """Return for the two stage axes that move the image sideways the words and the direction (down, right).

    Each arrow shows where a move in the axis's positive sense moves the image.
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
        lines.append(f"seen − predicted <b>{offset[0]:+z.2f}</b>, <b>{offset[1]:+z.2f}</b> px")
    return "<br>".join(lines)


def _with_cutout(
    made: LivePicture, point: tuple[float, float], plan: ScanPlan, reference: PSFMatrix | None
) -> LivePicture:
    nt, ns = Cutout.for_plan(plan).reach
    row, column = math.ceil(point[0] - 0.5) - nt // 2, math.ceil(point[1] - 0.5) - ns // 2
    window = (row, column, nt, ns)
    assert made.frame is not None
    seen = cut(made.frame, row, column, (nt, ns)).astype(np.float32)
    border = np.concatenate([seen[0], seen[-1], seen[:, 0], seen[:, -1]])
    seen -= np.median(border)
    predicted = predicted_pattern(plan, reference, made.stage_um, point)
    correlation = math.nan
    if predicted is not None and predicted.shape == seen.shape:
        power = float(np.linalg.norm(seen)) * float(np.linalg.norm(predicted))
        correlation = float((seen * predicted).sum()) / power if power > 0 else math.nan
    return replace(made, window=window, point=point, seen=seen, predicted=predicted, correlation=correlation)


def age_words(
    seconds: float, frame_um: tuple[float, float, float], stage_um: tuple[float, float, float]
) -> tuple[str, bool]:
    """Return how old a frame is (s), and whether the stage (um) has left the place that the frame shows."""
    age = f"{seconds:.1f} s old" if seconds < 10 else f"{format_seconds(seconds)} old"
    if max(abs(a - b) for a, b in zip(frame_um, stage_um, strict=True)) <= SAME_UM:
        return age, False
    x, y, z = (f"{value:,.1f}".replace(",", "\N{THIN SPACE}") for value in frame_um)
    return f"{age}, from x {x}, y {y}, z {z} µm", True


def plane_at(plan: ScanPlan, depth_um: float) -> int | None:
    """Return the plane within half a step of a depth (um), None where there is none.

    Of a single plane the step is that of a virtual depth of one half.
    """
    depths = np.array(plan.depths_um)
    z = int(np.argmin(np.abs(depths - depth_um)))
    if depths.size > 1:
        step = float(np.abs(np.delete(depths, z) - depths[z]).min())
        return z if abs(depths[z] - depth_um) <= step / 2 else None
    try:
        own, there = (plan.camera.virtual_depth(float(d)) for d in (depths[z], depth_um))
    except (LfcalError, ZeroDivisionError):
        return None
    return z if abs(own - there) <= 0.25 else None


def expected_words(picture: LivePicture, plan: ScanPlan) -> str:
    """Return how well a cutout agrees with what is expected, or why nothing is expected there."""
    if not math.isnan(picture.correlation):
        return f"correlation {picture.correlation:.2f}"
    depth = float(plan.stage.to_object(np.array(picture.stage_um))[2])
    if plane_at(plan, depth) is not None or not math.isfinite(depth):
        return "correlation –"
    z = int(np.argmin(np.abs(np.array(plan.depths_um) - depth)))
    return f"nothing is expected at this depth: go to plane {z} at {format_length(plan.depths_um[z])}"


_last: list[tuple[Any, NDArray[Any] | None]] = []


def predicted_pattern(
    plan: ScanPlan, reference: PSFMatrix | None, stage_um: tuple[float, float, float], point: tuple[float, float]
) -> NDArray[Any] | None:
    """Return what the cutout at ``point`` (row, column) should show, ``(nt, ns)``; None where it is not known.

    The nearest position of ``reference`` if it belongs to the plan, else rays through the described camera. Between
    the planes of the plan nothing is expected: the pattern of another depth would make a sound rig look faulty.
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
