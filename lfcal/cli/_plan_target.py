"""``lfcal plan --source``: how a target of many points shows the positions of a scan with few frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from lfcal.base import InputError, format_length, format_seconds, format_share, read_text, replace_whole
from lfcal.cli._console import print_json, print_table, report, run_work
from lfcal.cli._plan_pace import WITHOUT_READOUT, Pace
from lfcal.tasks import check_outputs

if TYPE_CHECKING:
    from lfcal.camera import RegionPlan, ScanPlan
    from lfcal.multiplex import CodingVerdict
    from lfcal.targets import Display, Target, TargetPlan, Wishes

__all__ = [
    "CrosstalkOption",
    "MostFramesOption",
    "PatternsOption",
    "PhaseOption",
    "PoseOption",
    "SignalOption",
    "SourceOption",
    "TargetWanted",
    "WithinOption",
    "plan_source",
]

SourceOption: TypeAlias = Annotated[
    str,
    typer.Option(
        "--source",
        help="Points of a target in one frame: array:12x12@1.2mm,hole=20um (hex; ROWxCOLUMN pitches), a target's .json "
        "file, or array alone: the pitch that needs the fewest frames; display:2160x3840@8um: pixels of a display.",
    ),
]
"""What is put before the camera."""

PhaseOption: TypeAlias = Annotated[
    float | None, typer.Option("--tolerance", help="With --source: how far off a phase may be (px); 0.1.")
]
"""How well positions are met."""

CrosstalkOption: TypeAlias = Annotated[
    float | None, typer.Option("--crosstalk", help="With --source: most light of neighbours in a cutout; 0.005.")
]
"""How far apart holes must be."""

PoseOption: TypeAlias = Annotated[
    str,
    typer.Option(
        "--pose",
        help="With --source: how it lies, rotation=1,tilt_right=2,tilt_down=0 (degrees), right=0.3mm,down=0,away=0.",
    ),
]
"""Where the target is, as far as that is known."""

WithinOption: TypeAlias = Annotated[
    str, typer.Option("--pose-within", help="With --source: by how much these may be off, in the same words.")
]
"""How badly the pose is known."""

MostFramesOption: TypeAlias = Annotated[
    int | None, typer.Option("--most-frames", min=1, help="With --source: no more frames a plane; coverage is printed.")
]
"""A session that must end."""


SignalOption: TypeAlias = Annotated[
    float | None,
    typer.Option(
        "--signal",
        help="With --source: electrons of a point's brightest pixel in a frame, by which it is told whether showing "
        "several frames of a target at once pays; 0.8 of the full well. A display is planned so where it does.",
    ),
]
"""How bright points are."""

PatternsOption: TypeAlias = Annotated[
    Path | None,
    typer.Option("--patterns", help="With --source display:…: folder for what it shows, frame_0000.png …"),
]
"""Where pictures for a display go."""


@dataclass(frozen=True)
class TargetWanted:
    """Which target is to be planned, by the options' words."""

    source: str
    tolerance: float | None
    crosstalk: float | None
    pose: str
    within: str
    most_frames: int | None
    pace: Pace
    signal_e: float | None = None
    patterns: Path | None = None

    @property
    def path(self) -> Path | None:
        """The file that describes the target, where it is one."""
        return Path(self.source) if self.source.endswith(".json") else None

    def check(self, *, for_fit: bool, half_cell: bool, listed: bool, force: bool) -> None:
        """Raise where options go without a target, a target does not go with others, or pictures would be replaced."""
        given = {
            "--tolerance": self.tolerance,
            "--crosstalk": self.crosstalk,
            "--pose": self.pose or None,
            "--pose-within": self.within or None,
            "--most-frames": self.most_frames,
            "--signal": self.signal_e,
            "--patterns": self.patterns,
        }
        names = [name for name, value in given.items() if value is not None]
        if not self.source and names:
            raise InputError(f"{names[0]}: is of a target of many points; name it with --source")
        shown = self.display() is not None
        if self.patterns is not None and not shown:
            raise InputError("--patterns: is of a display; name it with --source display:ROWSxCOLUMNS@PITCH")
        moved = {"--pose": self.pose, "--pose-within": self.within}
        if shown and any(moved.values()):
            name = next(name for name, value in moved.items() if value)
            raise InputError(f"{name}: is of a target that a stage moves; a display is planned straight, leave it out")
        if self.patterns is not None:
            from lfcal.cli.plan_coding import patterns_in

            check_outputs([self.patterns / "frame_0000.png", *patterns_in(self.patterns)], force=force)
        beside = {"--for-fit": for_fit, "--half-cell": half_cell, "--positions": listed}
        if self.source and any(beside.values()):
            name = next(name for name, there in beside.items() if there)
            raise InputError(f"{name}: is of single points; leave it out beside --source")

    def display(self) -> Display | None:
        """Return the display whose pixels are the target; None where it is none."""
        if not self.source.startswith("display"):
            return None
        from lfcal.targets import parse_display

        return parse_display(self.source)

    def wishes(self) -> Wishes:
        """Return what the plan must keep."""
        from lfcal.targets import Wishes

        given = {"tolerance_px": self.tolerance, "crosstalk": self.crosstalk, "most_frames": self.most_frames}
        return Wishes(**{name: value for name, value in given.items() if value is not None})  # type: ignore[arg-type]

    def target(self, scan: ScanPlan) -> Target:
        """Return the target: described, read, or proposed for the scan."""
        from lfcal.targets import Pose, Target, parse_target, propose_target, proposed_hole

        if self.path is not None:
            found = Target.from_json(read_text(self.path))
        elif (hole := proposed_hole(self.source)) is not None:
            found = propose_target(scan, self.wishes(), hole_um=hole)
        else:
            found = parse_target(self.source)
        if self.pose:
            found = replace(found, pose=Pose.parse(self.pose))
        return replace(found, within=Pose.parse(self.within)) if self.within else found


