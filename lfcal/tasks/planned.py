"""The scan plan that a task works on: a file of one, or a camera and its planes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import InputError
from lfcal.records import check_planes
from lfcal.tasks.cameras import load_camera, tell_assumed

if TYPE_CHECKING:
    from lfcal.camera import RegionPlan, ScanPlan

__all__ = ["planned_scan", "ready_plan", "ready_regions"]


def planned_scan(
    camera: str,
    depths: tuple[float, ...] = (),
    virtual_depths: tuple[float, ...] = (),
    cutout: tuple[int, int] | None = None,
) -> ScanPlan:
    """Return the plan in a JSON file, or that of a camera (preset or file) with planes.

    Of a plan of several regions it is the plan that all of them share.

    Raises
    ------
    InputError
        If planes and cutout are given besides a plan, or no planes besides a camera.
    """
    from lfcal.camera import ScanPlan

    regions = ready_regions(camera)
    ready = regions.scan if regions else ready_plan(camera)
    if ready is None:
        check_planes(depths, virtual_depths)
        return ScanPlan.for_camera(
            load_camera(camera),
            depths_um=depths or None,
            virtual_depths=virtual_depths or None,
            cutout=cutout,
        )
    if depths or virtual_depths or cutout:
        raise InputError("planes and cutout: expected those of the plan, got others; leave the options out")
    tell_assumed(ready.camera, Path(camera).name)
    return ready


def ready_plan(path: str) -> ScanPlan | None:
    """Return the scan plan in a JSON file, or None where it is something else."""
    from lfcal.base import read_text
    from lfcal.camera import ScanPlan

    if not path.endswith(".json"):
        return None
    # a camera and a plan are both JSON: the format's name in the text distinguishes them before parsing.
    text = read_text(Path(path))
    return ScanPlan.from_json(text) if '"lfcal-plan"' in text else None


def ready_regions(path: str) -> RegionPlan | None:
    """Return the plan of several regions in a JSON file, or None where it is something else."""
    from lfcal.base import parse_json, read_text
    from lfcal.camera import RegionPlan

    if not path.endswith(".json"):
        return None
    data = parse_json(read_text(Path(path)), path)
    return RegionPlan.from_dict(data) if RegionPlan.is_one(data) else None
