"""Comparison of two H: the request, the comparison as a job, and the images of a position. No Qt."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Work
from lfcal_gui.models.display import levels_of
from lfcal_gui.models.stamp import Stamp
from lfcal_gui.models.step import CommandStep, options_of
from lfcal_gui.models.words import capital

if TYPE_CHECKING:
    from lfcal.judge import Comparison, Pair
    from lfcal.psf import PSFMatrix

F8 = NDArray[np.float64]
Place = tuple[int, int, int]
"""Index of the pair of planes, and position (y, x) in the first H."""

COMPARED_MODES = (("side", "side by side"), ("blink", "blink"), ("difference", "difference"))
"""Ways to display two H."""

COMPARED_COLUMNS = ("Plane, lenslets", "NRMSE (%)", "Scale", "Scaled (%)", "Shift (px)", "Residual (%)")
COMPARED_TIPS = (
    "Number and depth of the plane, with both numbers where they differ; lenslet type whose pixels are compared",
    "|A − B| / |B|, without scaling",
    "The factor g that minimises |A − g B|",
    "|A − g B| / |A|: 0 if both are equal up to scale, 1 if they have nothing in common",
    "Shift of A relative to B: rows, columns",
    "Residual of A after the best scale and shift",
)
"""Column titles of the table of numbers, with their tooltips."""

WORST = 12
"""Number of positions offered for inspection."""


@dataclass(frozen=True)
class CompareRequest:
    """Request to compare two files in their state at the time of the request.

    Attributes
    ----------
    first, second
        The files.
    by_number
        Whether planes are paired by number instead of depth.
    mat_orders
        ``mat_order`` of each file, as in `lfcal.psf.open_psf`.
    """

    first: Stamp
    second: Stamp
    by_number: bool
    mat_orders: tuple[str, str] = ("", "")

    @property
    def mat_order(self) -> str:
        """Order of the axes that a command uses for both files.

        Raises
        ------
        InputError
            If the orders of two .mat files differ.
        """
        files = zip((self.first[0], self.second[0]), self.mat_orders, strict=True)
        orders = {order for path, order in files if path.lower().endswith(".mat")}
        if len(orders) > 1:
            raise InputError.expected(
                "order of axes",
                "the same for both .mat files",
                " and ".join(sorted(order or "automatic" for order in orders)),
                "choose the same order for both files in H",
            )
        return next(iter(orders), "")

    def open(self, stack: ExitStack) -> tuple[PSFMatrix, PSFMatrix]:
        """Open both files; ``stack`` closes them."""
        from lfcal.psf import open_psf

        a, b = (
            stack.enter_context(open_psf(stamp[0], mat_order=order))
            for stamp, order in zip((self.first, self.second), self.mat_orders, strict=True)
        )
        return a, b

    @property
    def names(self) -> tuple[str, str]:
        """Names of the files, with their folders if the names are equal."""
        paths = [Path(stamp[0]) for stamp in (self.first, self.second)]
        if paths[0].name == paths[1].name:
            return f"{paths[0].parent.name}/{paths[0].name}", f"{paths[1].parent.name}/{paths[1].name}"
        return paths[0].name, paths[1].name


@dataclass(eq=False)
class KeptDifference:
    """Result of a comparison that runs in a thread."""

    found: Comparison | None = None


def iter_compare(asked: CompareRequest, kept: KeptDifference) -> Work[None]:
    """Compare two files; the result is stored in ``kept``, because the job list outlives the jobs."""
    from lfcal.judge import iter_compare

    with ExitStack() as stack:
        a, b = asked.open(stack)
        kept.found = yield from iter_compare(a, b, by_number=asked.by_number)


def iter_compared(asked: CompareRequest, found: Comparison, folder: str) -> Work[Path]:
    """Write the report of a comparison with images of both files, which are reopened; return the HTML page."""
    from lfcal.judge import pair
    from lfcal.judge.report import iter_compared_report

    with ExitStack() as stack:
        a, b = asked.open(stack)
        both = replace(found, pair=pair(a, b, by_number=asked.by_number))
        page = yield from iter_compared_report(both, folder)
        return page


def compared_files(folder: str) -> list[Path]:
    """Return the files of a comparison's report that may already exist in ``folder``."""
    from lfcal.judge.report import compared_report_files

    return [Path(one) for one in compared_report_files(Path(folder))]


