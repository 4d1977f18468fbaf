"""Draw all curves of accuracy on one page."""

from __future__ import annotations

import math
import os
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

from lfcal.accuracy.curves import CostPoint, Curve, cost_axis, marks_of
from lfcal.base import COLOURS, LINES, InputError, figure, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Annotation
    from matplotlib.transforms import Bbox

__all__ = ["draw_curves"]

COLUMNS = 3

ANCHORS = ((1, 1), (-1, -1), (-1, 1), (1, -1))
"""Directions from a point to its name, best first. A chosen point or one in use is always named."""

FLOOR = 1e-9
"""Value at which an error of zero is drawn on a logarithmic axis."""


def draw_curves(
    curves: Sequence[Curve], path: str | os.PathLike[str], title: str = "", *, error: float | None = None
) -> None:
    """Plot the curves that have points in one figure, each in a log-log panel with the Pareto front as a line.

    Points are labelled where the labels do not overlap. A square marks points whose `CostPoint.in_use` is True; these
    points and the one with the star (see ``error``) are always labelled.

    Parameters
    ----------
    curves
        Curves to plot; those without points are left out.
    path
        Image file to write; its suffix determines the format, such as ``.png``.
    title
        Title of the figure; empty: none.
    error
        Requested relative error (0.01 is 1 %). It is drawn as a line in each panel, with a star at the cheapest point
        that reaches it. None: not drawn.

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
        fig.draw_without_rendering()  # names need the final size of the panels
        for axes, curve in zip(fig.axes, shown, strict=True):
            _name_points(axes, curve, None if error is None else curve.cheapest(error))
        save_figure(fig, path)


def _panel(axes: Axes, curve: Curve, error: float | None) -> None:
    at = _positions(curve)
    front = [place for place, point in zip(at, curve.points, strict=True) if point.efficient]
    axes.plot(*zip(*at, strict=True), "o", ms=4, mfc="none", color=COLOURS["muted"])
    axes.plot(*zip(*front, strict=True), "o-", ms=4, color=LINES[0], lw=1)
    _logarithmic(axes)
    chosen = None if error is None else curve.cheapest(error)
    if error is not None:
        axes.axhline(100 * error, color=COLOURS["fair"], ls="--", lw=1)
    for place, point in zip(at, curve.points, strict=True):
        if point is chosen:
            axes.plot(*place, "*", ms=13, mfc="none", mec=COLOURS["good"], mew=1.4)
        if point.in_use:
            axes.plot(*place, "s", ms=10, mfc="none", mec="black", mew=1.2)
    axes.set_title(curve.title)
    axes.set_xlabel(cost_axis(curve)[0])
    axes.set_ylabel(textwrap.fill(f"{curve.error.split(',')[0]} (%)", 40))
    axes.margins(0.12)


def _positions(curve: Curve) -> list[tuple[float, float]]:
    """Return the positions of all points in a panel: cost in the unit of the axis, and error (%)."""
    _, scale = cost_axis(curve)
    return [(point.cost / scale, 100 * max(point.error, FLOOR)) for point in curve.points]


def _name_points(axes: Axes, curve: Curve, chosen: CostPoint | None) -> None:
    """Write names of points where they cover neither points nor each other; the most important ones come first."""
    from matplotlib.transforms import Bbox

    at, inside = _positions(curve), axes.get_window_extent()
    spots = axes.transData.transform(at)
    taken = [Bbox.from_bounds(x - 4, y - 4, 8, 8) for x, y in spots]
    marks = [marks_of(point, chosen) for point in curve.points]
    order = sorted(range(len(at)), key=lambda k: ("chosen" not in marks[k], "in use" not in marks[k], not marks[k], k))
    for k in order:
        found = [word for word in marks[k] if word != "efficient"]
        words = curve.points[k].label + (f" ({', '.join(found)})" if found else "")
        names = [_named(axes, at[k], words, direction, strong=bool(marks[k])) for direction in ANCHORS]
        boxes = [name.get_window_extent() for name in names]
        free = [n for n, box in enumerate(boxes) if _within(box, inside) and not any(map(box.overlaps, taken))]
        kept = free[0] if free else 0 if found else None
        taken += [boxes[kept]] if kept is not None else []
        for n, name in enumerate(names):
            if n != kept:
                name.remove()


def _named(axes: Axes, at: tuple[float, float], words: str, direction: tuple[int, int], *, strong: bool) -> Annotation:
    """Write a name next to a point, in one of the four directions."""
    across, up = direction
    return axes.annotate(
        words,
        at,
        xytext=(5 * across, 5 * up),
        textcoords="offset points",
        ha="left" if across > 0 else "right",
        va="bottom" if up > 0 else "top",
        fontsize=7,
        color="black" if strong else COLOURS["muted"],
    )


def _within(box: Bbox, outer: Bbox) -> bool:
    return bool(outer.x0 <= box.x0 and box.x1 <= outer.x1 and outer.y0 <= box.y0 and box.y1 <= outer.y1)


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
