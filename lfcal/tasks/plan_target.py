"""Frames of a target of many points that show the positions of a scan, compared with a single point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Work, read_text
from lfcal.records import opt, read_share, record, required
from lfcal.tasks._pace import Pace, frame_rate, speed
from lfcal.tasks._scan_plan import scan_of, write_plan
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    from lfcal.camera import RegionPlan, ScanPlan
    from lfcal.multiplex import CodingVerdict
    from lfcal.targets import Display, Target, TargetPlan, Wishes

__all__ = ["PLAN_TARGET", "PlanDisplay", "PlanTarget", "TargetPlanned"]

DISPLAY = "display"
"""Beginning of the source that is a display."""


def _is_file(source: str) -> bool:
    return source.endswith(".json")


@dataclass(frozen=True, kw_only=True)
class TargetPlanned(TaskResult):
    """The plan of a target, compared with the scan of a single point.

    Attributes
    ----------
    plan
        The plan.
    facts
        What the frames show and cost, as plain values.
    verdict
        Whether showing several frames together pays; None: there are too few of them.
    display
        The display that shows the points, if it is one.
    files
        Files that were written, without the pictures for a display.
    """

    plan: TargetPlan
    facts: Mapping[str, Any]
    verdict: CodingVerdict | None
    display: Display | None
    files: tuple[Path, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain values."""
        return dict(self.facts)


@record
class _PlanTarget(Task):
    """What all kinds have."""

    name: ClassVar[str] = "plan target"

    plan: Path = required("Scan plan (.json), made by lfcal plan.", argument=True, file="in")
    source: str = required(
        "Points in one frame: array:12x12@1.2mm,hole=20um (hex; ROWxCOLUMN pitches), a file of a target (.json), or "
        "array: the pitch that needs the fewest frames. display:2160x3840@8um: pixels of a display.",
        argument=True,
        label="Target",
        file="in",
        is_path=_is_file,
    )
    tolerance: float = opt(
        0.1, "Largest error of a phase, in rows and in columns.", label="Tolerance", unit="px", above=0, at_most=0.5
    )
    crosstalk: float = opt(
        0.005,
        "Largest share of the light of neighbours in a cutout, relative to the light of its own point.",
        above=0,
        below=1,
        read=read_share,
    )
    most_frames: int | None = opt(
        None,
        "Largest number of frames of a plane; the share of phases that they show is printed.",
        label="Frames, at most",
        at_least=1,
        empty="as many as all phases need",
    )
    regions: str = opt(
        "", "Regions of the field that the frames serve, ROWSxCOLUMNS over the sensor, e.g. 3x3.", empty="one"
    )
    signal: float | None = opt(
        None,
        "Electrons in the brightest pixel of a point, by which coded frames are judged (several shown at once). "
        "Frames of a display are coded if that pays.",
        unit="e",
        above=0,
        empty="0.8 of the full well",
        more=True,
    )
    speed: float = speed()
    frame_rate: float | None = frame_rate()
    out: Path | None = opt(
        None, "Plan of the target to write (.json).", label="Plan file", short="-o", file="out", empty="only shown"
    )

    @property
    def pace(self) -> Pace:
        """Speed of stage and camera."""
        return Pace(self.speed, self.frame_rate)

    @property
    def wishes(self) -> Wishes:
        """What the plan must keep."""
        from lfcal.targets import Wishes

        return Wishes(self.tolerance, self.crosstalk, self.most_frames)

    def _iter_plan(self, scan: ScanPlan) -> Work[TargetPlan]:
        raise NotImplementedError

    def _shown(self) -> Display | None:
        return None

    def _pictures(self, plan: TargetPlan) -> dict[str, Any]:
        """Write what a display shows; return the facts of it."""
        return {}

    def work(self, run: RunSettings | None = None) -> Work[tuple[TargetPlanned, ...]]:
        """Plan the target, and compare it with a single point."""
        from lfcal.camera import RegionPlan, parse_regions
        from lfcal.targets import shown_within
        from lfcal.tasks._coding import coding_verdict, planned_for_display

        scan, pace, display = scan_of(self.plan), self.pace, self._shown()
        field = RegionPlan.spread(scan, parse_regions(self.regions)) if self.regions else None
        plan = yield from self._iter_plan(scan)
        verdict = coding_verdict(plan, signal_e=self.signal)
        if verdict is None and self.signal is not None:
            raise InputError("--signal: is of frames shown at once; here are too few, or of one point: leave it out")
        if display is not None:
            plan = planned_for_display(plan, display, verdict)
        unsure = None
        if not plan.target.within.known:
            unsure = [shown_within(plan, z) for z in range(len(scan.depths_um))]
        write_plan(plan.to_json(), self.out)
        coding = None if verdict is None else verdict.to_dict()
        facts = _facts(plan, pace, unsure) | {"expected_error": _expected(plan), "coding": coding}
        facts |= self._pictures(plan) | ({} if field is None else {"regions": _regions(plan, field, pace)})
        files = () if self.out is None else (self.out,)
        return (TargetPlanned(plan=plan, facts=facts, verdict=verdict, display=display, files=files),)


