"""What has less room than its content needs, as a neighbour took it: lines of words, rows, controls."""

from __future__ import annotations

from collections.abc import Iterator

from PySide6.QtCore import QModelIndex
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QAbstractSpinBox,
    QComboBox,
    QHeaderView,
    QLabel,
    QLineEdit,
    QListView,
    QPlainTextEdit,
    QProgressBar,
    QScrollArea,
    QSlider,
    QTabBar,
    QTableView,
    QTextEdit,
    QTreeView,
    QWidget,
)

__all__ = ["SLACK", "less", "squeezed"]

SLACK = 2
"""Pixels that are no flaw."""

SMALLEST = 1200
"""Width that the smallest window has for a dialog (px)."""

CONTROLS = (QAbstractButton, QComboBox, QLineEdit, QAbstractSpinBox, QSlider, QProgressBar, QTabBar)


def less(has: float, needs: float) -> bool:
    """Return whether there is less room than is needed (px)."""
    return has + SLACK < needs


def squeezed(widget: QWidget) -> Iterator[str]:
    """Yield what of a widget is cut at its lower or right edge, where no scroll bar reaches the rest."""
    if isinstance(widget, QLabel):
        yield from _lines(widget)
    elif isinstance(widget, CONTROLS):
        needs = min(widget.minimumHeight() or widget.minimumSizeHint().height(), widget.maximumHeight())
        if not isinstance(widget.parentWidget(), QAbstractSpinBox | QComboBox | QLineEdit) and less(
            widget.height(), needs
        ):
            yield f"needs a height of {needs} px, has {widget.height()}"
    elif isinstance(widget, QHeaderView):
        pass  # its table is looked at
    elif isinstance(widget, QAbstractItemView):
        yield from _rows(widget)
    elif isinstance(widget, QTextEdit | QPlainTextEdit):
        yield from _page(widget)
    elif isinstance(widget, QScrollArea):
        yield from _behind(widget)


def _lines(label: QLabel) -> Iterator[str]:
    """Words in lines of their own, or a table of words: their last line."""
    picture = label.pixmap()
    if label.wordWrap() or not (label.text().strip() or not picture.isNull()):
        return  # what wraps is looked at with its width
    needs = label.sizeHint().height()
    if less(label.height(), needs):
        yield f"{label.text()[:60]!r} needs a height of {needs} px, has {label.height()}"


def rows_px(view: QAbstractItemView) -> tuple[int, int]:
    """Return the height of all rows, and of the last of them (px)."""
    if isinstance(view, QTableView):
        rows = view.verticalHeader()
        count = rows.count()
        return rows.length(), rows.sectionSize(count - 1) if count else 0
    if not isinstance(view, QListView | QTreeView) or view.model() is None:
        return 0, 0
    last = _last(view)
    box = view.visualRect(last)
    return box.bottom() + 1 + view.verticalOffset(), box.height()


def _last(view: QAbstractItemView) -> QModelIndex:
    model, root = view.model(), view.rootIndex()
    last = model.index(model.rowCount(root) - 1, 0, root)
    while isinstance(view, QTreeView) and view.isExpanded(last) and model.rowCount(last):
        last = model.index(model.rowCount(last) - 1, 0, last)
    return last


def _rows(view: QAbstractItemView) -> Iterator[str]:
    needs, last = rows_px(view)
    has = view.viewport().height()
    if view.verticalScrollBar().isVisible():
        if needs - has < last:
            yield f"a scroll bar for {needs - has} px, less than a row"
    elif less(has, needs):
        yield f"its rows need {needs} px, it has {has} and no scroll bar"


def _page(area: QTextEdit | QPlainTextEdit) -> Iterator[str]:
    bar, across, line = area.verticalScrollBar(), area.horizontalScrollBar(), area.fontMetrics().lineSpacing()
    more = (bar.maximum() - bar.minimum()) * (line if isinstance(area, QPlainTextEdit) else 1)
    if not bar.isVisible() and more > SLACK:
        yield f"its text needs {more} px more than the {area.viewport().height()} px it has, and there is no scroll bar"
    elif bar.isVisible() and more < 1.5 * line:
        yield f"a scroll bar for {more} px, one line"
    needs = area.viewport().width() + across.maximum()
    if across.isVisible() and needs < SMALLEST:
        yield f"a horizontal scroll bar for lines of {needs} px"


def _behind(area: QScrollArea) -> Iterator[str]:
    inner = area.widget()
    if inner is None:
        return
    for bar, needs, has, what in (
        (area.horizontalScrollBar(), inner.width(), area.viewport().width(), "wide"),
        (area.verticalScrollBar(), inner.height(), area.viewport().height(), "high"),
    ):
        if not bar.isVisible() and less(has, needs):
            yield f"what it holds is {needs} px {what}, {has} are seen, and there is no scroll bar"
