"""``lfcal fit``: the optics retrieved from measured patterns."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli.options import ForceOption, JsonOption, WorkersOption
from lfcal.errors import InputError

if TYPE_CHECKING:
    from lfcal.fit import Fit, Measured
    from lfcal.fit.hybrid import HybridSummary
    from lfcal.progress import Work
    from lfcal.psf import PSFMatrix

__all__ = ["register"]

CAMERA, EFFECTS, MODEL, NUMBERS, REPORT = "camera.json", "effects.json", "H.h5", "fit.json", "report"


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
    positions: int = typer.Option(40, "--positions", min=0, help="Positions that are used, spread evenly; 0: all."),
    noise: str = typer.Option(
        "", "--noise", help="CONSTANT,SLOPE: a sample of value v has the variance constant + slope v."
    ),
    no_h: bool = typer.Option(False, "--no-h", help="Do not compute H of the fitted camera."),
    hybrid: bool = typer.Option(
        False, "--hybrid", help="H.h5 is the model and what recorded patterns show beyond it, with its uncertainty."
    ),
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
    from lfcal.cli.fit_source import Reading, is_matrix, open_upright, parse_noise, read_patterns
    from lfcal.cli.orientation import check_choice
    from lfcal.fit import iter_fit_camera
    from lfcal.fit.files import fit_dict
    from lfcal.frames import CorrectionRecipe

    check_choice(orientation)
    if hybrid and no_h:
        raise InputError.expected("--hybrid", "an H to write", "--no-h", "leave one of them out")
    groups = unknowns if unknowns == "auto" else _groups(unknowns)
    _check_before(out, source, camera, plan, dark, white, no_h=no_h, force=force)
    recipe = CorrectionRecipe(dark=dark, black_level=black_level, white=white or "")
    start = load_camera(camera) if camera else None
    how = Reading(start, positions, parse_noise(noise), plan, recipe, orientation)
    measured, known = read_patterns(source, how, quiet=json)
    fit = run_work(iter_fit_camera(measured, start, groups, workers=workers), quiet=json)
    with ExitStack() as stack:
        patterns: PSFMatrix | Measured | None = None
        if hybrid:
            # of an H every recorded pattern, not those alone that were fitted
            patterns = stack.enter_context(open_upright(source)) if is_matrix(source) else measured
        written, summary = run_work(
            _iter_write(fit, measured, out, known, patterns, how.noise, with_h=not no_h, workers=workers), quiet=json
        )
    if json:
        made = {} if summary is None else {"hybrid": asdict(summary)}
        print_json(fit_dict(fit) | made | {"source": source, "files": written})
    else:
        _show(fit, out, written, summary)


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
    from lfcal.fit.report import report_files

    files = [out / name for name in (MODEL, CAMERA, EFFECTS, NUMBERS)]
    check_outputs([*files, *report_files(out / REPORT)], *inputs, force=force)
    # beside another camera it would be taken for that camera's H
    if no_h and files[0].exists():
        raise InputError.expected(str(files[0]), "no H with --no-h", "one of an earlier fit", "choose another folder")


def _iter_write(
    fit: Fit,
    measured: Measured,
    out: Path,
    known: dict[str, Any],
    patterns: PSFMatrix | Measured | None,
    noise: tuple[float, float] | None,
    *,
    with_h: bool,
    workers: int | None,
) -> Work[tuple[list[Path], HybridSummary | None]]:
    """Write everything that a fit makes; ``fit.json`` comes last: where it is, all of it is.

    ``patterns`` are those of which H is the hybrid; None: H is the model.
    """
    from lfcal.fit.files import (
        effects_text,
        fit_dict,
        iter_write_hybrid,
        iter_write_model,
        json_text,
        measured_camera,
        write_text,
    )
    from lfcal.fit.hybrid import hybrid_note
    from lfcal.fit.report import iter_fit_report

    out.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    summary: HybridSummary | None = None
    if patterns is not None:
        work = iter_write_hybrid(fit, patterns, out / MODEL, noise=noise, provenance=known, workers=workers)
        summary = yield from work
        written.append(out / MODEL)
    elif with_h:
        written.append((yield from iter_write_model(fit, out / MODEL, provenance=known, workers=workers)))
    notes = () if summary is None else (str(summary),)
    written.append((yield from iter_fit_report(fit, measured, out / REPORT, known["source"], notes)))
    texts = {
        CAMERA: measured_camera(fit).to_json(),
        EFFECTS: effects_text(fit),
        NUMBERS: json_text(fit_dict(fit) | ({} if summary is None else hybrid_note(summary)) | known),
    }
    for name, text in texts.items():
        write_text(out / name, text)
        written.append(out / name)
    return written, summary


def _show(fit: Fit, out: Path, written: list[Path], summary: HybridSummary | None) -> None:
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
    if summary is not None:
        typer.echo(str(summary))
    typer.echo(f"{out}: {', '.join(str(path.relative_to(out)) for path in written)}")
