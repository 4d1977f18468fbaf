"""What the Acquire page shows: settings in, frozen pictures out. No Qt."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gui.models.project import SessionState
from gui.pages.acquire.model_station import Look, Station, cut
from gui.pages.camera.model import FieldSpec
from lfcal.acquire.options import Options
from lfcal.acquire.setup import OpticalAxis, StageFit, check_stage
from lfcal.camera import ScanPlan
from lfcal.errors import InputError, LfcalError
from lfcal.psf import PSFMatrix
from lfcal.psf.cutout import Cutout
from lfcal.units import format_length, format_seconds

__all__ = [
    "FIELDS",
    "AcquireSettings",
    "LivePicture",
    "axis_words",
    "exposure_words",
    "fit_words",
    "live_picture",
    "predicted_pattern",
]

KEY = "acquire"
BINS = 256
ORDERS = (("serpentine", "serpentine"), ("raster", "raster"), ("coarse", "coarse grid first"))

FIELDS = (
    FieldSpec(
        "order",
        "Order",
        kind="choice",
        choices=ORDERS,
        tip="Serpentine has no long way back; raster takes every row from the same side; coarse sees all "
        "planes on a grid first and fills it in later",
    ),
    FieldSpec("frames_averaged", "Frames averaged", "", "Exposures averaged at each position", kind="int"),
    FieldSpec(
        "bracket",
        "Exposures",
        "× plane's",
        "Factors of each plane's exposure, merged to a high dynamic range, 1 among them; 1 alone merges nothing",
        kind="floats",
    ),
    FieldSpec(
        "darks", "Dark frames", "", "Exposures averaged into each dark frame, light off; 0 records none", kind="int"
    ),
    FieldSpec(
        "dark_every",
        "Dark every",
        "pos.",
        "Dark frames again after so many positions; 0: at the start only",
        kind="int",
    ),
    FieldSpec(
        "reference_every",
        "Reference every",
        "pos.",
        "A frame of the same place every so many positions shows whether the lamp drifts; 0 records none",
        kind="int",
    ),
    FieldSpec(
        "controls",
        "Control frames",
        "",
        "Per plane and direction, whole periods away up to the field's edge: is the PSF periodic? 0 records none",
        kind="int",
    ),
    FieldSpec("retries", "Retries", "", "How often a position is tried again after a fault that may pass", kind="int"),
    FieldSpec(
        "margin_px", "Margin", "px", "Kept around the cutout; empty: as interpolation needs", kind="int", optional=True
    ),
    FieldSpec(
        "tolerance_um",
        "Tolerance xyz",
        "µm",
        "Largest difference of read-back and target; empty: a tenth of a step sideways, a step in depth",
        kind="floats",
    ),
    FieldSpec(
        "overshoot_um",
        "Approach xyz",
        "µm",
        "Moves in the negative sense go this far beyond first, so "
        "that the play of the drive is always taken up; 0 for none",
        kind="floats",
    ),
)


@dataclass(frozen=True)
class AcquireSettings:
    """What the user chose on this page; the plan holds the rest.

    Attributes
    ----------
    backend, stage
        Names of the device backend, and of the one whose stage is used with it (empty: its own).
    device_options
        Pairs of name and text for the backend.
    coarse
        Whether a coarse grid comes first.
    bracket, darks, dark_every, reference_every, controls, retries, margin_px, tolerance_um, overshoot_um
        As in `lfcal.acquire.options.Options`; an empty tolerance is the default.
    """

    backend: str = "sim"
    stage: str = ""
    device_options: tuple[tuple[str, str], ...] = ()
    coarse: bool = False
    bracket: tuple[float, ...] = (1.0,)
    darks: int = 0
    dark_every: int = 0
    reference_every: int = 0
    controls: int = 0
    retries: int = 2
    margin_px: int | None = None
    tolerance_um: tuple[float, ...] = ()
    overshoot_um: tuple[float, ...] = (20.0, 20.0, 20.0)

    def options(self) -> Options:
        """Return the options of a session; raises `InputError` if they do not go together."""
        return Options(
            "coarse" if self.coarse else "plan",
            self.bracket,
            self.margin_px,
            self.darks,
            self.dark_every,
            self.reference_every,
            self.controls,
            self.retries,
            self.tolerance_um or None,
            self.overshoot_um,
        )

    def values(self, plan: ScanPlan) -> dict[str, Any]:
        """Return the value of every field of the form."""
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        order = "coarse" if self.coarse else plan.order
        return {spec.key: own.get(spec.key) for spec in FIELDS} | {
            "order": order,
            "frames_averaged": plan.frames_averaged,
        }

    def changed(self, plan: ScanPlan, key: str, value: Any) -> tuple[AcquireSettings, ScanPlan]:
        """Return settings and plan with one field changed; raises `LfcalError` if it cannot be."""
        settings = self
        if key == "order":
            settings = replace(self, coarse=value == "coarse")
            plan = plan if value == "coarse" else replace(plan, order=value)
        elif key == "frames_averaged":
            plan = replace(plan, frames_averaged=value)
        else:
            settings = replace(self, **{key: value})
        settings.options().motion(plan)
        return settings, plan

    @classmethod
    def of(cls, state: SessionState) -> AcquireSettings:
        """Return the settings in a session."""
        return cls.from_dict(state.extra.get(KEY))

    def into(self, state: SessionState) -> dict[str, Any]:
        """Return what a session keeps of further stages, with these settings in it."""
        return {**state.extra, KEY: self.to_dict()}

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types."""
        data = asdict(self)
        return {
            k: [list(v) if isinstance(v, tuple) else v for v in x] if isinstance(x, tuple) else x
            for k, x in data.items()
        }

    @classmethod
    def from_dict(cls, data: Any) -> AcquireSettings:
        """Return the settings of a session; what is missing or damaged takes its default."""
        if not isinstance(data, Mapping):
            return cls()
        known = {f.name for f in fields(cls)}
        given = {k: _tupled(v) for k, v in data.items() if k in known}
        try:
            settings = cls(**given)
            settings.options()
            dict(settings.device_options)
        except (LfcalError, TypeError, ValueError):
            return cls()
        return settings


