"""Flaws in the layout of widgets and plots: cut text, parts that overlap, needless scroll bars."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, pairwise

import pyqtgraph as pg
from PySide6 import QtWidgets as qt
from PySide6.QtCore import QModelIndex, QRect, QRectF, Qt
from PySide6.QtGui import QFontMetrics, QPainter, QPicture, QTextDocument
from PySide6.QtWidgets import QGraphicsItem, QGraphicsTextItem, QGraphicsView

from lfcal_gui.widgets.words import ElidedLabel

__all__ = ["drawn_numbers", "flaws"]
SLACK = 2
"""Largest difference that is no flaw (px)."""

SMALLEST = 1200
"""Width that the smallest window has for a dialog (px)."""

INPUTS = (qt.QAbstractButton, qt.QComboBox, qt.QLineEdit, qt.QAbstractSpinBox)
CONTROLS = (*INPUTS, qt.QSlider, qt.QProgressBar, qt.QTabBar)
NEARLY = 16
"""A scroll bar for less than this is needless (px)."""

BUTTONS = (qt.QPushButton, qt.QCheckBox, qt.QRadioButton, qt.QToolButton)
OVERLAY = "overlay"
"""Property of a widget that overlaps others intentionally."""

BETWEEN = 1.0
"""Room between numbers of an axis (px)."""

LEAST = 24
"""Side of the inside of a plot (px)."""


def less(has: float, needs: float) -> bool:
    """Return whether there is less room than is needed (px)."""
    return has + SLACK < needs


def flaws(root: qt.QWidget) -> list[str]:
    """Return the flaws below ``root``, one line each: which widget, and what is wrong."""
    found = []
    for widget in (root, *root.findChildren(qt.QWidget)):
        if not _seen(widget):
            continue
        for words in _of(widget):
            found.append(f"{_path(widget)}: {words}")
    return found


def _seen(widget: qt.QWidget) -> bool:
    """Return whether a part of a widget is inside all that it lies in.

    Not its visible region: that of a plot is empty, as its viewport covers it.
    """
    if not widget.isVisible():
        return False
    inside, at = widget.rect(), widget
    while not at.isWindow():
        above = at.parentWidget()
        inside = inside.translated(at.pos()).intersected(above.rect())
        at = above
    return not inside.isEmpty()


def _of(widget: qt.QWidget) -> Iterator[str]:
    if isinstance(widget, qt.QLabel):
        yield from _label(widget)
    elif isinstance(widget, BUTTONS):
        if widget.text() and less(widget.width(), widget.sizeHint().width()):
            yield f"{widget.text()!r} needs {widget.sizeHint().width()} px, has {widget.width()}"
    elif isinstance(widget, qt.QComboBox):
        yield from _box(widget)
    elif isinstance(widget, qt.QLineEdit):
        yield from _edit(widget)
    elif isinstance(widget, qt.QTabBar):
        yield from _tabs(widget)
    elif isinstance(widget, qt.QAbstractScrollArea):
        yield from _area(widget)
        yield from _nested(widget)
    yield from _squeezed(widget)
    yield from _siblings(widget)


def _label(label: qt.QLabel) -> Iterator[str]:
    text = label.text()
    if isinstance(label, ElidedLabel) and (label.toolTip() == text or "\n" in qt.QLabel.text(label)):
        return  # what is left out can be read, or all of it in two lines
    if not text.strip() or (label.pixmap() and not label.pixmap().isNull()):
        return
    short = text[:60]
    if not label.wordWrap():
        if less(label.width(), label.sizeHint().width()):
            yield f"{short!r} needs {label.sizeHint().width()} px, has {label.width()}"
        return
    needs = label.heightForWidth(label.width())
    if less(label.height(), needs):
        yield f"{short!r} needs a height of {needs} px, has {label.height()}"
    page = QTextDocument()
    page.setDefaultFont(label.font())
    page.setDocumentMargin(0)
    rich = label.textFormat() != Qt.TextFormat.PlainText and "<" in text
    (page.setHtml if rich else page.setPlainText)(text)
    page.setTextWidth(label.contentsRect().width())
    if less(label.contentsRect().width(), int(page.idealWidth())):
        yield f"{short!r} has a word of {page.idealWidth():.0f} px in {label.contentsRect().width()}"


def _box(box: qt.QComboBox) -> Iterator[str]:
    needs = QFontMetrics(box.font()).horizontalAdvance(box.currentText())
    has = box.width() - 24  # the arrow
    if less(has, needs):
        yield f"chosen {box.currentText()!r} needs {needs} px, has {has}"


def _edit(edit: qt.QLineEdit) -> Iterator[str]:
    text = edit.displayText() or edit.placeholderText()
    needs = QFontMetrics(edit.font()).horizontalAdvance(text)
    has = edit.width() - 12
    if "/" not in text and less(has, needs):
        yield f"text {text!r} needs {needs} px, has {has}"


def _tabs(bar: qt.QTabBar) -> Iterator[str]:
    for k in range(bar.count()):
        if bar.isTabVisible(k) and bar.tabRect(k).right() > bar.width():
            yield f"tab {bar.tabText(k)!r} does not fit"


def _area(area: qt.QAbstractScrollArea) -> Iterator[str]:
    if isinstance(area, qt.QTableView):
        yield from _cells(area)
    for bar in (area.horizontalScrollBar(), area.verticalScrollBar()):
        lines = isinstance(area, qt.QPlainTextEdit) and bar is area.verticalScrollBar()  # it counts lines, not pixels
        more = (bar.maximum() - bar.minimum()) * (area.fontMetrics().lineSpacing() if lines else 1)
        if bar.isVisible() and not isinstance(area, qt.QAbstractItemView) and more < NEARLY:
            yield f"a scroll bar for {more} px"
    if isinstance(area, qt.QAbstractItemView | qt.QTextEdit) and area.horizontalScrollBar().isVisible():
        yield "a horizontal scroll bar"
    if isinstance(area, qt.QGraphicsView):
        yield from _plots(area)


def _cells(table: qt.QTableView) -> Iterator[str]:
    model, top = table.model(), table.horizontalHeader()
    for column in range(model.columnCount()):
        if table.isColumnHidden(column):
            continue
        title = str(model.headerData(column, Qt.Orientation.Horizontal) or "")
        if top.isVisible() and less(top.sectionSize(column), QFontMetrics(top.font()).horizontalAdvance(title) + 8):
            yield f"title {title!r} needs more than {top.sectionSize(column)} px"
        for row in range(model.rowCount()):
            index = model.index(row, column)
            if table.indexWidget(index) is not None or not table.visualRect(index).intersects(table.viewport().rect()):
                continue
            text = str(model.data(index) or "")
            if column in getattr(table, "brief", ()) and model.data(index, Qt.ItemDataRole.ToolTipRole) == text:
                continue  # the full text is next to the table
            needs = max(QFontMetrics(table.font()).horizontalAdvance(line) for line in text.split("\n")) + 6
            if not table.wordWrap() and less(table.columnWidth(column), needs):
                yield f"cell {text!r} needs {needs} px, has {table.columnWidth(column)}"


def _nested(area: qt.QAbstractScrollArea) -> Iterator[str]:
    """Yield that an area scrolls inside another one that does: the wheel moves the one or the other."""
    above = area.parentWidget() if area.verticalScrollBar().isVisible() else None
    while above is not None:
        if isinstance(above, qt.QAbstractScrollArea) and above.verticalScrollBar().isVisible():
            yield f"a scroll bar inside the scroll bar of {type(above).__name__}"
            return
        above = above.parentWidget()


def _siblings(parent: qt.QWidget) -> Iterator[str]:
    """Yield parts of ``parent`` that overlap or reach out of it."""
    if isinstance(parent, qt.QAbstractScrollArea | qt.QComboBox | qt.QMainWindow) or parent.layout() is None:
        return
    parts = [
        child
        for child in parent.children()
        if isinstance(child, qt.QWidget)
        and child.isVisible()
        and not child.isWindow()
        and not child.property(OVERLAY)
        and not isinstance(child, qt.QSplitterHandle)
    ]
    inside = parent.rect().adjusted(-SLACK, -SLACK, SLACK, SLACK)
    for k, one in enumerate(parts):
        if not inside.contains(one.geometry()):
            yield f"{type(one).__name__} {_said(one)} reaches out of it by {_out(parent.rect(), one.geometry())} px"
        for other in parts[:k]:
            both = one.geometry().intersected(other.geometry())
            if both.width() > SLACK and both.height() > SLACK:
                yield f"{type(one).__name__} {_said(one)} overlaps {type(other).__name__} {_said(other)}"


def _path(widget: qt.QWidget) -> str:
    names: list[str] = []
    at: qt.QWidget | None = widget
    while at is not None and len(names) < 4:
        names.append(type(at).__name__)
        at = at.parentWidget()
    return " < ".join(names)


def _said(widget: qt.QWidget) -> str:
    text = getattr(widget, "text", None)
    return repr(text()[:40]) if callable(text) else widget.accessibleName()


def _out(outer: QRect, inner: QRect) -> int:
    across = max(outer.left() - inner.left(), inner.right() - outer.right())
    return max(across, outer.top() - inner.top(), inner.bottom() - outer.bottom())


# -- room --------------------------------------------------------------------------------------------------


def _squeezed(widget: qt.QWidget) -> Iterator[str]:
    """Yield what of a widget is cut at its lower or right edge, where no scroll bar reaches the rest."""
    if isinstance(widget, qt.QLabel):
        yield from _lines(widget)
    elif isinstance(widget, CONTROLS):
        needs = min(widget.minimumHeight() or widget.minimumSizeHint().height(), widget.maximumHeight())
        if not isinstance(widget.parentWidget(), qt.QAbstractSpinBox | qt.QComboBox | qt.QLineEdit) and less(
            widget.height(), needs
        ):
            yield f"needs a height of {needs} px, has {widget.height()}"
    elif isinstance(widget, qt.QHeaderView):
        pass  # its table is looked at
    elif isinstance(widget, qt.QAbstractItemView):
        yield from _rows(widget)
    elif isinstance(widget, qt.QTextEdit | qt.QPlainTextEdit):
        yield from _page(widget)
    elif isinstance(widget, qt.QScrollArea):
        yield from _behind(widget)


def _lines(label: qt.QLabel) -> Iterator[str]:
    """Yield the last line of words in separate lines, or of a table of words."""
    picture = label.pixmap()
    if label.wordWrap() or not (label.text().strip() or not picture.isNull()):
        return  # what wraps is looked at with its width
    needs = label.sizeHint().height()
    if less(label.height(), needs):
        yield f"{label.text()[:60]!r} needs a height of {needs} px, has {label.height()}"


def _rows_px(view: qt.QAbstractItemView) -> tuple[int, int]:
    """Return the height of all rows, and of the last of them (px)."""
    if isinstance(view, qt.QTableView):
        rows = view.verticalHeader()
        count = rows.count()
        return rows.length(), rows.sectionSize(count - 1) if count else 0
    if not isinstance(view, qt.QListView | qt.QTreeView) or view.model() is None:
        return 0, 0
    last = _last(view)
    box = view.visualRect(last)
    return box.bottom() + 1 + view.verticalOffset(), box.height()


def _last(view: qt.QAbstractItemView) -> QModelIndex:
    model, root = view.model(), view.rootIndex()
    last = model.index(model.rowCount(root) - 1, 0, root)
    while isinstance(view, qt.QTreeView) and view.isExpanded(last) and model.rowCount(last):
        last = model.index(model.rowCount(last) - 1, 0, last)
    return last


def _rows(view: qt.QAbstractItemView) -> Iterator[str]:
    needs, last = _rows_px(view)
    has = view.viewport().height()
    if view.verticalScrollBar().isVisible():
        if needs - has < last:
            yield f"a scroll bar for {needs - has} px, less than a row"
    elif less(has, needs):
        yield f"its rows need {needs} px, it has {has} and no scroll bar"


def _page(area: qt.QTextEdit | qt.QPlainTextEdit) -> Iterator[str]:
    bar, across, line = area.verticalScrollBar(), area.horizontalScrollBar(), area.fontMetrics().lineSpacing()
    more = (bar.maximum() - bar.minimum()) * (line if isinstance(area, qt.QPlainTextEdit) else 1)
    if not bar.isVisible() and more > SLACK:
        yield f"its text needs {more} px more than the {area.viewport().height()} px it has, and there is no scroll bar"
    elif bar.isVisible() and more < 1.5 * line:
        yield f"a scroll bar for {more} px, one line"
    needs = area.viewport().width() + across.maximum()
    if across.isVisible() and needs < SMALLEST:
        yield f"a horizontal scroll bar for lines of {needs} px"


def _behind(area: qt.QScrollArea) -> Iterator[str]:
    inner = area.widget()
    if inner is None:
        return
    for bar, needs, has, what in (
        (area.horizontalScrollBar(), inner.width(), area.viewport().width(), "wide"),
        (area.verticalScrollBar(), inner.height(), area.viewport().height(), "high"),
    ):
        if not bar.isVisible() and less(has, needs):
            yield f"what it holds is {needs} px {what}, {has} are seen, and there is no scroll bar"


# -- plots -------------------------------------------------------------------------------------------------


def _plots(view: QGraphicsView) -> Iterator[str]:
    """Yield the flaws of the axes and parts of the plots in a view."""
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
            yield f"axes {one.toPlainText().strip()!r} and {other.toPlainText().strip()!r} overlap"


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


def drawn_numbers(axis: pg.AxisItem) -> list[tuple[QRectF, str]]:
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
    numbers = drawn_numbers(axis)
    places = _places(axis, axis.size().height() if along else axis.size().width())
    if places > 2 * len(numbers) or (name and axis._tickLevels is None and not numbers):
        yield f"axis {name!r} shows {len(numbers)} numbers of {places} in its range {axis.range}"
    ends = sorted(((b.top(), b.bottom()) if along else (b.left(), b.right())) + (t,) for b, t in numbers)
    for (_, end, one), (start, _, other) in pairwise(ends):
        if start < end + BETWEEN:
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