# -- numbers -----------------------------------------------------------------------------------------------
def compared_words(found: Comparison) -> tuple[str, str]:
    """Return the verdict, and what was compared and omitted, as text."""
    from lfcal.judge.report import compared_words as words_of
    from lfcal.judge.report import verdict

    lines = (words_of(found), *found.notes)
    return verdict(found), " ".join(capital(words if words[-1] == "?" else f"{words}.") for words in lines)


def compared_rows(found: Comparison) -> list[tuple[str, ...]]:
    """Return the rows of the table of numbers. The correlation is omitted, because ``scaled`` is equivalent."""
    from lfcal.judge.report import figure_rows

    return [(plane if kind == "all" else f"{plane}, {kind}", *rest[:-1]) for plane, kind, *rest in figure_rows(found)]


def compared_numbers(found: Comparison) -> list[tuple[float, ...]]:
    """Return the numbers by which the rows of the table are sorted."""
    rows: list[tuple[float, ...]] = []
    for k, (whole, types) in enumerate([(found.all, found.types), *((p.all, p.types) for p in found.planes)]):
        for t, one in enumerate((whole, *types)):
            far = float(np.hypot(*one.shift_px))
            rows.append((float(100 * k + t), one.nrmse, one.scale, one.scaled, far, one.left))
    return rows


def plane_of_row(found: Comparison, row: int) -> int | None:
    """Return the index of the pair of planes of a table row; None for the row of all planes."""
    kinds = 1 + len(found.types)
    return row // kinds - 1 if row >= kinds else None


def differing_most(found: Comparison) -> list[tuple[str, Place]]:
    """Return the positions that differ most, as text and as indices, worst first."""
    return [
        (f"({found.pair.planes[k][0]}, {y}, {x}): {100 * found.error[k, y, x]:.3g} %", (k, y, x))
        for k, y, x in found.worst(WORST)
    ]


# -- pictures ----------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Both:
    """One position of both H, scaled to the energy of the first.

    Attributes
    ----------
    place
        Pair of planes and position.
    first, second, difference
        Patterns ``(nt, ns)``.
    levels, signed_levels
        Limits of the scale that the first two share, and of the scale of the difference.
    """

    place: Place
    first: F8
    second: F8
    difference: F8
    levels: tuple[float, float]
    signed_levels: tuple[float, float]


def both_at(pair: Pair, place: Place) -> Both:
    """Return one position of both H with its difference."""
    first, second = pair.patterns(*place)
    light, other = float(np.nansum(first)), float(np.nansum(second))
    if light > 0 and other > 0:
        second = second * (light / other)
    apart = first - second
    # negative noise would take up the dark end of a logarithmic scale
    high = max(levels_of(first)[1], levels_of(second)[1])
    return Both(place, first, second, apart, (0.0, high), levels_of(apart, signed=True))


# -- as a command ------------------------------------------------------------------------------------------
def compare_step(
    first: str, second: str, out: str = "", *, by_number: bool = False, mat_order: str = ""
) -> CommandStep:
    """Return the command and Python code that compare two H; ``out`` is the folder of the report, if any."""
    pairs = (("--report", out), ("--by-number", by_number), ("--mat-order", mat_order))
    a, b = (_opened(path, mat_order) for path in (first, second))
    report = f"    drain(iter_compared_report(found, {out!r}))\n" if out else ""
    python = f"""
from lfcal.base.progress import drain
from lfcal.psf import open_psf
from lfcal.judge import compare
from lfcal.judge.report.two import iter_compared_report, verdict

with {a} as a, {b} as b:
    found = compare(a, b, by_number={by_number!r})
    print(verdict(found))
{report}"""
    return CommandStep(("compare", first, second, *options_of(pairs)), python)


def _opened(path: str, mat_order: str) -> str:
    order = f", mat_order={mat_order!r}" if mat_order and path.lower().endswith(".mat") else ""
    return f"open_psf({path!r}{order})"