def _tupled(value: Any) -> Any:
    return tuple(_tupled(v) for v in value) if isinstance(value, list) else value


# -- the live view -----------------------------------------------------------------------------------------
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
    likeness
        Normalised correlation of the two, NaN where there is none.
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
    likeness: float = math.nan


def live_picture(look: Look, plan: ScanPlan, reference: PSFMatrix | None) -> LivePicture:
    """Return what to draw of a live frame; ``reference`` is an H that says what a cutout should look like."""
    state = look.state
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
    made = LivePicture(frame, edges, counts, numbers, _spot_words(look), levels.saturated, state.stage_um)
    return made if state.expected_px is None else _with_cutout(made, state.expected_px, plan, reference)


def _spot_words(look: Look) -> str:
    spot = look.state.spot
    if spot is None:
        return "no light stands out: check lamp, exposure, position"
    lines = [
        f"centroid row <b>{spot.row:.2f}</b>, column <b>{spot.column:.2f}</b> px",
        f"sharpness <b>{spot.sharpness:.3f}</b>, SNR <b>{spot.snr:.0f}</b>",
    ]
    offset = look.state.offset_px
    if offset is not None:
        lines.append(f"seen − predicted <b>{offset[0]:+.2f}</b>, <b>{offset[1]:+.2f}</b> px")
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
    likeness = math.nan
    if predicted is not None and predicted.shape == seen.shape:
        power = float(np.linalg.norm(seen)) * float(np.linalg.norm(predicted))
        likeness = float((seen * predicted).sum()) / power if power > 0 else math.nan
    return replace(made, window=window, point=point, seen=seen, predicted=predicted, likeness=likeness)


_last: list[tuple[Any, NDArray[Any] | None]] = []


def predicted_pattern(
    plan: ScanPlan, reference: PSFMatrix | None, stage_um: tuple[float, float, float], point: tuple[float, float]
) -> NDArray[Any] | None:
    """Return what the cutout at ``point`` (row, column) should show, ``(nt, ns)``; None where nothing tells.

    The nearest position of ``reference`` if it belongs to the plan, else rays through the described camera.
    """
    depth = float(plan.stage.to_object(np.array(stage_um))[2])
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
    from lfcal.simulate.simulate import simulate_psf

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
        pattern: NDArray[Any] = simulate_psf(plan.camera, one, (), "geometric", workers=1)[0, 0, 0]
    except (LfcalError, ZeroDivisionError):
        return None
    return pattern


# -- what was found ----------------------------------------------------------------------------------------
def fit_words(fit: StageFit, plan: ScanPlan) -> tuple[str, bool]:
    """Return the fit of the stage as rich text, and whether the plan agrees with it."""
    try:
        check_stage(fit, plan)
        verdict, good = "<b>The stage moves the image as the plan says.</b>", True
    except InputError as error:
        verdict, good = f"<b>{error}</b>", False
    right, down = fit.scale
    axes = fit.axes
    sign = "<b>mirrored</b>, " if fit.mirrored else ""
    return (
        f"{verdict}<br>{sign}scale right {right:.4f}, down {down:.4f} (1: as planned); rotation "
        f"{math.degrees(fit.rotation_rad):+.2f}°; residual {fit.residual_px:.3f} px rms<br>image right is stage "
        f"{axes.right}, down {axes.down}"
    ), good


def axis_words(axis: OpticalAxis, plan: ScanPlan) -> str:
    """Return where the optical axis is, as rich text."""
    right, down = axis.object_um
    row, column = axis.image_px
    off = [p - c for p, c in zip(axis.image_px, plan.camera.sensor.centre_px, strict=True)]
    return (
        f"<b>Optical axis</b> at right {format_length(right)}, down {format_length(down)} from the plan's origin; "
        f"image at row {row:.1f}, column {column:.1f} px ({off[0]:+.1f}, {off[1]:+.1f} px from the sensor's centre); "
        f"residual {axis.residual_px:.2f} px rms"
    )


def exposure_words(found: tuple[float, ...], plan: ScanPlan) -> str:
    """Return the exposure of each plane as rich text."""
    rows = "".join(
        f"<tr><td style='padding-right:10px'>{format_length(z)}</td><td><b>{format_seconds(t)}</b></td>"
        f"<td style='padding-left:10px'>was {format_seconds(old)}</td></tr>"
        for z, t, old in zip(plan.depths_um, found, plan.exposures, strict=True)
    )
    return f"<b>Exposure for 70 % of the range</b><table>{rows}</table>"


def target_of(plan: ScanPlan, z: int, station: Station | None = None) -> tuple[float, float, float]:
    """Return the stage position of the middle of the cell in plane ``z`` (µm)."""
    if not 0 <= z < len(plan.depths_um):
        raise InputError.expected("depth plane", f"0 to {len(plan.depths_um) - 1}", z, "choose one")
    ny, nx = plan.period
    x, y, depth = plan.stage_um(np.array([z, ny // 2, nx // 2])).tolist()
    return x, y, depth
