"""The report of a comparison of two H: one page with its images, and the numbers for programs."""

from __future__ import annotations

import io
import json
import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    Clock,
    StorageError,
    Work,
    draw_image,
    figure,
    format_length,
    format_number,
    format_plane,
    format_seconds,
    html_page,
    html_section,
    html_table,
    html_text,
    one_line,
    plain,
    replace_whole,
)
from lfcal.judge.comparison import Comparison, Figures
from lfcal.judge.report._pictures import ReportPicture, figures

__all__ = [
    "COLUMNS",
    "compared_report_files",
    "compared_words",
    "figure_rows",
    "iter_compared_report",
    "map_levels",
    "verdict",
]

PAGE, NUMBERS = "index.html", "compare.json"
PATTERNS, MAPS = "patterns.png", "positions.png"

COLUMNS = (
    "plane",
    "lenslets",
    "NRMSE (%)",
    "scale",
    "difference at this scale (%)",
    "shift rows, columns (px)",
    "residual (%)",
    "correlation",
)
"""Headings of `figure_rows`."""

SAME = 0.01
"""Difference (NRMSE) below which two H agree."""

OTHER_UNITS = 10.0
"""Scale between two H, or its inverse, from which their values have different units, such as counts and fractions."""

MOST_PERCENT = 1000.0
"""Difference (%) above which no number is stated, because it shows only that the scales differ."""

EVEN = 0.01
"""Fraction of the largest difference up to which all positions count as equally different."""

SHOWN, PLANES = 4, 4
"""Number of positions, and of planes, that are drawn."""


def verdict(found: Comparison) -> str:
    """Return a summary of the difference between two H, as text."""
    one = found.all
    if not math.isfinite(one.nrmse):
        return "Nothing could be compared: no position has light in both."
    row, column = one.shift_px
    shifted = f"{_percent(one.left)} % at this scale and a shift of ({row:+z.3f}, {column:+z.3f}) px."
    if one.scale and not 1 / OTHER_UNITS < abs(one.scale) < OTHER_UNITS:
        how = f"in different units: those of the first H are {format_number(one.scale, 4)} times those of the second"
        return f"Their values are {how}. At that scale they differ by {_percent(one.scaled)} % (NRMSE), {shifted}"
    words = f"They differ by {_percent(one.nrmse)} % (NRMSE) as they are, {_percent(one.scaled)} % at the best scale "
    return ("They agree to within 1 %.  " if one.nrmse < SAME else "") + words + f"{one.scale:.4g}, {shifted}"


def compared_words(found: Comparison) -> str:
    """Return the number of compared positions, planes and pixels, as text."""
    n, ny, nx, nt, ns = found.pair.shape
    many, whole = sum(one.positions for one in found.planes), n * ny * nx
    share = f"{many:,}" if many == whole else f"{many:,} of {whole:,}"
    return f"{share} positions of {n} plane{'s' * (n > 1)} compared, {nt} × {ns} pixels each"


def figure_rows(found: Comparison) -> list[tuple[str, ...]]:
    """Return table rows with `COLUMNS`: the differences over all planes, then the differences of each plane.

    Each of these rows is followed by one row for the lenslets of each type.
    """
    rows = _rows("all", found.all, found.types)
    for one in found.planes:
        # if the numbers of planes differ, state both
        number = f"{one.planes[0]}" if one.planes[0] == one.planes[1] else f"{one.planes[0]}, {one.planes[1]}"
        if math.isfinite(one.depths_um[0]):
            number += f": {format_length(one.depths_um[0])}"
        rows += _rows(number, one.all, one.types)
    return rows


def _rows(name: str, whole: Figures, types: tuple[Figures, ...]) -> list[tuple[str, ...]]:
    return [
        (
            name,
            kind,
            _percent(one.nrmse),
            _reported(one.scale, ".5g"),
            _percent(one.scaled),
            _shift(one.shift_px),
            _percent(one.left),
            _reported(one.correlation, ".5f"),
        )
        for kind, one in [("all", whole), *((f"type {t}", one) for t, one in enumerate(types))]
    ]


