"""What is wrong with how a window is laid out, found by looking at its widgets: cut text, parts that overlap."""

from __future__ import annotations

from collections.abc import Iterator

from PySide6.QtCore import QRect, Qt
from PySide6.QtGui import QFontMetrics, QTextDocument
from PySide6.QtWidgets import (
    QAbstractItemView,
    QAbstractScrollArea,
    QCheckBox,
    QComboBox,
    QGraphicsView,
    QLabel,
    QLineEdit,
    QMainWindow,
    QPlainTextEdit,
    QPushButton,
    QRadioButton,
    QSplitterHandle,
    QTabBar,
    QTableView,
    QTextEdit,
    QToolButton,
    QWidget,
)

from lfcal_gui.widgets.words import ElidedLabel
from tests.gui.layout_plots import of_plots
from tests.gui.layout_room import SLACK, less, squeezed

__all__ = ["flaws"]

NEARLY = 16
"""A scroll bar for less than this is one too many (px)."""

BUTTONS = (QPushButton, QCheckBox, QRadioButton, QToolButton)
OVERLAY = "overlay"
"""Property of a widget that lies over others on purpose."""


def flaws(root: QWidget) -> list[str]:
    """Return what is wrong below ``root``, a line each: which widget, and what of it."""
    found = []
    for widget in (root, *root.findChildren(QWidget)):
        if not _seen(widget):
            continue
        for words in _of(widget):
            found.append(f"{_path(widget)}: {words}")
    return found


def _seen(widget: QWidget) -> bool:
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


def _path(widget: QWidget) -> str:
    names = []
    at: QWidget | None = widget
    while at is not None and len(names) < 4:
        names.append(type(at).__name__)
        at = at.parentWidget()
    return " < ".join(names)


def _of(widget: QWidget) -> Iterator[str]:
    if isinstance(widget, QLabel):
        yield from _label(widget)
    elif isinstance(widget, BUTTONS):
        if widget.text() and less(widget.width(), widget.sizeHint().width()):
            yield f"{widget.text()!r} needs {widget.sizeHint().width()} px, has {widget.width()}"
    elif isinstance(widget, QComboBox):
        yield from _box(widget)
    elif isinstance(widget, QLineEdit):
        yield from _edit(widget)
    elif isinstance(widget, QTabBar):
        yield from _tabs(widget)
    elif isinstance(widget, QAbstractScrollArea):
        yield from _area(widget)
        yield from _nested(widget)
    yield from squeezed(widget)
    yield from _siblings(widget)


def _label(label: QLabel) -> Iterator[str]:
    text = label.text()
    if isinstance(label, ElidedLabel) and (label.toolTip() == text or "\n" in QLabel.text(label)):
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


def _box(box: QComboBox) -> Iterator[str]:
    needs = QFontMetrics(box.font()).horizontalAdvance(box.currentText())
    has = box.width() - 24  # the arrow
    if less(has, needs):
        yield f"chosen {box.currentText()!r} needs {needs} px, has {has}"


def _edit(edit: QLineEdit) -> Iterator[str]:
    text = edit.displayText() or edit.placeholderText()
    needs = QFontMetrics(edit.font()).horizontalAdvance(text)
    has = edit.width() - 12
    if "/" not in text and less(has, needs):
        yield f"text {text!r} needs {needs} px, has {has}"


def _tabs(bar: QTabBar) -> Iterator[str]:
    for k in range(bar.count()):
        if bar.isTabVisible(k) and bar.tabRect(k).right() > bar.width():
            yield f"tab {bar.tabText(k)!r} does not fit"


def _area(area: QAbstractScrollArea) -> Iterator[str]:
    if isinstance(area, QTableView):
        yield from _cells(area)
    for bar in (area.horizontalScrollBar(), area.verticalScrollBar()):
        lines = isinstance(area, QPlainTextEdit) and bar is area.verticalScrollBar()  # it counts lines, not pixels
        more = (bar.maximum() - bar.minimum()) * (area.fontMetrics().lineSpacing() if lines else 1)
        if bar.isVisible() and not isinstance(area, QAbstractItemView) and more < NEARLY:
            yield f"a scroll bar for {more} px"
    if isinstance(area, QAbstractItemView | QTextEdit) and area.horizontalScrollBar().isVisible():
        yield "a horizontal scroll bar"
    if isinstance(area, QGraphicsView):
        yield from of_plots(area)


def _cells(table: QTableView) -> Iterator[str]:
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


def _nested(area: QAbstractScrollArea) -> Iterator[str]:
    """Yield that an area scrolls inside another one that does: the wheel moves the one or the other."""
    above = area.parentWidget() if area.verticalScrollBar().isVisible() else None
    while above is not None:
        if isinstance(above, QAbstractScrollArea) and above.verticalScrollBar().isVisible():
            yield f"a scroll bar inside the scroll bar of {type(above).__name__}"
            return
        above = above.parentWidget()


def _siblings(parent: QWidget) -> Iterator[str]:
    """Parts of ``parent`` that overlap, or that reach out of it."""
    if isinstance(parent, QAbstractScrollArea | QComboBox | QMainWindow) or parent.layout() is None:
        return
    parts = [
        child
        for child in parent.children()
        if isinstance(child, QWidget)
        and child.isVisible()
        and not child.isWindow()
        and not child.property(OVERLAY)
        and not isinstance(child, QSplitterHandle)
    ]
    inside = parent.rect().adjusted(-SLACK, -SLACK, SLACK, SLACK)
    for k, one in enumerate(parts):
        if not inside.contains(one.geometry()):
            yield f"{type(one).__name__} {_said(one)} reaches out of it by {_out(parent.rect(), one.geometry())} px"
        for other in parts[:k]:
            both = one.geometry().intersected(other.geometry())
            if both.width() > SLACK and both.height() > SLACK:
                yield f"{type(one).__name__} {_said(one)} overlaps {type(other).__name__} {_said(other)}"


def _said(widget: QWidget) -> str:
    text = getattr(widget, "text", None)
    return repr(text()[:40]) if callable(text) else widget.accessibleName()


def _out(outer: QRect, inner: QRect) -> int:
    return max(
        outer.left() - inner.left(),
        inner.right() - outer.right(),
        outer.top() - inner.top(),
        inner.bottom() - outer.bottom(),
    )