@record
class PlanTarget(_PlanTarget):
    """Plan the frames of a target of many points that show the positions of a scan.

    Examples
    --------
    >>> from lfcal.tasks import PlanTarget
    >>> task = PlanTarget(plan="session/plan.json", source="array:3x3@2mm", tolerance=0.5, most_frames=3)
    >>> (planned,) = task.run()
    >>> print(planned.facts["frames"], "frames of", planned.facts["target"])
    6 frames of array:3x3@2000um
    """

    input_words: ClassVar[str] = "a target that a stage moves"

    pose: str = opt(
        "",
        "How the target lies: rotation=1,tilt_right=2,tilt_down=0 (degrees), right=0.3mm,down=0,away=0.",
        empty="straight, or as in its file",
    )
    pose_within: str = opt("", "Bounds of the error of the pose, in the same words.", empty="known", more=True)

    def _iter_plan(self, scan: ScanPlan) -> Work[TargetPlan]:
        from lfcal.targets import iter_plan_target

        return (yield from iter_plan_target(scan, self._target(scan), self.wishes))

    def _target(self, scan: ScanPlan) -> Target:
        """Return the target: described, read, or proposed for the scan."""
        from lfcal.targets import Pose, Target, parse_target, propose_target, proposed_hole

        if _is_file(self.source):
            found = Target.from_json(read_text(Path(self.source)))
        elif (hole := proposed_hole(self.source)) is not None:
            found = propose_target(scan, self.wishes, hole_um=hole)
        else:
            found = parse_target(self.source)
        if self.pose:
            found = replace(found, pose=Pose.parse(self.pose))
        return replace(found, within=Pose.parse(self.pose_within)) if self.pose_within else found


@record
class PlanDisplay(_PlanTarget):
    """Plan what a display shows instead of the positions of a scan.

    Examples
    --------
    >>> from lfcal.tasks import PlanDisplay
    >>> task = PlanDisplay(plan="session/plan.json", source="display:2000x2000@5um", patterns="shown")
    >>> print(task.tolerance, task.files("out"))
    0.1 (PosixPath('shown/frame_0000.png'),)
    """

    input_words: ClassVar[str] = "a display"

    patterns: Path | None = opt(
        None,
        "Folder for the pictures that the display shows (frame_0000.png and so on).",
        label="Folder of pictures",
        file="out",
        empty="not written",
    )

    def files(self, way: str) -> tuple[Path, ...]:
        """Return its files; in a folder of pictures, those of an earlier plan are replaced."""
        from lfcal.targets import pictures_in

        files, folder = super().files(way), self.patterns
        if way == "in" or folder is None:
            return files
        pictures = dict.fromkeys((folder / "frame_0000.png", *pictures_in(folder)))
        return (*(path for path in files if path != folder), *pictures)

    def _shown(self) -> Display:
        from lfcal.targets import parse_display

        found = parse_display(self.source)
        if found is None:
            raise InputError.expected("source", "display:ROWSxCOLUMNS@PITCH", repr(self.source), "correct it")
        return found

    def _iter_plan(self, scan: ScanPlan) -> Work[TargetPlan]:
        from lfcal.targets import iter_plan_display

        return (yield from iter_plan_display(scan, self._shown(), self.wishes))

    def _pictures(self, plan: TargetPlan) -> dict[str, Any]:
        from lfcal.targets import write_pictures

        return {} if self.patterns is None else {"patterns": write_pictures(plan, self._shown(), self.patterns)}


def _facts(plan: TargetPlan, pace: Pace, unsure: list[Any] | None) -> dict[str, Any]:
    from lfcal.targets import target_words

    forecast, single = plan.forecast(pace.stage_um_per_s), pace.forecast(plan.scan)
    reading = pace.reading(forecast.frames)
    planes = []
    for z, depth in enumerate(plan.scan.depths_um):
        counts = plan.shown(z)
        planes.append(
            {
                "depth_um": depth,
                "frames": len(plan.offsets_px[z]),
                "least_frames": plan.least_frames(z),
                "points_a_frame": plan.points_a_frame(z),
                "coverage": float((counts > 0).mean()),
                "mean_repeats": float(counts.mean()),
                "crosstalk": plan.crosstalk[z],
                "coverage_within_pose": None if unsure is None else unsure[z],
            }
        )
    return {
        "target": target_words(plan.target),
        "tolerance_px": plan.tolerance_px,
        "tails": plan.tails,
        "planes": planes,
        "frames": forecast.frames,
        "hours": forecast.hours + reading,
        "readout_hours": None if pace.frames_per_s is None else reading,
        "single_point": {"frames": single.frames, "hours": single.hours},
        "plan": plan.to_dict(),
    }


def _regions(plan: TargetPlan, field: RegionPlan, pace: Pace) -> dict[str, Any]:
    """Return what each region has of the frames, and what a single point would need for all of them."""
    from lfcal.targets import region_points

    counts = [region_points(plan, field, z) for z in range(len(plan.scan.depths_um))]
    single = pace.forecast(plan.scan)
    found = [
        {
            "name": name,
            "anchor": field.anchors[k],
            "fewest_points": min((int(one[:, k].min()) for one in counts if len(one)), default=0),
            "points": [int(one[:, k].sum()) for one in counts],
        }
        for k, name in enumerate(field.names)
    ]
    frames = {"frames": len(field) * single.frames, "hours": len(field) * single.hours}
    return {"regions": found, "single_point": frames}


def _expected(plan: TargetPlan) -> list[dict[str, Any]]:
    """Return, for each plane, what noise leaves of a pattern by a single point, and of those shown frame by frame."""
    from lfcal.targets import error_forecast

    found = [error_forecast(plan, z) for z in range(len(plan.scan.depths_um))]
    return [{"single_point": one.single, "shown": one.shown, "error": one.error} for one in found]


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return which kind of target to plan."""
    return PlanDisplay if str(given["source"]).strip().startswith(DISPLAY) else PlanTarget


PLAN_TARGET = TaskSet(
    "plan target",
    (PlanTarget, PlanDisplay),
    kind_of,
    "lfcal plan target plan.json array:12x12@1.2mm,hole=20um -o target.json",
)
