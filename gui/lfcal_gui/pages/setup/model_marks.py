"""Where the values of the camera's fields come from, and what confirming or editing one does. No Qt."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from lfcal.base import LfcalError, drain
from lfcal.camera import Camera, Marks, ScanPlan, quantities_of
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.setup.model_scan import default_plan

if TYPE_CHECKING:
    from lfcal.simulate import AssumedEffect

__all__ = ["TIPS", "confirmed", "mark_of", "path_of", "state_with", "stated", "weighed", "weighed_key"]

PATHS = {
    "optics.kind": "",
    "sensor.rows": "sensor.shape",
    "sensor.columns": "sensor.shape",
    "lattice.focus": "lattice.types",
    "lattice.offset_x": "lattice.offset_um",
    "lattice.offset_y": "lattice.offset_um",
    "camera.wavelength_um": "wavelength_um",
    "camera.bandwidth_um": "bandwidth_um",
}
"""Fields whose value stands elsewhere in the description."""

CHOSEN = ("depths_um", "stage", "order", "exposure_s", "settle_s", "frames_averaged", "resample")
"""What of a plan does not follow from the camera."""

OF_ROWS = ("lattice.row_pitch_um", "lattice.shear_rad", "lattice.distortion")
"""Values that another kind of array does not keep."""

TIPS = {
    "assumed": "This value was not stated: lfcal uses a typical one. Type the true value, or click if it is right.",
    "derived": "This value follows from stated or measured ones.",
    "measured": "This value was measured in frames of the camera.",
    "stated": "This value is stated.",
}


def path_of(key: str) -> str:
    """Return where the value of a field stands in the description; empty for none."""
    return PATHS.get(key, key)


def mark_of(camera: Camera, key: str) -> str:
    """Return where the value of a field comes from."""
    path = path_of(key)
    return camera.marks[path] if path else "stated"


def confirmed(camera: Camera, paths: Iterable[str]) -> Camera:
    """Return ``camera`` with the values at ``paths`` stated, as somebody says that they are right."""
    return replace(camera, marks=camera.marks.marked(paths, "stated"))


def stated(before: Camera, after: Camera, key: str) -> Camera:
    """Return ``after``, made of ``before`` by a change of one field, with that value stated."""
    if key == "optics.kind" and type(before.optics) is not type(after.optics):
        kept = {path: mark for path, mark in after.marks if not path.startswith("optics.")}
        taken = {q.path: "assumed" for q in quantities_of(after) if q.path.startswith("optics.")}
        return replace(after, marks=Marks.of(kept | taken))
    if key == "lattice.kind" and before.lattice.kind != after.lattice.kind:
        after = replace(after, marks=Marks.of({path: mark for path, mark in after.marks if path not in OF_ROWS}))
    path = path_of(key)
    # a value without a mark is stated already
    return confirmed(after, [path]) if path and after.marks[path] != "stated" else after


def state_with(state: ProjectState, camera: Camera, *, same: bool = False) -> dict[str, object]:
    """Return the changes of a project that take a camera.

    Its plan stays where images lie as they did. Of the ``same`` camera, described otherwise, it is made anew with what
    was chosen in it: planes, exposures, stage, and cutout and anchor unless they were those that are suggested.
    """
    plan = state.plan
    if plan is not None and _same_geometry(state.camera, camera):
        plan = replace(plan, camera=camera)
    elif plan is not None:
        plan = carried(plan, camera) if same else None
    return {"camera": camera, "plan": plan}


def carried(plan: ScanPlan, camera: Camera) -> ScanPlan | None:
    """Return a plan for the camera as it is described now; None where no such planes can be scanned with it."""
    chosen = {name: getattr(plan, name) for name in CHOSEN}
    try:
        suggested = ScanPlan.for_camera(plan.camera, depths_um=plan.depths_um, resample=plan.resample)
        for name in ("cutout", "anchor"):
            if getattr(plan, name) != getattr(suggested, name):
                chosen[name] = getattr(plan, name)
    except (LfcalError, ZeroDivisionError, OverflowError):
        return None
    for kept in (chosen, {name: chosen[name] for name in CHOSEN}):  # a cutout or an anchor may lie outside now
        try:
            return ScanPlan.for_camera(camera, **kept)
        except (LfcalError, ZeroDivisionError, OverflowError):
            continue
    return None


def weighed_key(state: ProjectState) -> tuple[Any, ...] | None:
    """Return what the effects of assumed values depend on; None: none is assumed."""
    camera, plan = state.camera, state.plan
    assumed = camera.marks.paths("assumed")
    # time is relative, so that neither exposures nor averages matter much; the cutout does not matter at all
    return (camera, assumed, None if plan is None else plan.depths_um) if assumed else None


def weighed(state: ProjectState) -> tuple[AssumedEffect, ...]:
    """Return what hangs on each assumed value, the largest first; it takes a second."""
    from lfcal.simulate import iter_assumed_effects

    return drain(iter_assumed_effects(state.plan or default_plan(state.camera)))


def _same_geometry(one: Camera, other: Camera) -> bool:
    """Return whether two cameras differ at most in noise and levels: planes, cutout and anchor are then the same."""
    sensor = replace(other.sensor, shape=one.sensor.shape, pixel_um=one.sensor.pixel_um)
    return sensor == other.sensor and replace(one, sensor=other.sensor) == other
