"""The scan plan as fields of a form, its drawing and its forecast as rows. No Qt."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import LfcalError, format_bytes, format_length, format_seconds
from lfcal.camera import Camera, Forecast, ScanPlan, StageAxes
from lfcal_gui.models import Field

__all__ = [
    "FIELDS",
    "RegionDrawing",
    "apply_change",
    "default_plan",
    "forecast_rows",
    "path_lines",
    "region_drawing",
    "values_of",
]

AXES = tuple((sign + axis, sign.replace("-", "−") + axis) for axis in "xyz" for sign in "+-")
PATH_POINTS = 6000
MAX_LENSLETS = 20_000

FIELDS = (
    Field(
        "virtual_depths",
        "Planes at v",
        "",
        "Virtual depths v = a/B of the planes, separated by ', ' or ';'",
        kind="floats",
    ),
    Field(
        "depths_um",
        "or at z",
        "mm",
        "Object-space depths, away from the camera, separated by ', ' or ';'",
        kind="floats",
        scale=1e3,
    ),
    Field("cutout_rows", "Cutout rows", "px", "Odd; size of the region kept around the image of the point", kind="int"),
    Field("cutout_columns", "Cutout columns", "px", "Odd; the same along the rows", kind="int"),
    Field("anchor_row", "Anchor row", "px", "Sensor row of the point's image at y = x = 0"),
    Field("anchor_column", "Anchor column", "px", "Sensor column of the point's image at y = x = 0"),
    Field(
        "order",
        "Order",
        kind="choice",
        choices=(("serpentine", "serpentine"), ("raster", "raster")),
        tip="Serpentine has no long return moves; raster scans every row in the same direction",
    ),
    Field("exposure_s", "Exposure", "ms", "Per frame, the same for all planes", scale=1e-3),
    Field("settle_s", "Settle time", "ms", "Wait after each move", scale=1e-3),
    Field(
        "frames_averaged",
        "Frames averaged",
        "",
        "At each position: noise falls with their root, time grows with them",
        kind="int",
    ),
    Field(
        "resample",
        "Make the period an integer",
        kind="bool",
        tip="Scale the frames so that the period of the array is an integer number of pixels",
    ),
    Field("right", "Image right", "stage", "Stage axis and sense that move the image right", "choice", 1.0, AXES),
    Field("down", "Image down", "stage", "Stage axis and sense that move the image down", "choice", 1.0, AXES),
    Field("away", "Away from camera", "stage", "Stage axis and sense that move the source away", "choice", 1.0, AXES),
)


def default_plan(camera: Camera) -> ScanPlan:
    """Return a plan to begin with: a few planes on one side of the array for a lens, on both for a microscope."""
    if not camera.optics.telecentric:
        near = max((t.focus_depth(camera.lattice.gap_um) for t in camera.lattice.types), default=4.0)
        far = near if np.isfinite(near) and near > 2 else 5.0
        return ScanPlan.for_camera(camera, virtual_depths=[float(v) for v in np.linspace(2.0, far + 0.5, 4).round(2)])
    return ScanPlan.for_camera(camera, depths_um=[-20.0, -10.0, 0.0, 10.0, 20.0])


def values_of(plan: ScanPlan) -> dict[str, Any]:
    """Return the value of every field."""
    return {
        # no minus before a zero
        "virtual_depths": tuple(float(f"{v:.6g}") + 0.0 for v in plan.virtual_depths),
        "depths_um": tuple(float(f"{z:.8g}") + 0.0 for z in plan.depths_um),
        "cutout_rows": plan.cutout[0],
        "cutout_columns": plan.cutout[1],
        "anchor_row": plan.anchor[0],
        "anchor_column": plan.anchor[1],
        "order": plan.order,
        "exposure_s": plan.exposures[0],
        "settle_s": plan.settle_s,
        "frames_averaged": plan.frames_averaged,
        "resample": plan.resample,
        "right": plan.stage.right,
        "down": plan.stage.down,
        "away": plan.stage.away,
    }


def apply_change(plan: ScanPlan, key: str, value: Any) -> tuple[ScanPlan | None, str]:
    """Return the plan with one field changed and an empty string, or None and the reason it cannot be."""
    try:
        return _changed(plan, key, value), ""
    except (LfcalError, ZeroDivisionError, OverflowError) as error:
        return None, str(error)


def _changed(plan: ScanPlan, key: str, value: Any) -> ScanPlan:
    if key in ("virtual_depths", "depths_um"):
        depths = tuple(plan.camera.depth_of(v) for v in value) if key == "virtual_depths" else value
        same = len(depths) == len(plan.depths_um)
        return replace(plan, depths_um=depths, exposure_s=plan.exposures if same else plan.exposures[0])
    if key in ("cutout_rows", "cutout_columns"):
        rows, columns = plan.cutout
        return replace(plan, cutout=(value, columns) if key == "cutout_rows" else (rows, value))
    if key in ("anchor_row", "anchor_column"):
        row, column = plan.anchor
        return replace(plan, anchor=(value, column) if key == "anchor_row" else (row, value))
    if key in ("right", "down", "away"):
        return replace(plan, stage=_swapped(plan.stage, key, value))
    return replace(plan, **{key: value})


def _swapped(stage: StageAxes, key: str, value: str) -> StageAxes:
    """Return the axes with one changed; the move that used this axis takes the one set free."""
    others = [name for name in ("right", "down", "away") if name != key]
    changes = {key: value}
    for name in others:
        if getattr(stage, name)[1] == value[1]:
            changes[name] = getattr(stage, name)[0] + getattr(stage, key)[1]
    right, down, away = (changes.get(name, getattr(stage, name)) for name in ("right", "down", "away"))
    return replace(stage, right=right, down=down, away=away)


@dataclass(frozen=True, eq=False)
class RegionDrawing:
    """The representative region: lenslets (row, column, type), the cell's corners, and the scan path (row, column)."""

    lenslets: NDArray[np.float64]
    types: NDArray[np.intp]
    radius_px: float
    corner: tuple[float, float]
    size: tuple[int, int]
    path: NDArray[np.float64]


