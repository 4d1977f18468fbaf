"""``lfcal plan target``: plan frames of a target of many points that show the positions of a scan."""

from __future__ import annotations

from typing import Any

import typer

from lfcal.base import format_length, format_seconds, format_share
from lfcal.cli._console import print_table, print_written, report
from lfcal.tasks import TargetPlanned


def show(made: tuple[TargetPlanned]) -> None:
    """Print the numbers of frames and the times with the target and with a single point, and the expected error."""
    from lfcal.targets import display_words

    (one,) = made
    plan, facts = one.plan, one.facts
    head = ["plane", "frames", "at least", "points per frame", "phases shown", "crosstalk"]
    rows = []
    for depth, found in zip(plan.scan.depths_um, facts["planes"], strict=True):
        few, many = found["points_a_frame"]
        points = f"{few}" if few == many else f"{few} … {many}"
        shown, crossing = format_share(found["coverage"]), format_share(found["crosstalk"])
        rows.append([format_length(depth), str(found["frames"]), str(found["least_frames"]), points, shown, crossing])
    ny, nx = plan.scan.period
    print_table(head, rows, title=f"{ny * nx} phases within {plan.tolerance_px:g} px by {facts['target']}")
    rows = [
        [name, str(found["frames"]), format_seconds(3600 * found["hours"])]
        for name, found in (("this target", facts), ("a single point", facts["single_point"]))
    ]
    print_table(["source", "frames", f"total time{one.task.unread}"], rows)
    middle = len(facts["expected_error"]) // 2
    _show_expected(facts["expected_error"][middle], plan.scan.depths_um[middle])
    if "regions" in facts:
        _show_regions(facts["regions"])
    _note_what_is_not_shown(one)
    if one.verdict is not None:
        typer.echo(one.verdict.frames_words)
    if one.task.display is not None:
        typer.echo(display_words(plan, one.task.display))
    print_written(one.task.out)


def _note_what_is_not_shown(one: TargetPlanned) -> None:
    planes = one.facts["planes"]
    drawn = planes[0]["coverage_within_pose"]
    if drawn is not None:
        report(
            f"note: with poses within these bounds, {format_share(float(drawn.mean()))} of the phases are shown "
            f"({format_share(float(drawn.min()))} in the worst of {len(drawn)} random poses): record one frame, "
            "measure the pose, and plan again with it"
        )
    if one.plan.tails == "geometric":
        report("note: crosstalk is computed by ray optics, which neglects diffraction")
    if min(found["coverage"] for found in planes) < 1:
        report("note: not all phases are shown: record the others with more frames, or fit the optics to those shown")


def _show_regions(found: dict[str, Any]) -> None:
    """Print the number of points in each region, and how to use them."""
    rows = []
    for one in found["regions"]:
        (row, column), points = one["anchor"], one["points"]
        all_of = f"{points[0]}" if len(points) == 1 else f"{min(points)} … {max(points)}"
        rows.append([one["name"], f"{row:g}, {column:g}", str(one["fewest_points"]), all_of])
    head = ["region", "anchor (row, column)", "points per frame, at least", "points per plane"]
    print_table(head, rows, title=f"{len(rows)} regions, all in the same frames")
    single = found["single_point"]
    hours = format_seconds(3600 * single["hours"])
    typer.echo(f"a single point would need {single['frames']} frames for these regions, {hours}")
    typer.echo("to get H of every region: lfcal fit FRAMES with the same --regions")
    empty = [one["name"] for one in found["regions"] if not min(one["points"])]
    if empty:
        report(f"note: no point lies near {', '.join(empty)}: H there is extrapolated from the rest of the field")


def _show_expected(found: dict[str, Any], depth_um: float) -> None:
    """Print the phases shown and the expected error of a plane after some of its frames."""
    count = len(found["shown"])
    chosen = sorted({max(1, round(count * share)) for share in (0.25, 0.5, 0.75, 1.0)})
    rows = [[str(n), format_share(found["shown"][n - 1]), format_share(found["error"][n - 1])] for n in chosen if count]
    rows.append(["a single point", "100 %", format_share(found["single_point"])])
    title = f"expected error of a pattern by noise, plane {format_length(depth_um)}"
    print_table(["frames", "phases shown", "error of a pattern"], rows, title=title)
