"""The scan plan as the task PlanScan, its drawing and its forecast as rows. No Qt."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, LfcalError, format_bytes, format_length, format_seconds
from lfcal.camera import Camera, Forecast, ScanPlan, half_cell
from lfcal.records import rows
from lfcal.tasks import PlanScan
from lfcal_gui.models import CAMERA_FILE, shown_of

__all__ = [
    "BASIC_OF_SCAN",
    "HELD",
    "apply_change",
    "default_plan",
    "forecast_rows",
    "half_of",
    "is_usual",
    "list_beside",
    "list_text",
    "path_lines",
    "scan_path",
    "scan_task",
    "suggested_values",
    "values_of",
]

PATH_POINTS = 6000

HELD = frozenset({"camera", "out", "list_file"})
"""Fields of `lfcal.tasks.PlanScan` that are not in the form: the camera, and the files that *Save …* writes."""

BASIC_OF_SCAN = ("virtual_depths", "depths", "cutout", "exposure")
"""Fields that are never folded."""

ROWS = {row.name: row for row in rows(PlanScan)}
PLANES = ("depths", "virtual_depths")


def default_plan(camera: Camera) -> ScanPlan:
    """Return a plan to begin with: a few planes on one side of the array for a lens, on both for a microscope."""
    if not camera.optics.telecentric:
        near = max((t.focus_depth(camera.lattice.gap_um) for t in camera.lattice.types), default=4.0)
        far = near if np.isfinite(near) and near > 2 else 5.0
        return ScanPlan.for_camera(camera, virtual_depths=[float(v) for v in np.linspace(2.0, far + 0.5, 4).round(2)])
    return ScanPlan.for_camera(camera, depths_um=[-20.0, -10.0, 0.0, 10.0, 20.0])


def _values(plan: ScanPlan) -> dict[str, Any]:
    """Return the values of a plan by the names of the task's fields."""
    exposures = plan.exposures
    return {
        "depths": plan.depths_um,
        "cutout": plan.cutout,
        "anchor": plan.anchor,
        "resample": plan.resample,
        "order": plan.order,
        "stage": plan.stage.words,
        "exposure": exposures[0] if len(set(exposures)) == 1 else exposures,
        "settle": plan.settle_s,
        "average": plan.frames_averaged,
    }


def scan_task(plan: ScanPlan, out: str = "plan.json", **changed: Any) -> PlanScan:
    """Return the task that makes a plan of its camera, with some values ``changed``."""
    return PlanScan(**{"camera": CAMERA_FILE, "out": Path(out), **_values(plan), **changed})


def values_of(plan: ScanPlan) -> dict[str, Any]:
    """Return what the form shows of a plan: planes are rounded."""
    planes = {
        # no minus before a zero
        "virtual_depths": tuple(float(f"{v:.6g}") + 0.0 for v in plan.virtual_depths),
        "depths": tuple(float(f"{z:.8g}") + 0.0 for z in plan.depths_um),
    }
    values = {**_values(plan), **planes}
    return {key: value for key, value in shown_of(PlanScan, values).items() if key in values}


def suggested_values(camera: Camera) -> dict[str, Any]:
    """Return what the form shows of the plan that the camera's geometry suggests; empty: it suggests none."""
    try:
        return values_of(default_plan(camera))
    except LfcalError:
        return {}


def apply_change(plan: ScanPlan, key: str, value: Any) -> tuple[ScanPlan | None, str]:
    """Return the plan with one field changed and an empty string, or None and the reason it cannot be."""
    try:
        return _changed(plan, key, ROWS[key].value(value, ROWS[key].label)), ""
    except (LfcalError, ZeroDivisionError, OverflowError) as error:
        return None, str(error)


