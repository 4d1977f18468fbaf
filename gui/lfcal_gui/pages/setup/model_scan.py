"""Scan plan as the task PlanScan, and its drawing. No Qt."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, LfcalError, Work, check_cutout, replace_whole
from lfcal.camera import Camera, ScanPlan, half_cell, moved_onto_sensor
from lfcal.records import rows
from lfcal.tasks import PLAN_FORMATS, PlanScan, plan_text
from lfcal_gui.models import CAMERA_FILE, UNKNOWN, Field, fields_of, list_beside, shown_of

PATH_POINTS = 6000

HELD = frozenset({"camera", "out", "list_file", "written_as"})
"""Fields of `lfcal.tasks.PlanScan` that are not in the form: the camera, and the files that *Save …* writes."""

BASIC_OF_SCAN = ("virtual_depths", "depths", "cutout", "exposure")
"""Keys of fields that are never folded."""

ROWS = {row.name: row for row in rows(PlanScan)}
PLANES = ("depths", "virtual_depths")

SAVED = ";;".join(f"{title} (*{suffix})" for title, suffix in PLAN_FORMATS.values())
"""Formats of a plan file, for a file dialog."""


def default_plan(camera: Camera) -> ScanPlan:
    """Return an initial plan: a few planes on one side of the array for a main lens, on both for a microscope."""
    if not camera.optics.telecentric:
        near = max((t.focus_depth(camera.lattice.gap_um) for t in camera.lattice.types), default=4.0)
        far = near if np.isfinite(near) and near > 2 else 5.0
        return ScanPlan.for_camera(camera, virtual_depths=[float(v) for v in np.linspace(2.0, far + 0.5, 4).round(2)])
    return ScanPlan.for_camera(camera, depths_um=[-20.0, -10.0, 0.0, 10.0, 20.0])


def scan_fields() -> dict[str, Field]:
    """Return the fields of the form by key; exposures are in ms, as everywhere in the window."""
    every = {field.key: field for field in fields_of(PlanScan, without=HELD)}
    exposure = every["exposure"]
    tip = exposure.tip.replace("(s;", "(ms;")
    every["exposure"] = replace(
        exposure, kind="floats", unit="ms", scale=1e-3, read=None, empty="", tip=tip, default=UNKNOWN
    )
    return every


def _values(plan: ScanPlan) -> dict[str, Any]:
    """Return the values of a plan by field name of the task."""
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


def format_of(path: str | Path) -> str:
    """Return the format of a plan that the suffix of ``path`` selects; ``"plan"`` if the suffix is unknown."""
    found = [(len(suffix), name) for name, (_, suffix) in PLAN_FORMATS.items() if str(path).lower().endswith(suffix)]
    return max(found, default=(0, "plan"))[1]


def scan_task(plan: ScanPlan, out: str = "plan.json", **changed: Any) -> PlanScan:
    """Return the task that makes ``plan`` from its camera, with some values ``changed``; see `format_of`."""
    own = {"camera": CAMERA_FILE, "out": Path(out), "written_as": format_of(out), **_values(plan)}
    return PlanScan(**{**own, **changed})


def values_of(plan: ScanPlan) -> dict[str, Any]:
    """Return the values of a plan shown in the form, with rounded planes."""
    planes = {
        # no minus before a zero
        "virtual_depths": tuple(float(f"{v:.6g}") + 0.0 for v in plan.virtual_depths),
        "depths": tuple(float(f"{z:.8g}") + 0.0 for z in plan.depths_um),
    }
    values = {**_values(plan), **planes}
    shown = {key: value for key, value in shown_of(PlanScan, values).items() if key in values}
    return shown | {"exposure": plan.exposures[:1] if len(set(plan.exposures)) == 1 else plan.exposures}


def suggested_values(camera: Camera) -> dict[str, Any]:
    """Return the form values of the plan derived from the camera geometry; empty if there is none."""
    try:
        return values_of(default_plan(camera))
    except LfcalError:
        return {}


@lru_cache(maxsize=4, typed=True)
def apply_change(plan: ScanPlan, key: str, value: Any) -> tuple[ScanPlan | None, str]:
    """Return the plan with one field changed and ``""``, or None and the reason why the value is refused."""
    if isinstance(value, tuple) and len(value) == 1:
        value = value[0]
    try:
        return _changed(plan, key, ROWS[key].value(value, ROWS[key].label)), ""
    except (LfcalError, ZeroDivisionError, OverflowError) as error:
        return None, str(error)


def moved(plan: ScanPlan, key: str, value: Any) -> ScanPlan | str:
    """Return the plan with a changed cutout or anchor, moved onto the sensor, or why moving does not help.

    The reason is empty if the value is refused for another cause.
    """
    if key not in ("cutout", "anchor"):
        return ""
    try:
        given = ROWS[key].value(value, ROWS[key].label)
        given = (given, given) if isinstance(given, int) else given
        check_cutout(*(given if key == "cutout" else plan.cutout))
    except LfcalError:
        return ""
    try:
        return moved_onto_sensor(plan, **{key: given})
    except LfcalError:
        most = [n - p + 1 for n, p in zip(plan.camera.sensor.shape, plan.period, strict=True)]
        high, wide = (max(0, n - 1 + n % 2) for n in most)
        return f"the cutout may have at most {high} × {wide} px on this sensor"


def _changed(plan: ScanPlan, key: str, value: Any) -> ScanPlan:
    given = {key: value}
    if key in PLANES:
        if not value:
            raise InputError.expected(ROWS[key].label, "one or more", "none", "give a value such as 3,4")
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


@lru_cache(maxsize=8)
def is_usual(plan: ScanPlan) -> bool:
    """Return whether the task makes this plan from its camera, apart from the origin of the stage."""
    try:
        made = scan_task(plan).scan(plan.camera)
    except LfcalError:
        return False
    return replace(made, stage=plan.stage) == plan


def half_of(plan: ScanPlan) -> NDArray[np.intp]:
    """Return the positions ``(n, 3)`` of a half-cell scan; raise `InputError` if half of the period is not enough."""
    return half_cell(plan).half(plan)


def list_text(positions: NDArray[np.intp]) -> str:
    """Return the content of the file that lists positions."""
    from lfcal.acquire import RedoList  # here: a page is shown before devices are loaded

    return RedoList.of(positions.tolist()).to_json()


def plan_files(plan: ScanPlan, half: NDArray[np.intp] | None, path: str | Path) -> dict[Path, Callable[[], str]]:
    """Return the files to save, each with a function that makes its text; ``half``: positions of a half-cell scan.

    The suffix of ``path`` determines the format. The function raises `InputError` if this format cannot
    describe the plan.
    """
    name = format_of(path)
    # a plan does not list the positions
    listed = {list_beside(path): partial(list_text, half)} if half is not None and name == "plan" else {}
    return {Path(path): partial(plan_text, plan, name, half), **listed}


def iter_saved(files: Mapping[Path, Callable[[], str]]) -> Work[str]:
    """Write the files of `plan_files`, and return what was saved as text."""
    clock = Clock("saving the plan", len(files))
    for k, (path, make) in enumerate(files.items()):
        yield clock.at(k)
        text = make()  # a format that cannot describe the plan leaves the old file
        with replace_whole(path) as part:
            part.write_text(text, encoding="utf-8")
    return saved_words(files)


def saved_words(files: Iterable[Path]) -> str:
    """Return what was saved: a file, and perhaps a list of positions."""
    path, *listed = files
    if format_of(path) != "plan":
        return f"stage positions saved as {path}; save the plan too (.json), because H is assembled with it"
    return f"plan saved as {path}" + "".join(f", and {one.name} for Positions in Record > Rig" for one in listed)


def scan_path(plan: ScanPlan, positions: NDArray[np.intp] | None = None) -> NDArray[np.float64]:
    """Return the path of the image in a plane ``(n, 2)`` (px), restricted to ``positions`` if given."""
    order = _first_plane(plan, positions)
    path: NDArray[np.float64] = plan.image_px(order)[:: max(1, len(order) // PATH_POINTS)]
    return path


def _first_plane(plan: ScanPlan, positions: NDArray[np.intp] | None) -> NDArray[np.intp]:
    if positions is None:  # of one plane: large plans have millions of positions
        return replace(plan, depths_um=plan.depths_um[:1], exposure_s=plan.exposures[0]).order_indices()
    order = positions
    found: NDArray[np.intp] = order[order[:, 0] == order[0, 0]]
    return found


def path_lines(plan: ScanPlan, between: str, positions: NDArray[np.intp] | None = None) -> Iterator[str]:
    """Yield the scan path of a plane as table lines: positions in scan order with their image positions (px)."""
    yield between.join(("y", "x", "row_px", "column_px")) + "\n"
    order = _first_plane(plan, positions)
    for (_, y, x), (row, column) in zip(order.tolist(), plan.image_px(order).tolist(), strict=True):
        yield between.join((f"{y}", f"{x}", f"{row:.9g}", f"{column:.9g}")) + "\n"
