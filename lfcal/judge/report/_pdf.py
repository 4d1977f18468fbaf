"""The report as PDF: A4 pages with the verdict, what to do, faults, metrics, apertures and every picture."""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal import __version__
from lfcal.base import COLOURS, figure, format_share, one_line
from lfcal.judge.inspection import Inspection
from lfcal.judge.quality import QualityReport, counted_words, merit_word
from lfcal.judge.report._pictures import ReportPicture
from lfcal.judge.report.page import limits
from lfcal.judge.telling import compared_words, cost_words, drawn
from lfcal.psf import PSFMatrix

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["PageBlock", "blocks", "iter_pages", "pdf"]

WIDTH, HEIGHT = 8.27, 11.69
"""Width and height of a page, A4 (inches)."""

SIDE, TOP, BOTTOM = 0.75, 0.7, 0.75
"""Margins (inches)."""

POINT = 1 / 72

LETTER = 0.56
"""Average width of a letter, relative to the size of its font."""

LISTED = 30
"""Number of positions that are listed."""


@dataclass(frozen=True)
class PageBlock:
    """A block of a page: words, a picture, or words above a picture.

    Attributes
    ----------
    words
        Text, wrapped to the width of the page.
    size, bold, colour
        Font of the words: size (points), bold, colour.
    cells, at
        Words of a table row, one for each column, and left edges of the columns (inches from the left margin).
    picture, width
        PNG below the words, and its largest width (inches).
    gap
        Space above the block (inches).
    keep
        Whether the next block must be on the same page.
    """

    words: str = ""
    size: float = 9.0
    bold: bool = False
    colour: str = "#1f2937"
    cells: tuple[str, ...] = ()
    at: tuple[float, ...] = ()
    picture: bytes = b""
    width: float = WIDTH - 2 * SIDE
    gap: float = 0.04
    keep: bool = False

    def lines(self) -> list[list[str]]:
        """Return the lines of each column."""
        if not self.cells:
            return [_wrapped(self.words, WIDTH - 2 * SIDE, self.size)] if self.words else []
        ends = (*self.at[1:], WIDTH - 2 * SIDE)
        return [
            _wrapped(text, end - start - 0.08, self.size)
            for text, start, end in zip(self.cells, self.at, ends, strict=True)
        ]

    def height(self) -> float:
        """Return the height of the block (inches)."""
        rows = max((len(column) for column in self.lines()), default=0)
        size = _size_of(self)[1] if self.picture else 0.0
        return self.gap + rows * 1.3 * self.size * POINT + size


def _wrapped(text: str, width: float, size: float) -> list[str]:
    many = max(4, int(width / (LETTER * size * POINT)))
    return [line for part in text.split("\n") for line in textwrap.wrap(part, many) or [""]]


def _size_of(block: PageBlock) -> tuple[float, float]:
    """Return the width and height of the image of a block (inches), which keeps its aspect ratio and fits on a page."""
    rows, columns = _pixels(block.picture)
    width = min(block.width, columns / 90)
    height = width * rows / columns
    most = HEIGHT - TOP - BOTTOM - 1.0
    return (width, height) if height <= most else (width * most / height, most)


def _pixels(png: bytes) -> tuple[int, int]:
    """Return the number of rows and columns of a PNG, from its first chunk."""
    return int.from_bytes(png[20:24], "big"), int.from_bytes(png[16:20], "big")


def blocks(
    H: PSFMatrix,
    inspection: Inspection,
    pictures: Sequence[ReportPicture],
    *,
    every: bool = False,
) -> list[PageBlock]:
    """Return all blocks of the pages in their order, with what is needed for a decision first.

    With ``every``, metrics that do not apply are listed as well.
    """
    quality = inspection.quality
    nz, ny, nx, nt, ns = quality.shape
    ends = quality.extent or "depths not stated"
    camera = f"; camera {H.camera.name}" if H.camera is not None else ""
    facts = f"{nz} planes, {ends}; {ny} × {nx} positions; cutout {nt} × {ns} pixels{camera}"
    found = [
        PageBlock(one_line(Path(H.path).name) or "PSF matrix", 17, bold=True),
        PageBlock(f"PSF quality report, {datetime.now().astimezone():%Y-%m-%d %H:%M}", 9, colour=COLOURS["muted"]),
        PageBlock(inspection.verdict, 13, True, COLOURS.get(inspection.merit, "#1f2937"), gap=0.2),
        PageBlock(facts, gap=0.06),
    ]
    if inspection.asked:
        found += _faults(inspection)
    found += [*_actions(inspection), *_metrics(inspection, every)]
    return [*found, *_apertures(quality), *_drawn(pictures)]


def _heading(text: str) -> PageBlock:
    return PageBlock(text, 12, bold=True, gap=0.22, keep=True)


def _faults(inspection: Inspection) -> Iterator[PageBlock]:
    yield _heading("Compared with the camera's model")
    words = compared_words(inspection)
    yield PageBlock(f"{words[:1].upper()}{words[1:]}.")
    for k, fault in enumerate(inspection.faults):
        share, cost = format_share(min(fault.share, 1.0)), cost_words(inspection, fault)
        head = f"{k + 1}. {fault.title}: {share} of the light; error of a reconstruction {cost}"
        yield PageBlock(head, 10, bold=True, gap=0.14, keep=True)
        yield PageBlock(fault.detail, keep=True)
        yield PageBlock(f"What to do: {fault.fault.advice}", keep=fault.picture is not None)
        if fault.picture is not None:
            # the three most important ones are large; the others are smaller
            yield PageBlock(picture=drawn(fault.picture), width=3.4 if k < 3 else 2.6)