def _changed(plan: ScanPlan, key: str, value: Any) -> ScanPlan:
    given = {key: value}
    if key in PLANES:
        if not value:
            raise InputError.expected(ROWS[key].label, "one or more", "none", "for example 3,4")
        if len(value) != len(plan.depths_um):
            given["exposure"] = plan.exposures[0]
        given = {"depths": (), **given}
    task = scan_task(plan, **given)
    if is_usual(plan):
        made = task.scan(plan.camera)
    else:  # one of another period, such as that of a recorded scan, keeps it
        own = {name: found for name, found in task.settings().items() if found is not None}
        if virtual := own.pop("virtual_depths", ()):
            own["depths_um"] = tuple(plan.camera.depth_of(v) for v in virtual)
        made = replace(plan, **own)
    return replace(made, stage=replace(made.stage, origin_um=plan.stage.origin_um))


def is_usual(plan: ScanPlan) -> bool:
    """Return whether the task makes this plan of its camera, but for the origin of the stage."""
    try:
        made = scan_task(plan).scan(plan.camera)
    except LfcalError:
        return False
    return replace(made, stage=plan.stage) == plan


def half_of(plan: ScanPlan) -> NDArray[np.intp]:
    """Return the positions ``(n, 3)`` of a half-cell scan; raises `InputError` if half of the period is not enough."""
    return half_cell(plan).half(plan)


def list_text(positions: NDArray[np.intp]) -> str:
    """Return the list of positions as its file has it."""
    from lfcal.acquire import RedoList  # here: a page is shown before devices are loaded

    return RedoList.of(positions.tolist()).to_json()


def list_beside(path: str | Path) -> Path:
    """Return the file of the list of positions next to that of the plan."""
    return Path(path).with_name(f"{Path(path).stem}_positions.json")


def scan_path(plan: ScanPlan, positions: NDArray[np.intp] | None = None) -> NDArray[np.float64]:
    """Return where the image goes in a plane, ``(n, 2)`` pixels; with ``positions`` no others are recorded."""
    order = _first_plane(plan, positions)
    path: NDArray[np.float64] = plan.image_px(order)[:: max(1, len(order) // PATH_POINTS)]
    return path


def _first_plane(plan: ScanPlan, positions: NDArray[np.intp] | None) -> NDArray[np.intp]:
    order = plan.order_indices() if positions is None else positions
    found: NDArray[np.intp] = order[order[:, 0] == order[0, 0]]
    return found


def path_lines(plan: ScanPlan, between: str, positions: NDArray[np.intp] | None = None) -> Iterator[str]:
    """Yield the scan path of a plane as a table: positions in their order, and where their images are (px)."""
    yield between.join(("y", "x", "row_px", "column_px")) + "\n"
    order = _first_plane(plan, positions)
    for (_, y, x), (row, column) in zip(order.tolist(), plan.image_px(order).tolist(), strict=True):
        yield between.join((f"{y}", f"{x}", f"{row:.9g}", f"{column:.9g}")) + "\n"


def forecast_rows(
    plan: ScanPlan,
    speed: float = 1000.0,
    frame_rate: float | None = None,
    positions: NDArray[np.intp] | None = None,
) -> list[tuple[str, str]]:
    """Return the forecast as pairs of name and value with unit; with ``positions`` no others are recorded."""
    found = Forecast.of(plan, stage_um_per_s=speed, frames_per_s=frame_rate, positions=positions)
    half = "" if positions is None else f" of {plan.n_positions} (half cell)"
    ry, rx = plan.period_residual_px
    ny, nx = plan.period
    readout = found.readout_hours
    return [
        ("Planes × rows × columns", f"{len(plan.depths_um)} × {ny} × {nx}"),
        ("Positions", f"{found.positions}{half}"),
        ("Frames", f"{found.frames}"),
        ("Time without readout" if readout is None else "Time", format_seconds(found.hours * 3600)),
        ("  whole frames at", f"{format_bytes(found.bytes_per_s)}/s"),
        ("  exposing", format_seconds(found.exposure_hours * 3600)),
        *([] if readout is None else [("  reading out", format_seconds(readout * 3600))]),
        ("  settling", format_seconds(found.settle_hours * 3600)),
        (f"  moving at {format_length(speed)}/s", format_seconds(found.move_hours * 3600)),
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
