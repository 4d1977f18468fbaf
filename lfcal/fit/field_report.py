"""Report on a fit of several regions of the field: its quality in each, and the wavefront over the field."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    COLOURS,
    DIFFERENCE_MAP,
    IMAGE_MAP,
    Clock,
    Work,
    figure,
    html_figure,
    html_page,
    html_paragraphs,
    html_section,
    html_table,
    html_text,
    replace_whole,
    save_figure,
)
from lfcal.fit.field import FieldFit
from lfcal.fit.hybrid import HybridSummary
from lfcal.fit.parameters import field_of
from lfcal.fit.report import PAGE, limits, parameters
from lfcal.simulate.engines import zernike_wavefront

__all__ = ["draw_field", "field_report_files", "iter_field_report", "wavefront_table"]

PICTURE = "wavefront.png"

CAPTION = (
    "The wavefront over the pupil for points across the sensor (left), and its rms (right). Circles "
    "mark the fitted regions; elsewhere the fitted laws are extrapolated."
)

ACROSS = 5
"""Number of positions along the longer side at which the wavefront is drawn."""

FINE = 15
"""Number of positions along each side at which the rms is computed."""

F8 = NDArray[np.float64]


def field_report_files(folder: Path) -> list[Path]:
    """Return the paths of the report of a fit of several regions in ``folder``, with the page last."""
    return [folder / PICTURE, folder / PAGE]


def iter_field_report(fit: FieldFit, folder: Path, hybrids: Mapping[str, HybridSummary]) -> Work[Path]:
    """Write the plot and the page of a fit of several regions into ``folder``; return the path of the page.

    ``hybrids`` contains the summary of the hybrid H of each region that has one, by name of the region. Each file is
    written atomically.
    """
    clock = Clock("drawing the field", 1)
    yield clock.at(0)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / PICTURE
        draw_field(fit, path)
        picture = path.read_bytes()
    page = _page(fit, picture, hybrids)
    folder.mkdir(parents=True, exist_ok=True)
    for path, content in zip(field_report_files(folder), (picture, page.encode()), strict=True):
        with replace_whole(path) as part:
            part.write_bytes(content)
    yield clock.at(1)
    return folder / PAGE


def wavefront_table(fit: FieldFit) -> tuple[list[str], list[list[str]]]:
    """Return the headers and rows of a table of the wavefront in each region; without Zernike terms, it has no rows."""
    places = {name: field_of(own.planned) for name, own in fit.fits.items()}
    fronts = {name: {(t.n, t.m): t for t in fit.wavefront_at(at)} for name, at in places.items()}
    terms = sorted({term for front in fronts.values() for term in front})
    rows = []
    for name, (x, y) in places.items() if terms else ():
        values = [fronts[name].get(term) for term in terms]
        cells = ["" if one is None else f"{one.waves:.3f} ± {one.sigma:.2g}" for one in values]
        rows.append([name, f"{x / 1e3:.2f}, {y / 1e3:.2f}", *cells])
    return ["region", "x, y (mm)", *(f"Z({n}, {m})" for n, m in terms)], rows


def _page(fit: FieldFit, picture: bytes, hybrids: Mapping[str, HybridSummary]) -> str:
    first = fit.first
    title = f"{first.camera.name}: optics fitted from {len(fit.fits)} regions of the field"
    merit = "good" if first.complete else "bad"
    verdict = first.verdict[0].upper() + first.verdict[1:]
    many = sum(len(own.residuals) for own in fit.fits.values())
    rest = f"{many} patterns of {len(fit.fits)} regions; the folder of each region contains its own report"
    headers, rows = wavefront_table(fit)
    terms = html_table(headers, rows, escape=True) if rows else "<p>No term was needed.</p>"
    said = [f"{name}: {summary}" for name, summary in hybrids.items()]
    body = [
        f'<section class="verdict {merit}">{html_text(verdict)}{html_paragraphs([rest, *said])}</section>',
        html_section("Regions", _regions(fit)),
        html_section("Wavefront over the field (waves at the pupil's rim)", terms + html_figure(picture, CAPTION)),
        html_section("Parameters of all regions", parameters(first)),
        html_section(
            "Fixed parameters, and parameters that these scans do not determine", limits(first) + _outliers(fit)
        ),
    ]
    return html_page(title, title, first.camera.name, body, "fit of the optics")


def _regions(fit: FieldFit) -> str:
    rows = []
    for name, own in fit.fits.items():
        x, y = field_of(own.planned)
        down, right = own.setup.aside_px
        farther = ", ".join(f"{error:+.3g}" for error in own.setup.depth_errors_um)
        here = own.here
        chi2 = "" if here is None else f"{here.chi_square.lit:.3f}"
        off = "" if here is None else str(here.error)
        aside = f"{down:+.3f}, {right:+.3f}"
        rows.append((name, f"{x / 1e3:.2f}, {y / 1e3:.2f}", str(len(own.residuals)), off, chi2, aside, farther))
    headers = ("region", "x, y (mm)", "patterns", "error of the model", "χ²")
    return html_table(
        (*headers, "displacement of sources (px)", "displacement of planes in depth (µm)"), rows, escape=True
    )


def _outliers(fit: FieldFit) -> str:
    rows = [
        (f"outlier: {name}, ({one.z}, {one.y}, {one.x})", one.reason)
        for name, own in list(fit.fits.items())[1:]
        for one in own.outliers
    ]
    return html_table(("", ""), rows, escape=True) if rows else ""


def draw_field(fit: FieldFit, path: str | os.PathLike[str]) -> None:
    """Draw the wavefront over the pupil at several positions on the sensor, and its rms over the sensor, to a file."""
    camera = fit.camera
    rows, columns = (n * camera.sensor.pixel_um / 1e3 for n in camera.sensor.shape)
    step = max(rows, columns) / ACROSS
    ys, xs = (_middles(side, max(1, round(side / step))) for side in (rows, columns))
    u = np.linspace(-1, 1, 61)
    ux, uy = np.meshgrid(u, u)
    inside = ux**2 + uy**2 <= 1
    pupils = {(x, y): np.where(inside, _front(fit, x, y, ux, uy, inside), np.nan) for y in ys for x in xs}
    most = max(1e-6, max(float(np.nanmax(np.abs(one))) for one in pupils.values()))
    fine_y, fine_x = (np.linspace(-side / 2, side / 2, FINE) for side in (rows, columns))
    fine = [[_front(fit, x, y, ux, uy, inside)[inside] for x in fine_x] for y in fine_y]
    rms = np.sqrt(np.square(np.array(fine)).mean(2))
    with figure(9.6, 4.2) as fig:
        fronts, map_of = fig.subplots(1, 2)
        half = 0.45 * step
        for (x, y), values in pupils.items():
            extent = (x - half, x + half, y + half, y - half)
            image = fronts.imshow(values, extent=extent, cmap=DIFFERENCE_MAP, vmin=-most, vmax=most)
        fig.colorbar(image, ax=fronts, shrink=0.8).set_label("waves")
        fronts.set_title("wavefront over the pupil")
        shown = map_of.pcolormesh(fine_x, fine_y, rms, cmap=IMAGE_MAP, shading="gouraud")
        fig.colorbar(shown, ax=map_of, shrink=0.8).set_label("waves rms")
        map_of.set_title("rms over the field")
        for panel in (fronts, map_of):
            for name, own in fit.fits.items():
                x, y = (value / 1e3 for value in field_of(own.planned))
                panel.plot(x, y, "o", color=COLOURS["accent"], markerfacecolor="white", markersize=6)
                label = panel.annotate(name, (x, y), xytext=(5, 5), textcoords="offset points", fontsize=8)
                label.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1})
            panel.set(xlim=(-columns / 2, columns / 2), ylim=(rows / 2, -rows / 2), aspect="equal")
            panel.set(xlabel="x on the sensor (mm)", ylabel="y on the sensor (mm)")
            panel.grid(visible=False)
        save_figure(fig, path)


def _middles(side: float, count: int) -> F8:
    """Return the middles of ``count`` equal parts of a side about 0."""
    return (np.arange(count) - (count - 1) / 2) * side / count


def _front(fit: FieldFit, x_mm: float, y_mm: float, ux: F8, uy: F8, inside: NDArray[np.bool_]) -> F8:
    """Return the wavefront over the pupil at a position in the field, minus its mean (waves)."""
    terms = [(one.n, one.m, one.waves) for one in fit.wavefront_at((1e3 * x_mm, 1e3 * y_mm))]
    values = zernike_wavefront(terms, ux, uy)
    found: F8 = values - values[inside].mean()
    return found