def plan_source(scan: ScanPlan, wanted: TargetWanted, regions: str, out: Path | None, *, json: bool) -> None:
    """Plan the target, write the plan where asked, and print it beside the scan of a single point.

    ``regions`` are those of the field, in the words of ``--regions``, that frames of a target serve all at once.
    """
    # a speed that makes no sense must not wait for the plan
    from lfcal.camera import RegionPlan, parse_regions
    from lfcal.cli.plan_coding import coding_facts, coding_verdict, planned_for_display, write_patterns
    from lfcal.targets import iter_plan_display, iter_plan_target, shown_within

    wanted.pace.forecast(scan)
    field = RegionPlan.spread(scan, parse_regions(regions)) if regions else None
    display = wanted.display()
    if display is None:
        plan = run_work(iter_plan_target(scan, wanted.target(scan), wanted.wishes()), quiet=json)
    else:
        plan = run_work(iter_plan_display(scan, display, wanted.wishes()), quiet=json)
    verdict = coding_verdict(plan, signal_e=wanted.signal_e)
    if verdict is None and wanted.signal_e is not None:
        raise InputError("--signal: is of frames shown at once; here are too few, or of one point: leave it out")
    if display is not None:
        plan = planned_for_display(plan, display, verdict)
    unsure = None
    if not plan.target.within.known:
        unsure = [shown_within(plan, z) for z in range(len(scan.depths_um))]
    if out is not None:
        with replace_whole(out) as part:
            part.write_text(plan.to_json(), encoding="utf-8")
    facts = _facts(plan, wanted.pace, unsure) | {"expected_error": _expected(plan), "coding": coding_facts(verdict)}
    if display is not None and wanted.patterns is not None:
        facts["patterns"] = write_patterns(plan, display, wanted.patterns)
    if field is not None:
        facts["regions"] = _regions(plan, field, wanted.pace)
    if json:
        print_json(facts)
        return
    _show(plan, facts)
    _show_coding(plan, verdict, display)
    if out is not None:
        typer.echo(f"written: {out}")


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


