"""Plan frames of a target of many points that replace a scan, and compare them with the scan of a single point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Work, format_count, read_text
from lfcal.records import opt, read_share, record, required
from lfcal.tasks.planned import Planned, PlanTask, scan_of, write_plan
from lfcal.tasks.task import RunSettings, Task, TaskSet

if TYPE_CHECKING:
    from lfcal.camera import RegionPlan, ScanPlan
    from lfcal.multiplex import CodingVerdict
    from lfcal.targets import Display, TargetPlan, Wishes

__all__ = [
    "PLAN_TARGET",
    "PlanDisplay",
    "PlanTarget",
    "TargetPlanned",
]

DISPLAY = "display"
"""Prefix of a target that is a display."""


def _is_file(source: str) -> bool:
    return source.endswith(".json")


@dataclass(frozen=True, kw_only=True)
class TargetPlanned(Planned):
    """The plan of a target, compared with the scan of a single point.

    ``verdict`` states whether showing the points of several frames at once, in coded frames, reduces noise. None: there
    are too few frames or holes.
    """

    plan: TargetPlan
    verdict: CodingVerdict | None


@record
class _PlanTarget(PlanTask):
    """Fields of all kinds of targets."""

    name: ClassVar[str] = "plan target"

    plan: Path = required("Scan plan (.json), made by lfcal plan.", argument=True, file="in")
    source: str = required(
        "File of a target (.json), or its description. array:12x12@1.2mm,hole=20um: 12 x 12 pinholes of 20 µm, "
        "pitch 1.2 mm (hex for a hexagonal array; ROWxCOLUMN for two pitches). array: lfcal chooses the pitch with the "
        "fewest frames. display:2160x3840@8um: a display of 2160 x 3840 pixels of 8 µm.",
        argument=True,
        label="Target",
        file="in",
        is_path=_is_file,
    )
    tolerance: float = opt(
        0.1,
        "Largest distance, in rows and in columns, of a point from the scan position that it represents.",
        label="Tolerance",
        unit="px",
        at_least=0.01,
        at_most=0.5,
    )
    crosstalk: float = opt(
        0.005,
        "Largest allowed light from neighbouring points in a cutout, relative to the point at its centre.",
        at_least=1e-6,
        below=1,
        read=read_share,
    )
    most_frames: int | None = opt(
        None,
        "Largest number of frames for each plane. If more would be needed, some positions are not covered; the result "
        "states the fraction that is covered.",
        label="Largest number of frames",
        at_least=1,
        empty="no limit",
    )
    regions: str = opt(
        "", "Regions of the field to cover, ROWSxCOLUMNS over the sensor, such as 3x3.", empty="one region"
    )
    signal: float | None = opt(
        None,
        "Signal in the brightest pixel of a single point. With it, lfcal predicts whether coded frames, in which "
        "several points are lit together, give less noise. If so, the plan of a display uses coded frames.",
        unit="e⁻",
        above=0,
        empty="0.8 of the full well",
        more=True,
    )
    out: Path | None = opt(
        None, "File for the plan of the target (.json).", label="Plan file", short="-o", file="out", empty="not written"
    )

    def __post_init__(self) -> None:
        """Check every value, and the form of the regions."""
        from lfcal.camera import parse_regions

        super().__post_init__()
        if self.regions:
            parse_regions(self.regions)

    @property
    def wishes(self) -> Wishes:
        """Limits that the plan must respect."""
        from lfcal.targets import Wishes

        return Wishes(self.tolerance, self.crosstalk, self.most_frames)

    @property
    def display(self) -> Display | None:
        """The display that shows the points; None for another target."""
        return None

    def _iter_plan(self, scan: ScanPlan) -> Work[TargetPlan]:
        raise NotImplementedError

    def field(self, scan: ScanPlan) -> RegionPlan | None:
        """Return the regions that the frames cover; None for one region.

        Raises
        ------
        InputError
            If the regions do not fit on the sensor.
        """
        from lfcal.camera import RegionPlan, parse_regions

        return RegionPlan.spread(scan, parse_regions(self.regions)) if self.regions else None

    def work(self, run: RunSettings | None = None) -> Work[tuple[TargetPlanned, ...]]:
        """Plan the target, and compare it with a single point."""
        planned = yield from self.iter_planned(scan_of(self.plan))
        write_plan(planned.plan, self.out)
        return (planned,)

    def iter_planned(self, scan: ScanPlan) -> Work[TargetPlanned]:
        """Plan the target for ``scan`` instead of the plan in the file, and write nothing."""
        from lfcal.targets import coding_verdict, planned_for_display

        self.field(scan)  # raises before the frames are chosen
        plan = yield from self._iter_plan(scan)
        verdict = coding_verdict(plan, signal_e=self.signal)
        if verdict is None and self.signal is not None:
            wanted = "at least two points, and enough frames to show some of them together"
            frames = len(plan.offsets_px[len(scan.depths_um) // 2])
            got = (
                f"{format_count(len(plan.target.holes), 'point', 'points')}, and "
                f"{format_count(frames, 'frame', 'frames')} in a plane"
            )
            raise InputError.expected("target for coded frames", wanted, got, "leave the signal out (--signal)")
        if self.display is not None:
            plan = planned_for_display(plan, self.display, verdict)
        return self.planned(plan, verdict)

    def planned(self, plan: TargetPlan, verdict: CodingVerdict | None) -> TargetPlanned:
        """Return ``plan`` with its cost, compared with that of a single point."""
        from lfcal.targets import facts_of_plan

        single, field = self.forecast(plan.scan), self.field(plan.scan)
        facts = facts_of_plan(plan, plan.forecast(**self.rates), single, verdict, field)
        return TargetPlanned(task=self, plan=plan, forecast=single, facts=facts, verdict=verdict)


@record
class PlanTarget(_PlanTarget):
    """Plan the frames of a target of many points that show the positions of a scan.

    Examples
    --------
    >>> from lfcal.tasks import PlanDisplay, PlanTarget
    >>> task = PlanTarget(plan="session/plan.json", source="array:3x3@2mm", tolerance=0.5, most_frames=3)
    >>> (planned,) = task.run()
    >>> print(planned.facts["frames"], "frames of", planned.facts["target"])
    6 frames of array:3x3@2000um
    >>> other = PlanDisplay(plan="session/plan.json", source="display:2000x2000@5um", patterns="shown")
    """

    input_words: ClassVar[str] = "a target that a stage moves"

    pose: str = opt(
        "",
        "Pose of the target: rotation=1,tilt_right=2,tilt_down=0 (degrees), right=0.3mm,down=0,away=0.",
        empty="as in its file, else not rotated or tilted",
    )
    pose_within: str = opt(
        "",
        "Largest error of each value of the pose, in the format of the pose. The pose is then fitted.",
        empty="zero: the pose is known",
        more=True,
    )

    def __post_init__(self) -> None:
        """Check every value, and that target and pose can be parsed."""
        from lfcal.targets import Pose, parse_target, proposed_hole

        super().__post_init__()
        if not _is_file(self.source) and proposed_hole(self.source) is None:
            parse_target(self.source)
        for pose in (self.pose, self.pose_within):
            Pose.parse(pose)

    def _iter_plan(self, scan: ScanPlan) -> Work[TargetPlan]:
        from lfcal.targets import Pose, Target, iter_plan_target, parse_target, propose_target, proposed_hole

        if _is_file(self.source):
            target = Target.from_json(read_text(Path(self.source)))
        elif (hole := proposed_hole(self.source)) is not None:
            target = propose_target(scan, self.wishes, hole_um=hole)
        else:
            target = parse_target(self.source)
        if self.pose:
            target = replace(target, pose=Pose.parse(self.pose))
        if self.pose_within:
            target = replace(target, within=Pose.parse(self.pose_within))
        return (yield from iter_plan_target(scan, target, self.wishes))


@record
class PlanDisplay(_PlanTarget):
    """Plan the images of a display that replace the scan of a point source."""

    input_words: ClassVar[str] = "a display"

    patterns: Path | None = opt(
        None,
        "Folder for the images that the display shows (frame_0000.png and so on).",
        label="Folder of images",
        file="out",
        empty="not written",
    )

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        The images of an earlier plan in the same folder are included, because they are replaced.
        """
        from lfcal.targets import pictures_in

        files, folder = super().files(way), self.patterns
        if way == "in" or folder is None:
            return files
        pictures = dict.fromkeys((folder / "frame_0000.png", *pictures_in(folder)))
        return (*(path for path in files if path != folder), *pictures)

    @property
    def display(self) -> Display:
        """Display that shows the points."""
        from lfcal.targets import parse_display

        found = parse_display(self.source)
        if found is None:
            raise InputError.expected(
                "source", "display:ROWSxCOLUMNS@PITCH", repr(self.source), "write it in the form display:2160x3840@8um"
            )
        return found

    def _iter_plan(self, scan: ScanPlan) -> Work[TargetPlan]:
        from lfcal.targets import iter_plan_display

        return (yield from iter_plan_display(scan, self.display, self.wishes))

    def work(self, run: RunSettings | None = None) -> Work[tuple[TargetPlanned, ...]]:
        """Plan the frames, and write the images that the display shows if a folder is given."""
        from lfcal.targets import write_pictures

        (made,) = yield from super().work(run)
        if self.patterns is not None:
            made.facts["patterns"] = write_pictures(made.plan, self.display, self.patterns)
        return (made,)


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return the class of the task that plans the ``given`` target."""
    return PlanDisplay if str(given["source"]).strip().startswith(DISPLAY) else PlanTarget


PLAN_TARGET = TaskSet(
    "plan target",
    (PlanTarget, PlanDisplay),
    kind_of,
    "lfcal plan target plan.json array:12x12@1.2mm,hole=20um -o target.json",
)
