"""Titled frames, scrolling columns and rows of widgets."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QComboBox, QFrame, QHBoxLayout, QLabel, QScrollArea, QStackedWidget, QVBoxLayout, QWidget

__all__ = ["SPACING", "card", "choice_box", "clear", "column_area", "heading", "line", "scrolling", "told_or_shown"]

SPACING = 5
"""Between the parts of a card (px)."""


def heading(text: str) -> QLabel:
    """Return a heading."""
    label = QLabel(text)
    label.setProperty("role", "heading")
    return label


def card(title: str | QLabel = "") -> tuple[QFrame, QVBoxLayout]:
    """Return a framed panel and the column inside it."""
    frame = QFrame()
    frame.setProperty("role", "card")
    column = QVBoxLayout(frame)
    column.setContentsMargins(10, 5, 10, 7)
    column.setSpacing(SPACING)
    if isinstance(title, QLabel):
        title.setProperty("role", "heading")
        column.addWidget(title)
    elif title:
        column.addWidget(heading(title))
    return frame, column


def column_area(width: int, *cards: QWidget, dense: bool = False) -> QScrollArea:
    """Return a column of cards of a fixed width that scrolls when the window is low; ``dense``: of low controls."""
    inner = QWidget()
    inner.setProperty("dense", dense)
    column = QVBoxLayout(inner)
    column.setContentsMargins(0, 0, 6, 0)
    column.setSpacing(6)
    for one in cards:
        column.addWidget(one)
    column.addStretch()
    area = scrolling(inner)
    area.setFixedWidth(width)
    return area


def scrolling(inner: QWidget) -> QScrollArea:
    """Return a widget in an area that scrolls up and down where the window is low."""
    area = QScrollArea()
    area.setWidgetResizable(True)
    area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    area.setWidget(inner)
    return area


def choice_box(choices: Sequence[tuple[str, str]], tip: str = "") -> QComboBox:
    """Return a list to choose from: pairs of value (the data of an item) and shown text."""
    box = QComboBox()
    for value, text in choices:
        box.addItem(text, value)
    box.setToolTip(tip)
    return box


def told_or_shown(words: str, content: QWidget) -> tuple[QLabel, QStackedWidget]:
    """Return a label with ``words``, and the stack that shows it until there is something in ``content``."""
    message = QLabel(words)
    message.setAlignment(Qt.AlignmentFlag.AlignCenter)
    message.setWordWrap(True)
    message.setProperty("role", "hint")
    stack = QStackedWidget()
    stack.addWidget(message)
    stack.addWidget(content)
    return message, stack


def line(*parts: QWidget | str, stretch: int = -1) -> QHBoxLayout:
    """Return widgets and words side by side; the one numbered ``stretch`` takes the room that is left."""
    row = QHBoxLayout()
    row.setSpacing(6)
    for k, part in enumerate(parts):
        widget = QLabel(part) if isinstance(part, str) else part
        row.addWidget(widget, int(k == stretch))
    if stretch < 0:
        row.addStretch()
    return row


def clear(area: QScrollArea) -> None:
    """Let what lies behind a scroll area show through it, such as a card."""
    area.viewport().setAutoFillBackground(False)
    inner = area.widget()
    if inner is not None:
        inner.setAutoFillBackground(False)
