"""``lfcal fit``: the optics retrieved from measured patterns."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lfcal.cli.options import ForceOption, JsonOption, WorkersOption
from lfcal.errors import InputError

if TYPE_CHECKING:
    from lfcal.fit import Fit

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add ``fit`` to the app."""
    app.command("fit")(command)


def command(
    source: Path = typer.Argument(
        help="H file (.h5), of which only recorded positions are used; or a recorded session, a folder of frames, or "
        "one file of many frames."
    ),
    *,
    camera: str = typer.Option("", "--camera", help="Preset or camera file to start from; H's or the plan's own."),
    out: Path = typer.Option(Path("fit"), "--out", "-o", help="Folder to write into."),
    unknowns: str = typer.Option(
        "auto", "--unknowns", help="auto: groups that lower the error of patterns left out; or groups: A,B,C."
    ),
    effects: list[str] = typer.Option(
        [],
        "--effect",
        "--effects",
        help="NAME=on|off|VALUE, or a JSON file: what the camera is simulated with at the start beside what its "
        "description holds, for example index_mismatch=1.38,depth:20um.",
    ),
    positions: int = typer.Option(40, "--positions", min=0, help="Positions that are used, spread evenly; 0: all."),
    noise: str = typer.Option(
        "", "--noise", help="CONSTANT,SLOPE: a sample of value v has the variance constant + slope v."
    ),
    no_h: bool = typer.Option(False, "--no-h", help="Do not compute H of the fitted camera."),
    plan: Path | None = typer.Option(None, "--plan", "-p", help="Scan plan (.json) of frames, if not beside them."),
    dark: str = typer.Option("", "--dark", help="Dark frame or folder of them for frames; none: not even their own."),
    black_level: float | None = typer.Option(
        None, "--black-level", help="Sample value of no light in frames, where there is no dark frame."
    ),
    white: Path | None = typer.Option(None, "--white", help="White image for frames, or a folder of them to average."),
    orientation: str = typer.Option(
        "check", "--orientation", help="What makes frames upright, as in lfcal assemble: as-is, rot90 …, auto, check."
    ),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Find the camera that explains measured patterns: gap, focal lengths, iris, aberrations; and H without noise.

    Writes camera.json, effects.json, H.h5, fit.json and report/ into a folder.

    Example: `lfcal fit H.h5 -o fit/`
    """
    from lfcal.cli.cameras import load_camera
    from lfcal.cli.console import print_json, run_work
    from lfcal.cli.fit_source import Reading, parse_noise, read_patterns
    from lfcal.cli.orientation import check_choice
    from lfcal.fit import iter_fit_camera
    from lfcal.fit.files import fit_dict
    from lfcal.fit.setup import called_for, with_given
    from lfcal.fit.writing import iter_write_fit
    from lfcal.frames import CorrectionRecipe
    from lfcal.simulate.effects.described import parse_effects

    check_choice(orientation)
    groups = unknowns if unknowns == "auto" else _groups(unknowns)
    chosen = parse_effects(effects)
    _check_before(out, source, camera, plan, dark, white, no_h=no_h, force=force)
    recipe = CorrectionRecipe(dark=dark, black_level=black_level, white=white or "")
    start = load_camera(camera) if camera else None
    how = Reading(start, positions, parse_noise(noise), plan, recipe, orientation)
    measured, known = read_patterns(source, how, quiet=json)
    begins = with_given(called_for(measured.plan), *chosen) if effects else None
    fit = run_work(iter_fit_camera(measured, start, groups, effects=begins, workers=workers), quiet=json)
    written = run_work(iter_write_fit(fit, measured, out, known, with_h=not no_h, workers=workers), quiet=json)
    if json:
        print_json(fit_dict(fit) | {"source": source, "files": written})
    else:
        _show(fit, out, written)


def _groups(text: str) -> tuple[str, ...]:
    """Return the names of groups, each one known; before anything is read."""
    from lfcal.fit import GROUPS

    names = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    known = GROUPS.names()
    wrong = [name for name in names if name not in known]
    if wrong or not names:
        got = wrong[0] if wrong else repr(text)
        raise InputError.expected("--unknowns", "auto or groups of unknowns", got, f"groups are {', '.join(known)}")
    return names


def _check_before(out: Path, *inputs: Path | str | None, no_h: bool, force: bool) -> None:
    """Raise where an output cannot be written, is an input, or exists."""
    from lfcal.cli.outputs import check_outputs
    from lfcal.fit.writing import MODEL, fit_outputs

    check_outputs(fit_outputs(out), *inputs, force=force)
    # beside another camera it would be taken for that camera's H
    matrix = out / MODEL
    if no_h and matrix.exists():
        raise InputError.expected(str(matrix), "no H with --no-h", "one of an earlier fit", "choose another folder")


def _show(fit: Fit, out: Path, written: list[Path]) -> None:
    from lfcal.cli.console import print_table, report

    rows = [
        [one.name, f"{one.value:.6g}", f"{one.sigma:.2g}", f"{one.start:.6g}", one.unit]
        for one in fit.parameters.values()
    ]
    print_table(["parameter", "found", "±", "described", "unit"], rows)
    typer.secho(fit.verdict, fg=typer.colors.GREEN if fit.complete else typer.colors.RED, bold=True)
    for name, answer in fit.answers.items():
        report(f"note: {name}: {answer}")
    for one in fit.outliers:
        report(f"left out: (z, y, x) = ({one.z}, {one.y}, {one.x}): {one.reason}")
    for combination in fit.unidentified:
        report(f"note: this scan does not tell apart: {combination}")
    typer.echo(f"{out}: {', '.join(str(path.relative_to(out)) for path in written)}")
