"""``lfcal inspect``: measure the quality of H: every check with its rating, the apertures, and what to do."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import typer

from lfcal.base import format_seconds, format_share
from lfcal.cli._console import print_table, show_judgement

if TYPE_CHECKING:
    from lfcal.judge import Inspection, RegionLoss
    from lfcal.judge.quality import QualityReport
    from lfcal.psf import PSFMatrix
    from lfcal.tasks import InspectedMatrix


def show(made: tuple[InspectedMatrix, ...]) -> None:
    """Print verdict, checks that are not good, comparisons and path of the report; all checks with ``--all``."""
    for one in made:
        _show(one)
        if one.loss is not None:
            _show_loss(one.loss)
        if one.page is not None:
            typer.echo(f"report: {one.page}")


def _show(one: InspectedMatrix) -> None:
    """Print the verdict, the faults, the checks that are not good, the number of all, and the comparison."""
    from lfcal.judge.quality import counted_words, merit_word
    from lfcal.judge.report import limits
    from lfcal.psf import computed_words

    H, found, comparison, every = one.matrix, one.found, one.comparison, one.task.every
    quality, report = found.quality, one.task.report
    typer.echo(f"H (z, y, x, t, s) = {quality.shape}, inspected in {format_seconds(quality.seconds)}")
    turned = H.provenance.get("orientation", {}).get("applied", "as is")
    if turned != "as is":
        typer.echo(f"made from frames that were turned upright: {turned}")
    for words in computed_words(one.simulated):
        typer.echo(f"simulated: {words}")
    show_judgement(found.judgement)
    _show_faults(found)
    listed_metrics = [m for m in quality.metrics if every or (m.applies and m.merit != "good")]
    if listed_metrics:
        print_table(
            ["merit", "check", "value", "good", "bad", "cost (NRMSE)"],
            [[merit_word(m), m.spec.title, m.text, *limits(m), m.cost_text] for m in listed_metrics],
        )
    more = "" if every else "; --all lists them, and the aperture of each plane"
    typer.echo(f"checks: {counted_words(quality.metrics)}{more}")
    if every:
        _show_apertures(H, quality)
    for metric in quality.metrics:
        if metric.merit in ("bad", "fair") and not found.withdrawn(metric):
            cause = found.settled(metric)
            if cause is not None:
                typer.echo(f"{metric.spec.title.lower()}: see {cause.title}, its cause")
    redo = found.redo()
    if redo:
        places = "1 position" if len(redo) == 1 else f"{len(redo)} positions"
        listed = "--report writes the list to redo.json" if report is None else f"listed in {report / 'redo.json'}"
        typer.echo(f"{places} to record again; {listed}")
    if comparison is not None:
        words = f"correlation {comparison.correlation:.5f}, error {100 * comparison.rms_error:.2f} %, centroid shift "
        words += f"{comparison.rms_shift_px:.3f} px rms, {comparison.max_shift_px:.3f} px at most"
        typer.echo(f"compared with the reference: {words}")


def _show_faults(found: Inspection) -> None:
    """Print the result of the comparison with the camera."""
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


def _show_apertures(H: PSFMatrix, quality: QualityReport) -> None:
    """Print the aperture of each plane, the iris, and the working f-number."""
    print_table(
        ["depth z", "aperture"],
        [[quality.plane_words(z), a.describe()] for z, a in enumerate(quality.apertures)],
    )
    if quality.iris is not None:
        typer.echo(f"iris from all planes: {quality.iris.describe()}")
    _show_f_number(H, quality)


def _show_f_number(H: PSFMatrix, quality: QualityReport) -> None:
    f = quality.f_number
    if f is None:
        if H.camera is not None:
            typer.echo("working f-number: cannot be determined from the shadows over depth")
        return
    error = f" ± {f.standard_error:.2f}" if math.isfinite(f.standard_error) else ""
    stated = f"; the camera states {H.camera.optics.working_f_number:.2f}" if H.camera is not None else ""
    typer.echo(f"working f-number from the shadow over depth: {f.value:.2f}{error}{stated}")


def _show_loss(loss: RegionLoss) -> None:
    """Print the periodicity loss of each region, and the worst."""
    rows = [
        [name, f"{row:g}, {column:g}", format_share(error), f"{shift:.2f}"]
        for name, (row, column), error, shift in zip(
            loss.names, loss.anchors.tolist(), loss.losses.tolist(), loss.shift_px.tolist(), strict=True
        )
    ]
    title = f"regions: patterns compared with those of {loss.names[0]}"
    print_table(["region", "anchor (row, column)", "periodicity loss", "centroid shift (px rms)"], rows, title=title)
    typer.echo(
        f"if {loss.names[0]} represents the whole field, the largest error of a pattern is {format_share(loss.worst)}"
    )
