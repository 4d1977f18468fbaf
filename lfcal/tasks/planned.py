"""Make, read, write and forecast scan plans for tasks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError, read_text, write_text
from lfcal.records import (
    check_planes,
    opt,
    read_cutout,
    read_depths,
    read_virtual_depths,
    record,
    show_pair,
    show_planes,
)
from lfcal.tasks.cameras import is_camera_file, load_camera, note_assumed
from lfcal.tasks.task import Task, TaskResult

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.camera import Forecast, RegionPlan, ScanPlan
    from lfcal.targets import TargetPlan

__all__ = [
    "WITHOUT_READOUT",
    "PlanTask",
    "Planned",
    "cutout_field",
    "depths_field",
    "planned_scan",
    "ready_regions",
    "scan_of",
    "virtual_depths_field",
    "write_plan",
]

WITHOUT_READOUT = "without readout (--frame-rate)"
"""Remark on a time that does not count readout."""


def depths_field(empty: str) -> tuple[float, ...]:
    """Declare the field ``depths`` of a task on a scan; ``empty`` states what applies if it is not set."""
    words = (
        "Depths of the planes, positive away from the camera: a,b,c or start:stop:step. In µm, unless a unit follows "
        "(1.2mm)."
    )
    return opt((), words, unit="µm", read=read_depths, show=show_planes, empty=empty)


def virtual_depths_field(empty: str) -> tuple[float, ...]:
    """Declare the field ``virtual_depths`` of a task on a scan; ``empty`` states what applies if it is not set."""
    words = (
        "Virtual depths of the planes, each the distance of its image from the lenslets divided by the gap: a,b,c or "
        "start:stop:step."
    )
    return opt((), words, read=read_virtual_depths, show=show_planes, empty=empty)


def cutout_field(source: str, *, more: bool = False) -> tuple[int, int] | None:
    """Declare the field ``cutout`` of a task on a scan; ``source`` names the origin of its default in the help.

    ``more`` states whether the field is advanced, as in `lfcal.records.option.Opt`.
    """
    words = "Size of the cutout around the image of each point: an odd number of pixels, or ROWS,COLUMNS."
    empty = f"as in {source}, else the geometric size of the pattern"
    return opt(None, words, unit="px", read=read_cutout, show=show_pair, empty=empty, more=more)


@record
class PlanTask(Task):
    """Base class of tasks that forecast the time of a scan."""

    speed: float = opt(1000.0, "Speed of the stage.", unit="µm/s", above=0, more=True)
    frame_rate: float | None = opt(
        None,
        "Largest frame rate of the camera for the region that is read, as stated in its data sheet.",
        unit="frames/s",
        above=0,
        empty="the readout time is ignored",
        more=True,
    )

    @property
    def rates(self) -> dict[str, Any]:
        """Speed of the stage (µm/s) and frame rate of the camera (frames/s), as keyword arguments of forecasts."""
        return {"stage_um_per_s": self.speed, "frames_per_s": self.frame_rate}

    @property
    def unread(self) -> str:
        """Remark to append to a time in messages, with a leading space; empty if readout is included."""
        return f" {WITHOUT_READOUT}" if self.frame_rate is None else ""

    def forecast(self, plan: ScanPlan, positions: NDArray[np.intp] | None = None) -> Forecast:
        """Return the forecast of the scan, or of its ``positions`` ``(n, 3)`` as (z, y, x) if given."""
        from lfcal.camera import Forecast

        return Forecast.of(plan, **self.rates, positions=positions)


@dataclass(frozen=True, kw_only=True)
class Planned(TaskResult):
    """A plan of any kind, with its cost.

    ``forecast`` is the cost of scanning one region with a single point. ``facts`` describes the plan as plain JSON
    types.
    """

    task: Any
    plan: Any
    forecast: Forecast
    facts: dict[str, Any]

    def _values(self) -> dict[str, Any]:
        return self.facts


def planned_scan(
    camera: str,
    depths: tuple[float, ...] = (),
    virtual_depths: tuple[float, ...] = (),
    cutout: tuple[int, int] | None = None,
) -> ScanPlan:
    """Return the plan in a JSON file, or the plan of a scan with a camera (preset or file).

    ``camera`` is the file of the plan, or the camera. The planes ``depths`` (µm) or ``virtual_depths``, and ``cutout``
    (rows, columns) in pixels are as in `lfcal.camera.ScanPlan.for_camera`. For a plan of several regions, the plan that
    they share is returned.

    Raises
    ------
    InputError
        If planes or a cutout are given together with a plan, or a camera is given without planes.
    """
    from lfcal.camera import ScanPlan

    ready = _ready(camera)
    if ready is None:
        check_planes(depths, virtual_depths)
        return ScanPlan.for_camera(
            load_camera(camera),
            depths_um=depths or None,
            virtual_depths=virtual_depths or None,
            cutout=cutout,
        )
    if depths or virtual_depths or cutout:
        raise InputError(
            "planes and cutout: expected those of the plan, got options as well; leave the options out (--depths, "
            "--virtual-depths, --cutout)"
        )
    note_assumed(ready.scan.camera, Path(camera).name)
    return ready.scan


def scan_of(path: Path) -> ScanPlan:
    """Return the scan plan in a file; raise `InputError` if the file is a camera or of another kind."""
    from lfcal.camera import ScanPlan

    named = not is_camera_file(str(path))
    found = None if named else _ready(str(path))
    if not isinstance(found, ScanPlan):
        got = f"the camera {path}" if named else str(path)
        raise InputError.expected("PLAN", "a scan plan (.json)", got, "make one with lfcal plan CAMERA -o plan.json")
    return found


def ready_regions(path: str) -> RegionPlan | None:
    """Return the plan of several regions in a JSON file; None if the file is of another kind."""
    from lfcal.camera import RegionPlan

    found = _ready(path)
    return found if isinstance(found, RegionPlan) else None


def _ready(path: str) -> ScanPlan | RegionPlan | None:
    """Return the plan in a JSON file, or None if the file is of another kind, such as a camera."""
    from lfcal.base import parse_json
    from lfcal.camera import RegionPlan, ScanPlan

    data: Any = parse_json(read_text(Path(path)), path) if path.endswith(".json") else None
    for kind in (ScanPlan, RegionPlan):
        if kind.is_one(data):
            return kind.from_dict(data)
    return None


def write_plan(plan: ScanPlan | RegionPlan | TargetPlan, out: Path | None) -> None:
    """Write ``plan`` to the file ``out``. None: do not write it."""
    if out is not None:
        write_text(out, plan.to_json())