def region_drawing(plan: ScanPlan) -> RegionDrawing:
    """Return what is drawn of a plan, in sensor pixels."""
    camera = plan.camera
    ny, nx = plan.period
    pixel = camera.sensor.pixel_um
    middle = (plan.anchor[0] + (ny - 1) / 2, plan.anchor[1] + (nx - 1) / 2)
    centre_row, centre_column = camera.sensor.centre_px
    about = ((middle[1] - centre_column) * pixel, (middle[0] - centre_row) * pixel)
    reach = 1.2 * camera.pitch_px
    half = ((nx / 2 + reach) * pixel, (ny / 2 + reach) * pixel)
    cell = camera.lattice.pitch_um * camera.lattice.row_step_um
    centres, types = np.zeros((0, 2)), np.zeros(0, np.intp)
    if 4 * half[0] * half[1] / cell < MAX_LENSLETS:
        centres, types = camera.lattice.lenslets_within(*half, about)
    points = np.stack([centres[:, 1] / pixel + centre_row, centres[:, 0] / pixel + centre_column], axis=-1)
    order = plan.order_indices()[: ny * nx]
    step = max(1, len(order) // PATH_POINTS)
    path = plan.image_px(order)[::step]
    radius = camera.lattice.clear_diameter_um / pixel / 2
    return RegionDrawing(points, types, radius, plan.anchor, plan.period, path)


def path_lines(plan: ScanPlan, between: str) -> Iterator[str]:
    """Yield the scan path of a plane as a table: positions in their order, and where their images are (px)."""
    yield between.join(("y", "x", "row_px", "column_px")) + "\n"
    ny, nx = plan.period
    order = plan.order_indices()[: ny * nx]
    for (_, y, x), (row, column) in zip(order.tolist(), plan.image_px(order).tolist(), strict=True):
        yield between.join((f"{y}", f"{x}", f"{row:.9g}", f"{column:.9g}")) + "\n"


def forecast_rows(plan: ScanPlan, stage_um_per_s: float = 1000.0) -> list[tuple[str, str]]:
    """Return the forecast as pairs of name and value with unit."""
    found = Forecast.of(plan, stage_um_per_s=stage_um_per_s)
    ry, rx = plan.period_residual_px
    ny, nx = plan.period
    return [
        ("Planes × rows × columns", f"{len(plan.depths_um)} × {ny} × {nx}"),
        ("Positions", f"{found.positions}"),
        ("Frames", f"{found.frames}"),
        ("Time without readout", format_seconds(found.hours * 3600)),
        ("  whole frames at", f"{format_bytes(found.bytes_per_s)}/s"),
        ("  exposing", format_seconds(found.exposure_hours * 3600)),
        ("  settling", format_seconds(found.settle_hours * 3600)),
        (f"  moving at {format_length(stage_um_per_s)}/s", format_seconds(found.move_hours * 3600)),
        ("Whole frames on disk", format_bytes(found.frame_bytes)),
        ("Cutouts on disk", format_bytes(found.cutout_bytes)),
        ("H, float32", format_bytes(found.h_float32_bytes)),
        ("H, rounded, at most", format_bytes(found.h_rounded_bytes)),
        ("HT if exported", format_bytes(found.ht_float32_bytes)),
        ("Memory to assemble", format_bytes(found.assembly_bytes)),
        ("Lateral step, first plane", format_length(plan.step_um(0)[1])),
        ("Lateral step, last plane", format_length(plan.step_um(len(plan.depths_um) - 1)[1])),
        ("Period residual, x", f"{round(rx, 3) + 0.0:+.3f} px"),
        ("Period residual, y", f"{round(ry, 3) + 0.0:+.3f} px"),
    ]
