"""``lfcal fit``: the optics retrieved from measured patterns."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lfcal.base import InputError
from lfcal.cli._options import (
    ExecutorOption,
    ForceOption,
    JsonOption,
    ResumeOption,
    SchedulerOption,
    WorkersOption,
    parse_groups,
)

if TYPE_CHECKING:
    from lfcal.fit import Fit, HybridSummary, Measured
    from lfcal.psf import PSFMatrix

__all__ = ["register"]

FOLDER = Path("fit")


def register(app: typer.Typer) -> None:
    """Add ``fit`` to the app."""
    app.command("fit")(command)


def command(
    sources: list[Path] = typer.Argument(
        metavar="SOURCE...",
        help="H file (.h5), of which only recorded positions are used; or a recorded session, a folder of frames, or "
        "one file of many frames. Several are regions of the field of one camera. With --check new frames.",
    ),
    *,
    camera: str = typer.Option("", "--camera", help="Preset or camera file to start from; H's or the plan's own."),
    out: Path = typer.Option(FOLDER, "--out", "-o", help="Folder to write into."),
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
    positions: int | None = typer.Option(
        None,
        "--positions",
        min=0,
        help="Positions that are used, spread evenly; 0: all. By default 40, or all of a session of chosen positions.",
    ),
    noise: str = typer.Option(
        "", "--noise", help="CONSTANT,SLOPE: a sample of value v has the variance constant + slope v."
    ),
    check: Path | None = typer.Option(
        None, "--check", help="Old H (.h5) that the new frames are held against; nothing is fitted or written."
    ),
    limit: float | None = typer.Option(
        None, "--limit", help="With --check: error up to which H holds (percent), 2 by default."
    ),
    validate: bool = typer.Option(
        False, "--validate", help="Predict recorded positions that were not fitted: error of each, validation.json."
    ),
    validate_on: Path | None = typer.Option(
        None, "--validate-on", help="Predict the points of another session or H: at other places of the field."
    ),
    known_object: Path | None = typer.Option(
        None, "--object", help="Frame of a known object, which H as found must predict; with --scene."
    ),
    scene: Path | None = typer.Option(None, "--scene", help="The known object: volume (.tif, .h5, .npy) as H sees it."),
    no_h: bool = typer.Option(False, "--no-h", help="Do not compute H of the fitted camera."),
    hybrid: bool = typer.Option(
        False, "--hybrid", help="H.h5 is the model and what recorded patterns show beyond it, with its uncertainty."
    ),
    plan: Path | None = typer.Option(None, "--plan", "-p", help="Scan plan (.json) of frames, if not beside them."),
    regions: str = typer.Option(
        "", "--regions", help="Of a target's frames: H of several regions in one file, ROWSxCOLUMNS, e.g. 3x3."
    ),
    dark: str = typer.Option("", "--dark", help="Dark frame or folder of them for frames; none: not even their own."),
    black_level: float | None = typer.Option(
        None, "--black-level", help="Sample value of no light in frames, where there is no dark frame."
    ),
    white: Path | None = typer.Option(None, "--white", help="White image for frames, or a folder of them to average."),
    orientation: str = typer.Option(
        "check", "--orientation", help="What makes frames upright, as in lfcal assemble: as-is, rot90 …, auto, check."
    ),
    workers: WorkersOption = None,
    executor: ExecutorOption = "",
    scheduler: SchedulerOption = "",
    resume: ResumeOption = False,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Find the camera that explains measured patterns: gap, focal lengths, iris, aberrations; and H without noise.

    Writes camera.json, effects.json, H.h5, fit.json and report/ into a folder. Several sources are regions of the field
    of one camera: how its wavefront changes over the field is found too, and each has a folder of its own. With --check
    it says whether an old H still holds; exit code 1: it does not, or the frames do not tell. Of frames of a target
    (--plan a target's plan) every point is fitted where it is on the sensor; --positions is how many of them.

    Example: `lfcal fit H.h5 -o fit/`; `lfcal fit centre.h5 edge.h5 corner.h5`; `lfcal fit --check old.h5 frame.tif`
    """
    from lfcal.campaign import point_outputs
    from lfcal.cli._console import print_json, run_work
    from lfcal.cli._fit_check import CheckRequest, check_h
    from lfcal.cli._fit_field import Regions, fit_regions, names_of
    from lfcal.cli._fit_object import ObjectPlace, object_dict, object_error, object_words, read_object
    from lfcal.cli._fit_source import (
        SOME,
        PatternReading,
        check_frame_options,
        is_matrix,
        open_upright,
        parse_noise,
        read_patterns,
    )
    from lfcal.cli._fit_target import fit_target
    from lfcal.cli._fit_validate import (
        VALIDATION,
        iter_write_validation,
        show_validation,
        validation_dict,
        withheld_points,
    )
    from lfcal.cli._orientation import check_choice
    from lfcal.cli._runs import may_replace, run_choice, run_kept
    from lfcal.cli._target_frames import refuse_options
    from lfcal.fit import MODEL, fit_dict, iter_fit_camera, iter_write_fit, starting_effects, with_given
    from lfcal.frames import CorrectionRecipe
    from lfcal.simulate.effects import parse_effects
    from lfcal.tasks import check_outputs, load_camera, wanted_target

    check_choice(orientation)
    corrections = {"--dark": dark, "--black-level": black_level is not None, "--white": white}
    # --plan is that of the sources; frames of an object are corrected, but not turned
    check_frame_options({"--plan": plan}, sources)
    check_frame_options({"--orientation": orientation != "check"}, [*sources, validate_on])
    check_frame_options(corrections, [*sources, validate_on, known_object])
    if check is not None:
        given = {
            "--camera": camera,
            "--unknowns": unknowns != "auto",
            "--effect": effects,
            "--validate": validate or validate_on,
            "--object": known_object or scene,
            "--no-h": no_h,
            "--hybrid": hybrid,
            "-o": out != FOLDER,
            "--executor": executor or scheduler or resume,
            "--regions": regions,
        }
        wrong = [name for name, said in given.items() if said]
        if wrong:
            raise InputError.expected("--check", "frames alone: nothing is fitted or written", wrong[0], "leave it out")
        if plan is not None and not any(source.is_dir() for source in sources):
            raise InputError.expected("--plan", "a folder of frames, which it applies to", "files", "leave it out")
        recipe = CorrectionRecipe(dark=dark, black_level=black_level, white=white or "")
        asked = CheckRequest(
            parse_noise(noise),
            (2.0 if limit is None else limit) / 100,
            SOME if positions is None else positions,
            plan,
            recipe,
            orientation,
        )
        if not check_h(check, sources, asked, json=json):
            raise typer.Exit(1)
        return
    if limit is not None:
        raise InputError.expected("--limit", "--check H with it", "none", "leave it out, or name the H to check")
    source = sources[0]
    if hybrid and no_h:
        raise InputError.expected("--hybrid", "an H to write", "--no-h", "leave one of them out")
    if (known_object is None) != (scene is None) or (known_object and no_h):
        got = "without H" if no_h else "one of them"
        raise InputError.expected("--object", "a frame, its --scene, and H", got, "give all of them, or none")
    if (executor or scheduler or resume) and (hybrid or no_h):
        got = "--hybrid" if hybrid else "--no-h"
        raise InputError.expected("--executor", "an H of the model, made plane by plane", got, "leave one of them out")
    by_whom = (executor, scheduler, workers)
    groups = unknowns if unknowns == "auto" else parse_groups(unknowns)
    chosen = parse_effects(effects)
    target = wanted_target(source, plan) if len(sources) == 1 else None
    if target is not None:
        refuse_options(
            {
                "--validate": validate or validate_on,
                "--object": known_object or scene,
                "--hybrid": hybrid,
                "--noise": noise,
                "--orientation": orientation != "check",
                "--executor": executor or scheduler or resume,
            }
        )
        check_outputs(point_outputs(out), source, plan, dark, white, camera, force=force)
        if camera:
            target = replace(target, scan=replace(target.scan, camera=load_camera(camera)))
        fit_target(
            source,
            target,
            CorrectionRecipe(dark=dark, black_level=black_level, white=white or ""),
            groups,
            chosen if effects else None,
            out,
            regions=regions,
            most=positions,
            with_h=not no_h,
            workers=workers,
            json=json,
        )
        return
    if regions:
        remedy = "leave it out: each source is the region that it was recorded in"
        raise InputError.expected("--regions", "frames of a target", "those of a scan", remedy)
    if len(sources) > 1:
        wanted = Regions(hybrid, validate, validate_on, known_object, scene)
        made = wanted.outputs(out, sources)
        read = (camera, plan, dark, white, validate_on, known_object, scene)
        places = [] if hybrid or no_h else [out / name / MODEL for name in names_of(sources)]
        again = force or any(may_replace(place, resume=resume, force=force) for place in places)
        _check_regions(out, sources, *read, more=made, no_h=no_h, force=again)
        recipe = CorrectionRecipe(dark=dark, black_level=black_level, white=white or "")
        start = load_camera(camera) if camera else None
        how = PatternReading(start, positions, parse_noise(noise), plan, recipe, orientation)
        begin = chosen if effects else None
        runs = [run_choice(place, *by_whom, resume=resume, force=force) for place in places]
        run = next((one for one in runs if one is not None), None)
        fit_regions(sources, how, groups, begin, out, wanted, with_h=not no_h, workers=workers, json=json, run=run)
        return
    more = VALIDATION if validate or validate_on else ()
    again = may_replace(out / MODEL, resume=resume, force=force)
    _check_before(
        out, source, camera, plan, dark, white, validate_on, known_object, scene, more=more, no_h=no_h, force=again
    )
    run = None if hybrid or no_h else run_choice(out / MODEL, *by_whom, resume=resume, force=force)
    recipe = CorrectionRecipe(dark=dark, black_level=black_level, white=white or "")
    start = load_camera(camera) if camera else None
    how = PatternReading(start, positions, parse_noise(noise), plan, recipe, orientation)
    measured, known = read_patterns(source, how, quiet=json)
    # what cannot be read ends this before the fit
    aside = withheld_points(source, validate_on, how, measured, quiet=json) if more else None
    shot = read_object(known_object, scene, how, measured) if known_object and scene else None
    begins = with_given(starting_effects(measured.plan), *chosen) if effects else None
    fit = run_work(iter_fit_camera(measured, start, groups, effects=begins, workers=workers), quiet=json)
    with ExitStack() as stack:
        patterns: PSFMatrix | Measured | None = None
        if hybrid:
            # of an H every recorded pattern, not those alone that were fitted
            patterns = stack.enter_context(open_upright(source)) if is_matrix(source) else measured
        work = iter_write_fit(
            fit, measured, out, known, patterns=patterns, noise=how.noise, with_h=not no_h, workers=workers, run=run
        )
        written, summary = run_work(work, quiet=json) if run is None else run_kept(work, out / MODEL, quiet=json)
    known_of = fit_dict(fit) | {"source": source, "files": written}
    if summary is not None:
        known_of["hybrid"] = asdict(summary)
    if not json:
        _show(fit, out, written, summary)
    if aside is not None:
        found = run_work(iter_write_validation(fit, aside, out, source, validate_on), quiet=json)
        known_of["validation"] = validation_dict(found)
        if not json:
            show_validation(found)
    if shot is not None:
        beside = object_error([ObjectPlace.of(out / MODEL, fit)], *shot, how.noise, workers)
        known_of["object"] = object_dict(beside)
        if not json:
            typer.echo(object_words(beside))
    if json:
        print_json(known_of)


