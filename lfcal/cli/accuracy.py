"""``lfcal accuracy``: measure what accuracy costs for a camera, a scan plan or H."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError, check_number
from lfcal.cli._console import print_json, print_result, print_table, report, run_work
from lfcal.cli._options import MATRICES, ForceOption, JsonOption, MatOrderOption, WorkersOption
from lfcal.cli._usage import refuse
from lfcal.records import read_as, read_cutout, read_depths, read_share, read_virtual_depths
from lfcal.tasks import check_mat_files, check_output, open_matrix

if TYPE_CHECKING:
    from lfcal.accuracy import AccuracyPart, Curve, Subject


def command(
    context: typer.Context,
    subject: str = typer.Argument(
        ..., help="H file, scan plan (.json), preset or camera file; or list, to print the names for --part."
    ),
    depths: str = typer.Option(
        "", help="Depths of the planes (µm, or with a unit), positive away from the camera: a,b,c or start:stop:step."
    ),
    virtual_depths: str = typer.Option(
        "",
        help="Virtual depths of the planes, each the distance of its image from the lenslets divided by the gap: a,b,c "
        "or start:stop:step.",
    ),
    cutout: str = typer.Option(
        "", help="Size of the cutout, odd: 181 or ROWS,COLUMNS (px); default: from the geometry."
    ),
    *,
    part: list[str] = typer.Option(
        [], "--part", help="Part of the processing to measure, by its name in `lfcal accuracy list`; may be repeated."
    ),
    error: str = typer.Option("1%", "--error", help="Error for which to report the cost, such as 1% or 0.01."),
    seconds: float = typer.Option(
        10.0,
        "--seconds",
        help="Approximate time limit of each part (s). A reference is not begun if it is expected to take longer than "
        "twice this time, or 20 s if that is more.",
    ),
    draw: Path | None = typer.Option(None, "--draw", help="File for a plot of all curves (.png)."),
    mat_order: MatOrderOption = "",
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Measure curves of error against seconds, bytes or frames, and report the cost of an error.

    Ctrl-C ends the measurement; results measured until then are printed.

    Example: `lfcal accuracy bench --virtual-depths 3,4,5 --part storage --part solvers --draw cost.png`
    """
    from lfcal.accuracy import PARTS, draw_curves

    for reason in PARTS.failures().values():
        report(f"left out: {reason}")
    if subject == "list":
        measuring = ("depths", "virtual_depths", "cutout", "part", "error", "seconds", "draw", "mat_order")
        refuse(context, "a camera, plan or H to measure", "list", *measuring)
        heads = ("name", "title", "error", "cost")
        listed = [{head: getattr(one, head) for head in heads} for one in PARTS]
        print_result(listed, ["part", "", "error", "cost"], [list(one.values()) for one in listed], json=json)
        return
    share = read_as("--error", read_share, error)
    check_number("--error", share, above=0, at_most=10)
    check_mat_files(mat_order, Path(subject))
    chosen = [PARTS.get(name) for name in dict.fromkeys(part)] or list(PARTS)
    if draw is not None:
        check_output(draw, subject, force=force)
    with _subject(subject, (depths, virtual_depths, cutout), workers, mat_order=mat_order, quiet=json) as measured:
        curves, ended = _measured(chosen, measured, seconds, share, quiet=json)
        if json:
            answers = {one.part: {"words": one.answer(share), "point": one.cheapest(share)} for one in curves}
            facts = {"subject": measured.name, "error": share, "seconds": seconds}
            print_json(facts | {"curves": curves, "answers": answers})
        if draw is not None and any(curve.points for curve in curves):
            draw_curves(curves, draw, f"What accuracy costs: {measured.name}", error=share)
            if not json:
                typer.echo(f"drawn: {draw}")
    if ended is not None:
        raise ended
    if not any(curve.points for curve in curves):
        raise InputError(
            f"{measured.name}: nothing could be measured; {curves[0].stopped or 'choose other parts (--part)'}"
        )


def _measured(
    parts: list[AccuracyPart], subject: Subject, seconds: float, share: float, *, quiet: bool
) -> tuple[list[Curve], BaseException | None]:
    """Measure part after part, and print each result; return the exception that ended the measurement, if any."""
    from lfcal.accuracy import iter_measure_curve

    curves: list[Curve] = []
    for number, part in enumerate(parts):
        kept: deque[Any] = deque(maxlen=1)
        ended: BaseException | None = None
        try:
            work = iter_measure_curve(part, subject, seconds, number=number, total=len(parts))
            curves.append(run_work(work, quiet=quiet, seen=kept.append))
        except Exception:
            raise
        except BaseException as end:  # Ctrl-C and signals: results measured until then are shown first
            ended = end
            curves += [record.curve for record in kept]
        if len(curves) > number and not quiet:
            _show(curves[number], share)
        if ended is not None:
            return curves, ended
    return curves, None


@contextmanager
def _subject(
    name: str, planes: tuple[str, str, str], workers: int | None, *, mat_order: str, quiet: bool
) -> Iterator[Subject]:
    """Yield the subject to measure: H, which is closed at the end, or a plan."""
    from lfcal.accuracy import Subject
    from lfcal.tasks import note_assumed, planned_scan

    path = Path(name)
    if path.suffix.lower() not in MATRICES:
        depths, virtual_depths, cutout = planes
        plan = planned_scan(
            name,
            read_as("--depths", read_depths, depths),
            read_as("--virtual-depths", read_virtual_depths, virtual_depths),
            read_as("--cutout", read_cutout, cutout),
        )
        yield Subject(f"{plan.camera.name}, {len(plan.depths_um)} planes", plan, workers=workers)
        return
    if any(planes):
        raise InputError(
            "--depths, --virtual-depths, --cutout: these options do not apply, because H states its planes and cutout; "
            "leave them out"
        )
    with open_matrix(path, mat_order=mat_order) as matrix:
        note_assumed(matrix.camera, path.name, quiet=quiet)
        yield Subject.of_matrix(matrix, path.name, workers)


def _show(curve: Curve, share: float) -> None:
    """Print one curve as a table, its meaning, and the cost of the requested error."""
    from lfcal.accuracy import format_cost, marks_of

    longer = "; --seconds measures longer" if curve.stopped.startswith(("ended after", "not begun")) else ""
    if not curve.points:
        reason = curve.stopped or "stopped before the first measurement"
        typer.echo(f"{curve.title}: not measured: {reason}{longer}\n")
        return
    names = list(dict.fromkeys(name for point in curve.points for name in point.others))
    chosen = curve.cheapest(share)
    rows = []
    for point in curve.points:
        mark = ", ".join(marks_of(point, chosen))
        others = [f"{point.others[name]:.4g}" if name in point.others else "—" for name in names]
        words = [point.label, curve.error_text(point.error, share), format_cost(point.cost, curve.unit), *others]
        rows.append([*words, "; ".join(filter(None, (mark, point.note)))])
    print_table(["", "error", "cost", *names, " "], rows, title=curve.title)
    typer.echo(f"error: {curve.error}; cost: {curve.cost}")
    typer.echo(f"measured by: {curve.truth}")
    for note in curve.notes:
        typer.echo(f"  {note}")
    if curve.stopped:
        typer.echo(f"  {curve.stopped}{longer}")
    typer.echo(f"{curve.answer(share)}\n")