def _reported(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "–"


def _shift(px: tuple[float, float]) -> str:
    return ", ".join(f"{one:+z.3f}" for one in px) if all(map(math.isfinite, px)) else "–"


def _percent(share: float) -> str:
    if not math.isfinite(share):
        return "–"
    if 100 * share > MOST_PERCENT:
        return f"> {MOST_PERCENT:.0f}"
    return f"{100 * share:.3g}" if 100 * share >= 0.005 or share == 0 else "< 0.005"


def map_levels(error: NDArray[np.floating]) -> tuple[float, float]:
    """Return the limits (low, high) of the colour scale for a map of differences; NaN values are ignored.

    If all values are nearly equal, the scale starts at 0.
    """
    known = error[np.isfinite(error)]
    low, top = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    return (0.0, top or 1.0) if top - low <= EVEN * top else (low, top)


def compared_report_files(folder: Path) -> list[Path]:
    """Return the paths of the files of a comparison report in ``folder``."""
    return [folder / name for name in (PAGE, NUMBERS, PATTERNS, MAPS)]


def iter_compared_report(found: Comparison, folder: str | os.PathLike[str], seconds: float = 0.0) -> Work[Path]:
    """Write ``index.html``, its images and ``compare.json`` into ``folder``, and return the path of the page.

    The page states ``seconds``, the duration of the comparison (s); 0: unknown. Each file is written atomically, the
    page last.

    Raises
    ------
    StorageError
        If the folder cannot be written to.
    """
    target = Path(folder)
    if target.exists() and not target.is_dir():
        raise StorageError.expected(str(target), "a folder for the report", "a file", "choose another name")
    draws: list[Callable[[], ReportPicture]] = [lambda: _patterns(found), lambda: _maps(found)]
    clock = Clock("drawing the report", len(draws) + 1)
    drawn = []
    for k, draw in enumerate(draws):
        yield clock.at(k)
        drawn.append(draw())
    files = {one.name: one.png for one in drawn}
    files[NUMBERS] = json.dumps(plain(found.to_dict()), indent=1, ensure_ascii=False).encode()
    files[PAGE] = _page(found, drawn, seconds).encode()
    for name, content in files.items():
        with replace_whole(target / name) as part:
            part.write_bytes(content)
    yield clock.at(len(draws) + 1)
    return target / PAGE


def names(found: Comparison) -> tuple[str, str]:
    """Return the names of both H: the file name, or "first H" or "second H" for an H without a file.

    If both names are equal, each is preceded by the name of its folder.
    """
    paths = [Path(m.path) for m in (found.pair.a, found.pair.b)]
    reported = [one_line(path.name) or which for path, which in zip(paths, ("first H", "second H"), strict=True)]
    if reported[0] == reported[1]:
        reported = [one_line(f"{path.parent.name}/{path.name}") for path in paths]
    return reported[0], reported[1]


def _page(found: Comparison, drawn: list[ReportPicture], seconds: float) -> str:
    first, second = names(found)
    notes = "".join(f"<li>{html_text(note)}</li>" for note in found.notes)
    rows = [[html_text(cell) for cell in row] for row in figure_rows(found)]
    reported = (
        '<p class="note">NRMSE: |A − B| / |B|. Scale: the number g that minimises |A − g B|, with |A − g B| / |A| at '
        "this scale. Residual: the difference if B is also shifted. Lenslets: pixels behind lenslets of one type.</p>"
    )
    return html_page(
        f"{first} and {second}",
        f"{first} and {second} compared",
        "Comparison of two PSF matrices",
        [
            f'<section class="verdict">{html_text(verdict(found))}<p>{html_text(compared_words(found))}.</p></section>',
            html_section("What was left out", f"<ul>{notes}</ul>" if notes else ""),
            html_section("Numbers", html_table(COLUMNS, rows, range(2, len(COLUMNS))) + reported),
            html_section("Largest differences", figures(drawn, "patterns")),
            html_section("Over source positions", figures(drawn, "maps")),
        ],
        f"compared in {format_seconds(seconds)}" if seconds else "comparison",
    )


def _patterns(found: Comparison) -> ReportPicture:
    """Draw the positions that differ most: the patterns of A and of B at equal light, and their difference."""
    places = found.worst(SHOWN)
    first, second = names(found)
    with figure(9.3, 0.4 + 2.7 * max(1, len(places))) as fig:
        for row, (k, y, x) in enumerate(places):
            a, b = found.pair.patterns(k, y, x)
            b = b * (float(a.sum()) / float(b.sum()))
            top = float(max(np.nanmax(a), np.nanmax(b)))
            where = f"({found.pair.planes[k][0]}, {y}, {x})"
            panels = (
                (a, f"{first} at {where}", "value", False),
                (b, f"{second}, at that light", "value", False),
                (a - b, f"difference, {100 * found.error[k, y, x]:.3g} %", "value", True),
            )
            for column, (image, title, unit, signed) in enumerate(panels):
                axes = fig.add_subplot(len(places), 3, 3 * row + column + 1)
                draw_image(axes, image, title=title, unit=unit, signed=signed)
                if not signed:
                    axes.images[0].set_clim(min(0.0, float(np.nanmin(a))), top)
        if not places:
            fig.text(0.5, 0.5, "no position could be compared", ha="center")
        return ReportPicture(
            "patterns", PATTERNS, "Positions (z, y, x) with the largest differences, at equal light.", _png(fig)
        )


def _maps(found: Comparison) -> ReportPicture:
    """Draw error and shift over the positions of the planes that differ most, in the order of their indices."""
    rank = np.nan_to_num([one.all.scaled for one in found.planes], nan=-1.0)
    order = np.argsort(-rank, kind="stable").tolist()
    planes = sorted([k for k in order if found.planes[k].positions][:PLANES])
    with figure(9.6, 0.3 + 2.4 * max(1, len(planes))) as fig:
        if not planes:
            fig.text(0.5, 0.5, "no position could be compared", ha="center")
        for row, k in enumerate(planes):
            depth = format_plane(found.planes[k].depths_um[0], found.planes[k].planes[0], "z")
            panels = (
                (100 * found.error[k], f"difference, {depth}", "% at equal light", False),
                (found.shift_px[k, ..., 0], "shift of the centroid, rows", "px", True),
                (found.shift_px[k, ..., 1], "columns", "px", True),
            )
            for column, (image, title, unit, signed) in enumerate(panels):
                axes = fig.add_subplot(len(planes), 3, 3 * row + column + 1)
                axes.set_facecolor("#d1d5db")
                draw_image(
                    axes,
                    image,
                    title=title,
                    unit=unit,
                    xlabel="position x (px)",
                    ylabel="position y (px)",
                    signed=signed,
                )
                if not signed:
                    axes.images[0].set_clim(*map_levels(image))
        shown = "" if len(planes) == len(found.planes) else f"; {len(planes)} of {len(found.planes)} planes"
        words = f"Difference at equal light and shift of centroids over positions (grey: not compared){shown}."
        return ReportPicture("maps", MAPS, words, _png(fig))


def _png(fig: object) -> bytes:
    out = io.BytesIO()
    fig.savefig(out, format="png")  # type: ignore[attr-defined]
    return out.getvalue()
