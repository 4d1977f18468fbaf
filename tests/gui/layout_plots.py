"""What is wrong with plots: names and numbers of axes that collide or are cut, parts that have no room."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, pairwise

import pyqtgraph as pg
from PySide6.QtCore import QRectF
from PySide6.QtGui import QPainter, QPicture
from PySide6.QtWidgets import QGraphicsItem, QGraphicsTextItem, QGraphicsView

__all__ = ["of_plots"]

BESIDE = 1.0
"""Room between numbers of an axis (px)."""

LEAST = 24
"""Side of the inside of a plot (px)."""


def of_plots(view: QGraphicsView) -> Iterator[str]:
    """Yield what is wrong with the axes and parts of the plots in a view."""
    scene = view.scene()
    seen = QRectF(view.mapToScene(view.viewport().rect()).boundingRect()).adjusted(-2, -2, 2, 2)
    items = [item for item in scene.items() if item.isVisible()] if scene is not None else []
    yield from _names(items)
    for item in items:
        if isinstance(item, pg.AxisItem):
            yield from _name(item, seen)
            yield from _numbers(item)
        elif isinstance(item, pg.ViewBox) and not isinstance(item.parentItem(), pg.ViewBox):
            box = item.sceneBoundingRect()
            if min(box.width(), box.height()) < LEAST and item.parentItem() is not None:
                yield f"a plot has {box.width():.0f} x {box.height():.0f} px inside"
        elif isinstance(item, pg.LegendItem | pg.LabelItem):
            box = item.sceneBoundingRect()
            if box.width() and not seen.contains(box):
                yield f"{type(item).__name__} lies outside: {_rect(box)} in {_rect(seen)}"
        elif isinstance(item, pg.TextItem):
            yield from _words(item)


def _rect(box: QRectF) -> str:
    return f"{box.x():.0f}, {box.y():.0f}, {box.width():.0f} x {box.height():.0f}"


def _inked(label: QGraphicsTextItem) -> QRectF:
    """Return where the words of a label are in its scene, without the margin round them."""
    return label.sceneBoundingRect().adjusted(4, 4, -4, -4)


def _names(items: list[QGraphicsItem]) -> Iterator[str]:
    """Names of axes that lie over each other, as they are longer than their axes."""
    named = [item.label for item in items if isinstance(item, pg.AxisItem) and item.label.isVisible()]
    labels = [label for label in named if label.toPlainText().strip()]
    for one, other in combinations(labels, 2):
        if _inked(one).intersects(_inked(other)):
            yield f"axes {one.toPlainText().strip()!r} and {other.toPlainText().strip()!r} lie over each other"


def _name(axis: pg.AxisItem, seen: QRectF) -> Iterator[str]:
    """Names of axes that reach out of the view, or are not in the middle of their axis."""
    text = axis.label.toPlainText().strip()
    if not axis.label.isVisible() or not text:
        return
    along = axis.orientation in ("left", "right")
    length = axis.size().height() if along else axis.size().width()
    box = _inked(axis.label)
    if not seen.contains(box):
        yield f"axis {text!r} needs {_rect(box)}, has {_rect(seen)}"
    centre = axis.label.mapToParent(axis.label.boundingRect().center())
    off = (centre.y() if along else centre.x()) - length / 2
    if abs(off) > 6:
        yield f"axis {text!r} is named {off:+.0f} px from its middle"


def _drawn(axis: pg.AxisItem) -> list[tuple[QRectF, str]]:
    """Return the numbers of an axis as they are drawn, and where."""
    picture = QPicture()
    painter = QPainter(picture)
    try:
        if axis.style["tickFont"]:
            painter.setFont(axis.style["tickFont"])
        specs = axis.generateDrawSpecs(painter)
    finally:
        painter.end()
    return [] if specs is None else [(QRectF(box), text) for box, _, text in specs[2] if text.strip()]


def _places(axis: pg.AxisItem, length: float) -> int:
    """Return how many numbers stand at the widest ticks inside, where the axis finds them itself."""
    if axis._tickLevels is not None or length < LEAST:
        return 0
    low, high = sorted(axis.range)
    levels = axis.tickValues(low, high, length)
    return sum(low <= value <= high for value in levels[0][1]) if levels else 0


def _numbers(axis: pg.AxisItem) -> Iterator[str]:
    if not axis.style["showValues"]:
        return
    name, along = axis.label.toPlainText().strip(), axis.orientation in ("left", "right")
    numbers = _drawn(axis)
    places = _places(axis, axis.size().height() if along else axis.size().width())
    if places > 2 * len(numbers) or (name and axis._tickLevels is None and not numbers):
        yield f"axis {name!r} shows {len(numbers)} numbers of {places} in its range {axis.range}"
    ends = sorted(((b.top(), b.bottom()) if along else (b.left(), b.right())) + (t,) for b, t in numbers)
    for (_, end, one), (start, _, other) in pairwise(ends):
        if start < end + BESIDE:
            yield f"axis {name!r}: its numbers {one!r} and {other!r} collide"
    if not axis.label.isVisible() or not name:
        return
    title = axis.mapRectFromItem(axis.label, axis.label.boundingRect()).adjusted(3, 3, -3, -3)
    for box, text in numbers:
        if title.intersects(box):
            yield f"axis {name!r}: its name lies over its number {text!r}"


def _words(item: pg.TextItem) -> Iterator[str]:
    """Words in a plot that are cut where it ends."""
    view = item.getViewBox()
    if view is None:
        return
    box, inside = item.sceneBoundingRect(), view.sceneBoundingRect()
    words = item.toPlainText()
    if words and inside.contains(item.mapToScene(0, 0)) and not inside.adjusted(-3, -3, 3, 3).contains(box):
        yield f"words {words[:40]!r} in a plot are cut: {_rect(box)} in {_rect(inside)}"
