"""``python -m benchmarks solvers``: error of every solver against processor time, by camera and scene."""

from __future__ import annotations

import os
from pathlib import Path

import typer

from lfcal.cli._console import print_json, print_table, report
from lfcal.cli._options import ForceOption, JsonOption, WorkersOption

__all__ = ["register"]


def register(bench: typer.Typer) -> None:
    """Add ``solvers`` to the benchmarks."""
    bench.command("solvers")(command)


def command(
    *,
    camera: str = typer.Option("lfm_60x12,bench,r29-like", "--camera", help="Cameras: A,B,C."),
    scene: str = typer.Option("beads,sheet,shell", "--scene", help="Scenes: A,B,C."),
    solver: str = typer.Option("", "--solver", help="Solvers: A,B,C; default: all."),
    full: bool = typer.Option(False, "--full", help="Larger images, and three times as many iterations."),
    table: Path | None = typer.Option(None, "--table", help="File for the table (Markdown)."),
    chart: Path | None = typer.Option(
        None, "--chart", help="File for a plot of the error against processor time (.png)."
    ),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Reconstruct beads, a tilted sheet and a shell with every solver, and compare errors after equal times.

    Example: `python -m benchmarks solvers --chart solvers.png --table solvers.md`
    """
    from benchmarks._solver_scenes import CAMERAS, SCENES, problem_of, subject_of
    from benchmarks._solver_tables import draw, markdown, rows_of, verdict
    from benchmarks._solver_trials import UNITS, Trial, trial, unit_of
    from lfcal.base.files import replace_whole
    from lfcal.reconstruct import Projector
    from lfcal.reconstruct.solvers.choice import SOLVERS
    from lfcal.tasks import check_output

    names = _names("--camera", camera, tuple(CAMERAS)), _names("--scene", scene, tuple(SCENES))
    tried = _names("--solver", solver, tuple(SOLVERS.names())) if solver else tuple(SOLVERS.names())
    for path in (table, chart):
        if path is not None:
            check_output(path, force=force)
    trials: list[Trial] = []
    for name in names[0]:
        subject = subject_of(name, 132 if full else 0)
        P = Projector(subject.sought, (subject.side, subject.side), workers=workers).prepare()
        unit = unit_of(P, problem_of(subject, names[1][0]))
        for one in names[1]:
            problem = problem_of(subject, one)
            for k, kind in enumerate(tried):
                trials.append(trial(subject, P, problem, (one, kind), unit, (3 if full else 1) * UNITS[-1]))
                if not json:
                    report(f"{name}, {one}: {kind} ({k + 1} of {len(tried)})")
    if table is not None:
        with replace_whole(table) as part:
            part.write_text(markdown(trials, *_origin(table, chart, full=full)), encoding="utf-8")
    if chart is not None:
        draw(chart, trials)
    if json:
        print_json({"trials": trials, "wins": verdict(trials)})
        return
    for name in names[0]:
        headers, rows = rows_of([one for one in trials if one.camera == name])
        print_table(headers, rows, title=name)
    for line in verdict(trials):
        typer.echo(line)


def _origin(table: Path, chart: Path | None, *, full: bool) -> tuple[str, str]:
    """Return the command that makes the page ``table``, and its link to the chart."""
    words = ["python -m benchmarks solvers", *(["--full"] if full else [])]
    if chart is not None:
        words.append(f"--chart {chart.as_posix()}")
    link = "" if chart is None else Path(os.path.relpath(chart, table.parent)).as_posix()
    return " ".join([*words, f"--table {table.as_posix()} --force"]), link


def _names(option: str, text: str, known: tuple[str, ...]) -> tuple[str, ...]:
    from lfcal.base.checks import check_choice

    found = tuple(part.strip() for part in text.split(","))
    for name in found:
        check_choice(option, name, known)
    return found
