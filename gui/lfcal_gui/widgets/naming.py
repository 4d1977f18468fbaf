"""Names for screen readers: controls without a name get one from their label or tooltip."""

from __future__ import annotations

import pyqtgraph as pg
from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QAbstractSpinBox,
    QComboBox,
    QLabel,
    QLineEdit,
    QPlainTextEdit,
    QScrollArea,
    QSlider,
    QTabBar,
    QWidget,
)

CONTROLS = (
    QAbstractButton,
    QAbstractItemView,
    QAbstractSpinBox,
    QComboBox,
    QLineEdit,
    QPlainTextEdit,
    QSlider,
    pg.GraphicsView,
)
"""Types of widgets that need a name for screen readers."""

LONGEST = 60


def unnamed(root: QWidget) -> list[QWidget]:
    """Return the controls in ``root`` that a screen reader cannot name."""
    return [widget for widget in controls(root) if not widget.accessibleName() and not _own_words(widget)]


def name_controls(root: QWidget) -> None:
    """Name the controls in ``root`` that have no name: by their label, else by the start of their tooltip.

    Pictures and plots are named after their axes. A scroll area that follows the focused control is skipped by the Tab
    key.
    """
    buddies = {label.buddy(): label.text() for label in root.findChildren(QLabel) if label.buddy() is not None}
    for widget in unnamed(root):
        words = buddies.get(widget, "") or _first(widget.toolTip()) or _first_of_parent(widget)
        words = words or (widget.placeholderText() if isinstance(widget, QLineEdit) else "")
        widget.setAccessibleName(words[:LONGEST])
    for bar in root.findChildren(QTabBar):
        bar.setAccessibleName(bar.accessibleName() or "tabs")
    for area in root.findChildren(QScrollArea):
        if controls(area):
            area.setFocusPolicy(Qt.FocusPolicy.NoFocus)


def controls(root: QWidget) -> list[QWidget]:
    """Return the controls in ``root``, without the internal parts of other controls."""
    found: list[QWidget] = []
    for kind in CONTROLS:
        found += root.findChildren(kind)
    # a screen reader reads their parts through them
    inner = (QAbstractSpinBox, QComboBox, QAbstractItemView, QTabBar)
    return [widget for widget in found if not _within(widget, inner) and not widget.objectName().startswith("qt_")]


def _within(widget: QWidget, kinds: tuple[type[QWidget], ...]) -> bool:
    parent = widget.parentWidget()
    while parent is not None:
        if isinstance(parent, kinds):
            return True
        parent = parent.parentWidget()
    return False


def _own_words(widget: QWidget) -> str:
    return widget.text() if isinstance(widget, QAbstractButton) else ""


def _first(tip: str) -> str:
    """Return the first clause of a tooltip."""
    for end in (". ", "; ", ": ", "\n"):
        tip = tip.partition(end)[0]
    return tip.strip(" .")


def _first_of_parent(widget: QWidget) -> str:
    parent = widget.parentWidget()
    return "" if parent is None else _first(parent.toolTip())
