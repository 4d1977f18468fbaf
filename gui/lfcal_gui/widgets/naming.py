"""Accessible names, for screen readers: controls without a name get one from their label or tooltip."""

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
    found = (widget for widget in root.findChildren(QWidget) if isinstance(widget, CONTROLS))
    return [widget for widget in found if not (widget.accessibleName() or _own_words(widget)) and _whole(widget)]


def name_controls(root: QWidget) -> None:
    """Give an accessible name to each control in ``root`` that has none.

    The name is that of its label, or else the start of its tooltip or of its parent's tooltip, or its placeholder text.
    Pictures and plots name themselves; tab bars are named "tabs". Scroll areas that contain controls are removed from
    the Tab order, because they scroll to the focused control.
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
    return [widget for widget in root.findChildren(QWidget) if isinstance(widget, CONTROLS) and _whole(widget)]


def _whole(widget: QWidget) -> bool:
    """Return whether a control is not part of another one, through which a screen reader reads its parts."""
    whole, parent = not widget.objectName().startswith("qt_"), widget.parentWidget()
    while whole and parent is not None:
        whole = not isinstance(parent, (QAbstractSpinBox, QComboBox, QAbstractItemView, QTabBar))
        parent = parent.parentWidget()
    return whole


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