def _show_regions(found: dict[str, Any]) -> None:
    """Print how many points each region has, and what is to be done with them."""
    rows = []
    for one in found["regions"]:
        (row, column), points = one["anchor"], one["points"]
        all_of = f"{points[0]}" if len(points) == 1 else f"{min(points)} … {max(points)}"
        rows.append([one["name"], f"{row:g}, {column:g}", str(one["fewest_points"]), all_of])
    head = ["region", "anchor (row, column)", "points a frame, at least", "points a plane"]
    print_table(head, rows, title=f"{len(rows)} regions, all in the same frames")
    single = found["single_point"]
    hours = format_seconds(3600 * single["hours"])
    typer.echo(f"a single point would need {single['frames']} frames for these regions, {hours}")
    typer.echo("H of every region: lfcal fit FRAMES --regions, in the same words")
    empty = [one["name"] for one in found["regions"] if not min(one["points"])]
    if empty:
        report(f"note: no point lies near {', '.join(empty)}: H there is what the rest of the field tells")


def _expected(plan: TargetPlan) -> list[dict[str, Any]]:
    """Return, for each plane, what noise leaves of a pattern by a single point, and of those shown frame by frame."""
    from lfcal.targets import error_forecast

    found = [error_forecast(plan, z) for z in range(len(plan.scan.depths_um))]
    return [{"single_point": one.single, "shown": one.shown, "error": one.error} for one in found]


def _show_expected(found: dict[str, Any], depth_um: float) -> None:
    """Print phases shown and expected error of a plane after some of its frames."""
    count = len(found["shown"])
    chosen = sorted({max(1, round(count * share)) for share in (0.25, 0.5, 0.75, 1.0)})
    rows = [[str(n), format_share(found["shown"][n - 1]), format_share(found["error"][n - 1])] for n in chosen if count]
    rows.append(["a single point", "100 %", format_share(found["single_point"])])
    title = f"expected error of a pattern by noise, plane {format_length(depth_um)}"
    print_table(["frames", "phases shown", "error of a pattern"], rows, title=title)


def _show_coding(plan: TargetPlan, verdict: CodingVerdict | None, display: Display | None) -> None:
    """Print whether showing several frames at once pays, and for a display what it shows."""
    from lfcal.cli.plan_coding import coding_words, display_words

    if verdict is not None:
        typer.echo(coding_words(verdict))
    if display is not None:
        typer.echo(display_words(plan, display))


def _show(plan: TargetPlan, facts: dict[str, Any]) -> None:
    head = ["plane", "frames", "at least", "points a frame", "phases shown", "crosstalk"]
    rows = []
    for depth, found in zip(plan.scan.depths_um, facts["planes"], strict=True):
        few, many = found["points_a_frame"]
        points = f"{few}" if few == many else f"{few} … {many}"
        shown, crossing = format_share(found["coverage"]), format_share(found["crosstalk"])
        rows.append([format_length(depth), str(found["frames"]), str(found["least_frames"]), points, shown, crossing])
    ny, nx = plan.scan.period
    print_table(head, rows, title=f"{ny * nx} phases within {plan.tolerance_px:g} px by {facts['target']}")
    single, hours = facts["single_point"], facts["hours"]
    rows = [
        ["this target", str(facts["frames"]), format_seconds(3600 * hours)],
        ["a single point", str(single["frames"]), format_seconds(3600 * single["hours"])],
    ]
    unread = "" if facts["readout_hours"] is not None else f" {WITHOUT_READOUT}"
    print_table(["source", "frames", f"time in all{unread}"], rows)
    middle = len(facts["expected_error"]) // 2
    _show_expected(facts["expected_error"][middle], plan.scan.depths_um[middle])
    if "regions" in facts:
        _show_regions(facts["regions"])
    for found in facts["planes"]:
        drawn = found["coverage_within_pose"]
        if drawn is not None:
            report(
                f"note: with the pose within these bounds {format_share(float(drawn.mean()))} of the phases are shown "
                f"({format_share(float(drawn.min()))} at worst of {len(drawn)} poses drawn): record one frame, measure "
                "the pose, and plan again with it"
            )
            break
    if plan.tails == "geometric":
        report("note: crosstalk is by rays, whose patterns end")
    if min(found["coverage"] for found in facts["planes"]) < 1:
        report("note: not all phases are shown: record the rest with other offsets, or fit the optics to what is shown")
