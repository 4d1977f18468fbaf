"""The scan plan that a command works on: a file of one, or a camera and its planes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import InputError

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan

__all__ = ["planned_scan"]


def planned_scan(camera: str, depths: str, virtual_depths: str, cutout: str, *, quiet: bool) -> ScanPlan:
    """Return the plan in a JSON file, or that of a camera (preset or file) with planes; say what is assumed of it.

    Raises
    ------
    InputError
        If planes and cutout are given beside a plan, or no planes beside a camera.
    """
    from lfcal.camera import ScanPlan
    from lfcal.cli._plan_for_fit import ready_plan
    from lfcal.cli.plan import load_camera, parse_cutout, parse_planes
    from lfcal.tasks import tell_assumed

    if camera.endswith(".json") and (ready := ready_plan(Path(camera))) is not None:
        if depths or virtual_depths or cutout:
            raise InputError("planes and cutout: expected those of the plan, got others; leave the options out")
        tell_assumed(ready.camera, Path(camera).name, quiet=quiet)
        return ready
    lengths, virtual = parse_planes(depths, virtual_depths)
    return ScanPlan.for_camera(
        load_camera(camera), depths_um=lengths, virtual_depths=virtual, cutout=parse_cutout(cutout)
    )
