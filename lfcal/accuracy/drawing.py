"""Draw all curves of accuracy on one page."""

from __future__ import annotations

import math
import os
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

from lfcal.accuracy.curves import Curve, cost_axis
from lfcal.base import COLOURS, LINES, InputError, figure, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_curves"]

COLUMNS = 3

FLOOR = 1e-9
"""Value at which an error of zero is drawn on a logarithmic axis."""


def draw_curves(
    curves: Sequence[Curve], path: str | os.PathLike[str], title: str = "", *, error: float | None = None
) -> None:
    """Plot all curves that have points on one page, each in a logarithmic panel with the Pareto front as a line.

    Parameters
    ----------
    curves
        The curves.
    path
        File to write; its suffix determines the format, such as PNG.
    title
        Title of the page.
    error
        Requested relative error, shown as a line in each panel and a star at the cheapest point.

    Raises
    ------
    InputError
        If none of the curves has a point.
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.accuracy import Curve, CostPoint, draw_curves
    >>> curve = Curve("averaging", "Frames averaged", "noise over the signal", "frames at each position", "frames")
    >>> for n in (1, 4, 16, 64):
    ...     curve = curve.with_point(CostPoint(f"mean of {n}", {}, 0.08 / n**0.5, n, "frames"))
    >>> draw_curves([curve], "accuracy.png", error=0.02)
    >>> print(Path("accuracy.png").read_bytes()[1:4])
    b'PNG'
    """
    shown = [curve for curve in curves if curve.points]
    if not shown:
        raise InputError.expected(
            "curves to draw", "at least one with measurements", "none", "allow a longer time for each measurement"
        )
    columns = min(COLUMNS, len(shown))
    rows = math.ceil(len(shown) / columns)
    with figure(4.4 * columns, 3.6 * rows) as fig:
        if title:
            fig.suptitle(title)
        for k, curve in enumerate(shown):
            _panel(fig.add_subplot(rows, columns, k + 1), curve, error)
        save_figure(fig, path)


def _panel(axes: Axes, curve: Curve, error: float | None) -> None:
    label, scale = cost_axis(curve)
    points = [(point.cost / scale, 100 * max(point.error, FLOOR)) for point in curve.points]
    axes.plot(*zip(*points, strict=True), "o", ms=4, color=LINES[0])
    front = [(point.cost / scale, 100 * max(point.error, FLOOR)) for point in curve.front]
    axes.plot(*zip(*front, strict=True), "-", color=COLOURS["muted"], lw=1)
    _logarithmic(axes)
    if error is not None:
        axes.axhline(100 * error, color=COLOURS["fair"], ls="--", lw=1)
        found = curve.cheapest(error)
        if found is not None:
            at = found.cost / scale, 100 * max(found.error, FLOOR)
            axes.plot(*at, "*", ms=13, mfc="none", mec=COLOURS["good"], mew=1.4)
            axes.annotate(found.label, at, xytext=(6, 6), textcoords="offset points", fontsize=7)
    axes.set_title(curve.title)
    axes.set_xlabel(label)
    axes.set_ylabel(textwrap.fill(f"{curve.error.split(',')[0]} (%)", 40))


def _logarithmic(axes: Axes) -> None:
    """Make both axes logarithmic, with labels at 1, 2 and 5 that do not overlap."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_data_interval()
        few = high < 30 * low
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if few else (1,), numticks=8))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