def _check_before(out: Path, *inputs: Path | str | None, more: Sequence[str] = (), no_h: bool, force: bool) -> None:
    """Raise where an output cannot be written, is an input, or exists."""
    from lfcal.fit import MODEL, fit_outputs
    from lfcal.tasks import check_outputs

    check_outputs([*fit_outputs(out), *(out / name for name in more)], *inputs, force=force)
    # beside another camera it would be taken for that camera's H
    matrix = out / MODEL
    if no_h and matrix.exists():
        raise InputError.expected(str(matrix), "no H with --no-h", "one of an earlier fit", "choose another folder")


def _check_regions(
    out: Path,
    sources: Sequence[Path],
    *inputs: Path | str | None,
    more: Sequence[Path] = (),
    no_h: bool,
    force: bool,
) -> None:
    """Raise where an output of several regions cannot be written, is an input, exists, or lies beside another fit's."""
    from lfcal.cli._fit_field import names_of
    from lfcal.fit import MODEL, NUMBERS, field_outputs
    from lfcal.tasks import check_outputs

    names = names_of(sources)
    check_outputs([*field_outputs(out, names), *more], *sources, *inputs, force=force)
    others = [out / MODEL, out / NUMBERS, *([out / name / MODEL for name in names] if no_h else [])]
    if there := next((path for path in others if path.exists()), None):
        raise InputError.expected(str(out), "no fit of another camera", str(there), "choose another folder")


def _show(fit: Fit, out: Path, written: list[Path], summary: HybridSummary | None) -> None:
    from lfcal.cli._console import print_table, report

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
    if fit.unseen:
        report(f"note: {fit.unseen_words}")
    for combination in fit.unidentified:
        report(f"note: this scan does not tell apart: {combination}")
    if summary is not None:
        typer.echo(str(summary))
    typer.echo(f"{out}: {', '.join(str(path.relative_to(out)) for path in written)}")
