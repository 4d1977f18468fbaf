"""``lfcal inspect``: how good an H is."""

from __future__ import annotations

import math
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli._options import (
    ExecutorOption,
    ForceOption,
    JsonOption,
    MatOrderOption,
    MatrixArgument,
    ResumeOption,
    SchedulerOption,
    WorkersOption,
)

if TYPE_CHECKING:
    from lfcal.fit import Setup
    from lfcal.judge import Comparison, Inspection
    from lfcal.judge.quality import QualityReport
    from lfcal.psf import PSFMatrix

REGIONS_PICTURE = "regions.png"
"""The map of several regions of the field, in the report's folder."""

RATE = 200e6
"""Bytes of H that are read and measured in a second of processor time, about."""


def register(app: typer.Typer) -> None:
    """Add ``inspect`` to the app."""
    app.command("inspect")(command)


def command(
    context: typer.Context,
    source: MatrixArgument,
    *,
    report: Path | None = typer.Option(None, "--report", help="Folder for an HTML report with redo.json."),
    reference: Path | None = typer.Option(None, "--reference", help="H of the same shape to compare with."),
    session: Path | None = typer.Option(
        None,
        "--session",
        help="Session folder with control frames: how well one period of H stands for the whole field.",
    ),
    patterns: int = typer.Option(
        60, "--patterns", min=1, help="Patterns compared with the camera; more show smaller faults and take longer."
    ),
    seconds: float = typer.Option(
        1800.0,
        "--seconds",
        min=0,
        help="Longest time of the comparison with the camera. If it is reached, the verdict is 'not fully judged'; "
        "0 leaves the comparison out.",
    ),
    fit: Path | None = typer.Option(
        None, "--fit", help="Folder of lfcal fit of this scan: patterns are compared with the camera as found."
    ),
    mat_order: MatOrderOption = "",
    every: bool = typer.Option(False, "--all", help="List all metrics, also those that are good or do not apply."),
    strict: bool = typer.Option(
        False, "--strict", help="End with exit code 1 unless H is shown to be good, or usable with a look at it."
    ),
    workers: WorkersOption = None,
    executor: ExecutorOption = "",
    scheduler: SchedulerOption = "",
    resume: ResumeOption = False,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Measure the quality of H: every metric with its merit, the aperture of each plane, what to do.

    Where its camera is known, patterns are compared with what it should give, and faults are named by what differs.

    Example: `lfcal inspect H.h5 --report report/`
    """
    from lfcal.base import InputError
    from lfcal.cli._console import print_json, run_work
    from lfcal.cli._inspect_controls import control_frames
    from lfcal.cli._inspect_units import iter_inspect_units
    from lfcal.cli._regions import show_loss, told_loss
    from lfcal.cli._runs import may_replace, run_choice, run_kept
    from lfcal.cli._usage import refuse
    from lfcal.judge import draw_region_loss, iter_compare, iter_inspection
    from lfcal.judge.quality import iter_inspect
    from lfcal.tasks import check_mat_files, open_matrix, tell_assumed
    from lfcal.work import discard, note_joining, parts_folder

    if report is None and (executor or scheduler or resume):
        raise InputError("--executor: expected --report beside it, got none; name the folder that is worked on")
    if not seconds:
        refuse(context, "a comparison with the camera", "--seconds 0", "patterns")
    check_mat_files(mat_order, source, reference)
    again = report is not None and may_replace(report, resume=resume, force=force)
    _check_before(report, source, reference, force=again)
    with ExitStack() as files:
        H = files.enter_context(open_matrix(source, mat_order=mat_order))
        # the metrics are about the images of points: an HT file is inspected as the H it came from.
        H = H.T if H.is_transposed else H
        tell_assumed(H.camera, source.name, quiet=json)
        other = None if reference is None else files.enter_context(open_matrix(reference, mat_order=mat_order))
        comparison = None
        if other is not None:
            comparison = run_work(iter_compare(H, other, by_index=True, workers=workers), quiet=json)
        setup = None if fit is None else _setup_of(fit, H, seconds)
        controls = None if session is None else control_frames(session, H)
        run = None
        if report is not None:
            ahead = H.nbytes / RATE
            run = run_choice(report, executor, scheduler, workers, resume=resume, force=force, seconds=ahead)
        if run is not None and report is not None:
            quality = run_kept(iter_inspect_units(H, report, session, run=run), report, quiet=json)
        else:
            quality = run_work(iter_inspect(H, controls=controls, workers=workers), quiet=json)
        work = iter_inspection(H, quality, setup=setup, seconds=seconds, patterns=patterns)
        found = run_work(work, quiet=json)
        quality = found.quality  # with the costs that were measured
        if not json:
            _show(H, comparison, found, report, every=every)
        if run is not None and report is not None:
            note_joining(parts_folder(report))
        page = None if report is None else _write(H, other, report, workers, found, every=every, quiet=json)
        loss = told_loss(source, workers=workers, quiet=json)
        if loss is not None and report is not None:
            draw_region_loss(loss, report / REGIONS_PICTURE)
        if loss is not None and not json:
            show_loss(loss)
        if run is not None and report is not None:
            discard(parts_folder(report))
    if json:
        extra: dict[str, Any] = {} if comparison is None else {"comparison": comparison.to_dict()}
        if loss is not None:
            extra["regions"] = loss.to_dict()
        extra["assumed"] = [] if H.camera is None else H.camera.marks.paths("assumed")
        print_json(found.to_dict(every=every) | extra | ({} if page is None else {"report": page}))
    elif page is not None:
        typer.echo(f"report: {page}")
    if strict and found.merit not in ("good", "fair"):
        raise typer.Exit(1)


def _setup_of(folder: Path, H: PSFMatrix, seconds: float) -> Setup:
    """Return what a fit found of the camera; raises where it is of another scan, or would not be used."""
    from lfcal.base import InputError
    from lfcal.fit import read_fit
    from lfcal.judge import plan_of

    if not seconds:
        raise InputError.expected("--fit", "time to compare with it", "--seconds 0", "leave one of them out")
    stored, plan = read_fit(folder), plan_of(H)
    if plan is None:
        raise InputError.expected("H", "a camera's matrix", "one without a camera", "assemble H with --camera")
    stored.check(plan)
    return stored.setup


def _check_before(report: Path | None, *inputs: Path | None, force: bool) -> None:
    """Say which metrics of others are left out; raise where no report can be written, or one is there already."""
    from lfcal.judge.quality import METRICS
    from lfcal.judge.report import report_files
    from lfcal.tasks import check_outputs

    for why in METRICS.failures().values():
        typer.echo(f"left out: {why}", err=True)
    if report is not None:
        check_outputs([*report_files(report), report / REGIONS_PICTURE], *inputs, force=force)


def _write(
    H: PSFMatrix,
    reference: PSFMatrix | None,
    folder: Path,
    workers: int | None,
    found: Inspection,
    *,
    every: bool,
    quiet: bool,
) -> Path:
    from lfcal.cli._console import run_work
    from lfcal.judge.report import iter_report

    work = iter_report(H, folder, reference=reference, workers=workers, inspection=found, every=every)
    return run_work(work, quiet=quiet)


def _show(
    H: PSFMatrix,
    comparison: Comparison | None,
    found: Inspection,
    report: Path | None,
    *,
    every: bool,
) -> None:
    """Print verdict, metrics, apertures and the comparison."""
    from lfcal.base import format_seconds
    from lfcal.cli._console import print_table
    from lfcal.cli._findings import show_judgement
    from lfcal.judge.quality import counted_words, merit_word
    from lfcal.judge.report import limits, value_text

    quality = found.quality
    typer.echo(f"H (z, y, x, t, s) = {quality.shape}, inspected in {format_seconds(quality.seconds)}")
    turned = H.provenance.get("orientation", {}).get("applied", "as is")
    if turned != "as is":
        typer.echo(f"made from frames that were turned upright: {turned}")
    show_judgement(found.judgement)
    _show_faults(found)
    listed_metrics = [m for m in quality.metrics if every or (m.applies and m.merit != "good")]
    if listed_metrics:
        print_table(
            ["merit", "metric", "value", "good", "bad", "cost (NRMSE)"],
            [[merit_word(m), m.spec.title, value_text(m), *limits(m), m.cost_text] for m in listed_metrics],
        )
    more = "" if every else "; --all lists them"
    typer.echo(f"metrics: {counted_words(quality.metrics)}{more}")
    print_table(
        ["depth z", "aperture"],
        [[quality.plane_words(z), a.describe()] for z, a in enumerate(quality.apertures)],
    )
    if quality.iris is not None:
        typer.echo(f"iris from all planes: {quality.iris.describe()}")
    _show_f_number(H, quality)
    for metric in quality.metrics:
        if metric.merit in ("bad", "fair") and not found.withdrawn(metric):
            cause = found.settled(metric)
            if cause is not None:
                typer.echo(f"{metric.spec.title.lower()}: see {cause.title}, which makes it")
    redo = found.redo()
    if redo:
        places = "1 position" if len(redo) == 1 else f"{len(redo)} positions"
        listed = "--report writes the list to redo.json" if report is None else f"listed in {report / 'redo.json'}"
        typer.echo(f"{places} to record again; {listed}")
    if comparison is not None:
        words = f"correlation {comparison.correlation:.5f}, error {100 * comparison.rms_error:.2f} %, centroid shift "
        words += f"{comparison.rms_shift_px:.3f} px rms, {comparison.max_shift_px:.3f} px at most"
        typer.echo(f"against the reference: {words}")


def _show_faults(found: Inspection) -> None:
    """Print what the comparison with the camera found."""
    from lfcal.base import format_share
    from lfcal.cli._console import print_table
    from lfcal.judge import compared_words, cost_words

    typer.echo(compared_words(found))
    if found.faults:
        print_table(
            ["fault", "what", "of the light", "reconstruction error, noise → with it"],
            [[f.title, f.detail, format_share(min(f.share, 1.0)), cost_words(found, f)] for f in found.faults],
        )
    gone = [m.spec.title.lower() for m in found.quality.metrics if m.merit in ("bad", "fair") and found.withdrawn(m)]
    if gone:
        typer.echo(f"not confirmed by the camera: {', '.join(gone)}")


def _show_f_number(H: PSFMatrix, quality: QualityReport) -> None:
    f = quality.f_number
    if f is None:
        if H.camera is not None:
            typer.echo("working f-number: the shadows over depth cannot tell it")
        return
    error = f" ± {f.standard_error:.2f}" if math.isfinite(f.standard_error) else ""
    stated = f"; the camera states {H.camera.optics.working_f_number:.2f}" if H.camera is not None else ""
    typer.echo(f"working f-number from the shadow over depth: {f.value:.2f}{error}{stated}")