def _actions(inspection: Inspection) -> Iterator[PageBlock]:
    """Yield findings by subject with what to do about each, and the positions to record again."""
    redo = inspection.redo()
    if inspection.judgement.findings or redo:
        yield _heading("What to do")
    for subject, found in inspection.judgement.by_subject().items():
        for one in found:
            words = f"{subject}: {one.sentence} {one.remedy}"
            yield PageBlock(words, colour=COLOURS.get(one.merit, "#1f2937"))
    if redo:
        places = ", ".join(f"({z}, {y}, {x})" for (z, y, x), _ in redo[:LISTED])
        more = f" and {len(redo) - LISTED} more" if len(redo) > LISTED else ""
        yield PageBlock(f"Record again (z, y, x): {places}{more}. redo.json contains the list.")


AT = (0.0, 0.65, 2.55, 4.25, 4.95, 5.65)
"""Left edges of the columns of the table of metrics (inches from the left margin)."""


def _metrics(inspection: Inspection, every: bool) -> Iterator[PageBlock]:
    quality = inspection.quality
    yield _heading("Checks")
    yield PageBlock(f"{counted_words(quality.metrics)}.", keep=True)
    yield PageBlock(
        cells=("merit", "check", "value", "good", "bad", "cost or cause"), at=AT, size=8, bold=True, keep=True
    )
    for m in (m for m in quality.metrics if every or m.applies):
        named = m.merit in ("bad", "fair")
        cause = inspection.settled(m) if named else None
        gone = named and inspection.withdrawn(m)
        last = f"see {cause.title}" if cause is not None else "not confirmed" if gone else m.cost_text
        tone = COLOURS["muted"] if cause is not None or gone else COLOURS.get(m.merit, COLOURS["muted"])
        cells = (merit_word(m), m.spec.title, m.text, *limits(m), last)
        yield PageBlock(cells=cells, at=AT, size=8, colour=tone, gap=0.02)


def _apertures(quality: QualityReport) -> Iterator[PageBlock]:
    yield _heading("Aperture")
    for z, aperture in enumerate(quality.apertures):
        yield PageBlock(f"{quality.plane_words(z)}: {aperture.describe()}", 8)
    if quality.iris is not None:
        yield PageBlock(f"All planes together: {quality.iris.describe()}", 8)
    f = quality.f_number
    if f is not None:
        error = f" ± {f.standard_error:.2f}" if math.isfinite(f.standard_error) else ""
        yield PageBlock(f"Working f-number from the size of the illuminated disc over depth: {f.value:.2f}{error}", 8)


def _drawn(pictures: Sequence[ReportPicture]) -> Iterator[PageBlock]:
    for one in pictures:
        yield PageBlock(one.caption, 8, colour=COLOURS["muted"], gap=0.2, keep=True)
        yield PageBlock(picture=one.png)


def iter_pages(content: Sequence[PageBlock]) -> Iterator[Figure]:
    """Yield each page as a figure, which is valid until the next page is requested."""
    rest = list(content)
    number = 0
    while rest:
        number += 1
        with figure(WIDTH, HEIGHT, dpi=110) as fig:
            fig.set_layout_engine("none")
            y = TOP
            first = True
            while rest and (first or y + _together(rest) <= HEIGHT - BOTTOM):
                y = _put(fig, rest.pop(0), y)
                first = False
            foot = f"lfcal {__version__}, page {number}"
            fig.text(1 - SIDE / WIDTH, 0.4 / HEIGHT, foot, size=7, ha="right", color=COLOURS["muted"])
            yield fig


def _together(rest: Sequence[PageBlock]) -> float:
    """Return the height of the first block and of all blocks that must be on the same page (inches)."""
    total = 0.0
    for one in rest:
        total += one.height()
        if not one.keep:
            break
    return min(total, HEIGHT - TOP - BOTTOM)


def _put(fig: Figure, block: PageBlock, y: float) -> float:
    """Draw a block at the distance ``y`` (inches) from the top of the page; return the distance of the next one."""
    y += block.gap
    step = 1.3 * block.size * POINT
    columns = block.lines()
    for k, column in enumerate(columns):
        x = SIDE + (block.at[k] if block.cells else 0.0)
        for row, line in enumerate(column):
            fig.text(
                x / WIDTH,
                1 - (y + row * step) / HEIGHT,
                line,
                size=block.size,
                weight="bold" if block.bold else "normal",
                color=block.colour,
                va="top",
                parse_math=False,
            )
    y += step * max((len(column) for column in columns), default=0)
    if block.picture:
        from matplotlib.image import imread

        width, height = _size_of(block)
        axes = fig.add_axes((SIDE / WIDTH, 1 - (y + height) / HEIGHT, width / WIDTH, height / HEIGHT))
        axes.imshow(imread(io.BytesIO(block.picture), format="png"), interpolation="none", aspect="auto")
        axes.set_axis_off()
        y += height
    return y


def pdf(content: Sequence[PageBlock], title: str) -> bytes:
    """Return the pages as PDF."""
    from matplotlib.backends.backend_pdf import PdfPages

    out = io.BytesIO()
    with PdfPages(out, metadata={"Title": title, "Creator": f"lfcal {__version__}"}) as pages:
        for fig in iter_pages(content):
            pages.savefig(fig)
    return out.getvalue()
