"""HTML report of a fit: verdict, parameters, residuals, and degeneracies."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from lfcal.base import (
    Clock,
    Work,
    add_html_section,
    format_share,
    html_figure,
    html_page,
    html_paragraphs,
    html_section,
    html_table,
    html_text,
    replace_whole,
)
from lfcal.fit.drawing import FitResiduals, draw_leftover, draw_parameters, draw_patterns, leftover_of
from lfcal.fit.measured import Measured
from lfcal.fit.result import Fit

__all__ = ["PAGE", "add_picture", "iter_fit_report", "limits", "parameters", "report_files"]

PAGE = "index.html"
"""Name of the page of the report in the folder of a fit."""

PICTURES = ("patterns.png", "leftover.png", "parameters.png")
CAPTIONS = (
    "Measured pattern, model, and residual in standard deviations of the noise, from the best explained "
    "pattern to the worst.",
    "Mean square of the residuals over the cutout; χ² of each position, of each plane, and of the pixels "
    "behind each lens type.",
    "Deviation of each parameter from the description, in standard deviations of the parameter.",
)


def report_files(folder: Path) -> list[Path]:
    """Return the paths of the files of a report in ``folder``, with the page last."""
    return [folder / name for name in (*PICTURES, PAGE)]


def iter_fit_report(
    fit: Fit, measured: Measured, folder: Path, source: str = "", notes: Sequence[str] = ()
) -> Work[Path]:
    """Write the plots and the page of a fit of ``measured`` into ``folder``; return the path of the page.

    ``source`` is the name of the source of the patterns. ``notes`` are lines below the verdict.

    Everything is drawn before the first file is written. Each file is written atomically, the page last.
    """
    clock = Clock("drawing the report", 1 + len(PICTURES))
    yield clock.at(0)
    left = leftover_of(fit, measured)
    draws: tuple[Callable[[Path], None], ...] = (
        lambda path: draw_patterns(left, path),
        lambda path: draw_leftover(left, path),
        lambda path: draw_parameters(fit, path),
    )
    drawn: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for k, (name, draw) in enumerate(zip(PICTURES, draws, strict=True)):
            yield clock.at(1 + k)
            draw(Path(scratch) / name)
            drawn[name] = (Path(scratch) / name).read_bytes()
    text = _page(fit, left, drawn, source, notes)
    for path, content in zip(report_files(folder), (*drawn.values(), text.encode()), strict=True):
        with replace_whole(path) as part:
            part.write_bytes(content)
    yield clock.at(1 + len(PICTURES))
    return folder / PAGE


def add_picture(folder: Path, title: str, words: str, picture: Path, caption: str) -> None:
    """Append a section with an image, and the text ``words`` above it, to the report in ``folder``."""
    add_html_section(
        folder / PAGE, html_section(title, html_paragraphs([words]) + html_figure(picture.read_bytes(), caption))
    )


def _page(fit: Fit, left: FitResiduals, drawn: dict[str, bytes], source: str, notes: Sequence[str]) -> str:
    title = f"{source or fit.camera.name}: optics fitted from {len(left.index)} patterns"
    patterns, leftover, drawing = (
        html_figure(content, caption) for content, caption in zip(drawn.values(), CAPTIONS, strict=True)
    )
    more = html_paragraphs(notes)
    merit = "good" if fit.complete else "bad"
    body = [
        f'<section class="verdict {merit}">{html_text(_sentence(fit))}<p>{html_text(_rest(fit))}</p>{more}</section>',
        html_section("Parameters", parameters(fit) + drawing),
        html_section("Patterns", patterns),
        html_section("Residuals", _chi2(left) + leftover),
        html_section("Fixed parameters and degeneracies of this scan", limits(fit)),
    ]
    return html_page(title, title, fit.camera.name, body, "fit of the optics")


def _sentence(fit: Fit) -> str:
    return fit.verdict[0].upper() + fit.verdict[1:]


def _rest(fit: Fit) -> str:
    chi2 = fit.chi_square
    said = (
        f"χ² exceeds 1 by {chi2.excess:.1f} of its standard deviations ({chi2.sigma:.2g}). Over all pixels, "
        f"most of which are dark, it is {chi2.all_pixels:.3f}. {fit.held_out_error.patterns} patterns were "
        "held out of the fit."
    )
    if fit.spread.response > 0:
        uneven = format_share(fit.spread.response)
        said += f" Pixels respond unevenly by {uneven} (rms): this counts as noise, not as an error of the model."
    return said


def parameters(fit: Fit) -> str:
    """Return an HTML table of the fitted parameters."""
    rows = [
        (one.name, f"{one.value:.6g} ± {one.sigma:.2g}", f"{one.start:.6g}", one.unit, one.group)
        for one in fit.parameters.values()
    ]
    return html_table(("parameter", "found", "described", "unit", "group"), rows, escape=True)


def _chi2(left: FitResiduals) -> str:
    rows = [(f"plane {z}", f"{value:.3f}") for z, value in enumerate(left.by_plane) if value == value]
    rows += [(f"{left.type_name} {k}", f"{value:.3f}") for k, value in enumerate(left.by_type) if value == value]
    return html_table(("", "χ²"), rows, escape=True)


def limits(fit: Fit) -> str:
    """Return an HTML table of what limits a fit.

    Its rows are the fixed and degenerate parameters, groups that were tried without improvement, answers that differ
    from the description, planes without patterns, and outliers.
    """
    rows = [("held", one) for one in fit.held]
    rows += [("not separated", one) for one in fit.unidentified]
    rows += [("tried without improvement", one) for one in fit.unhelpful]
    rows += [(name, answer) for name, answer in fit.answers.items()]
    rows += [("not measured", fit.unseen_words)] if fit.unseen else []
    rows += [(f"outlier: ({one.z}, {one.y}, {one.x})", one.reason) for one in fit.outliers]
    return html_table(("", ""), rows, escape=True) if rows else "<p>Nothing.</p>"
