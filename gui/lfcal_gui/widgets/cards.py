"""Titled frames, scrolling columns, rows of widgets, and parts with a movable border."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QComboBox,
    QFrame,
    QHBoxLayout,
    QLabel,
    QLayout,
    QPushButton,
    QScrollArea,
    QSplitter,
    QStackedWidget,
    QVBoxLayout,
    QWidget,
)

from lfcal_gui.widgets.words import ElidedLabel, WrappedLabel, set_look, set_role

INSPECTOR = "inspector"
"""Property of the inspector to the right of the pictures of a page, which can be hidden."""

NARROW, WIDE, ROOMY = 304, 368, 1380
"""Two widths of an inspector, and smallest width of its panel for the wider one (px)."""

SPACING = 5
"""Space between the parts of a card (px)."""

Box = TypeVar("Box", QVBoxLayout, QHBoxLayout)


def inspector_width(room: int) -> int:
    """Return the width of the inspector in a panel that is ``room`` wide (px)."""
    return WIDE if room >= ROOMY else NARROW


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
    """Return a column of cards of a fixed width that scrolls in a low window; if ``dense``, its controls are lower."""
    inner = QWidget()
    inner.setProperty("dense", dense)
    column = QVBoxLayout(inner)
    column.setContentsMargins(0, 0, 6, 0)
    column.setSpacing(6)
    for one in cards:
        column.addWidget(one)
    column.addStretch()
    area = scrolling(inner)
    area.setProperty(INSPECTOR, True)
    area.setFixedWidth(width)
    return area


def scrolling(inner: QWidget) -> QScrollArea:
    """Return a widget in an area that scrolls vertically in a low window."""
    area = QScrollArea(widgetResizable=True)
    area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    area.setWidget(inner)
    return area


def choice_box(choices: Sequence[tuple[str, str]], tip: str = "", name: str = "") -> QComboBox:
    """Return a combo box of pairs of value (item data) and displayed text; ``name`` is its accessible name."""
    box = QComboBox()
    box.setAccessibleName(name)
    for value, text in choices:
        box.addItem(text, value)
    box.setToolTip(tip)
    return box


def button(text: str, tip: str, action: Callable[[], object] | None = None, role: str = "") -> QPushButton:
    """Return a button with the style of a role that calls ``action`` when it is clicked."""
    made = QPushButton(text)
    made.setToolTip(tip)
    if role:
        made.setProperty("role", role)
    if action is not None:
        made.clicked.connect(lambda _=False: action())
    return made


def segment(text: str, tip: str, action: Callable[[], object], *, on: bool = False) -> QPushButton:
    """Return a checkable button in the style of a segment; ``on`` states whether it is checked at first."""
    made = button(text, tip, action, "segment")
    made.setCheckable(True)
    made.setChecked(on)
    return made


def wrapped(role: str = "hint", text: str = "") -> QLabel:
    """Return a wrapped label with the style of a role."""
    return WrappedLabel(text, rich=True, role=role)


def told_or_shown(words: str, content: QWidget) -> tuple[QLabel, QStackedWidget]:
    """Return a label with ``words``, and a stack of the label and ``content`` that shows the label first."""
    message = wrapped("hint", words)
    message.setAlignment(Qt.AlignmentFlag.AlignCenter)
    stack = QStackedWidget()
    stack.addWidget(message)
    stack.addWidget(content)
    return message, stack


def column_of(
    *parts: QWidget | QLayout, of: QWidget | None = None, spacing: int = SPACING, stretch: int = -1
) -> QVBoxLayout:
    """Return a layout of parts below each other, without margins.

    Parameters
    ----------
    parts
        The parts, from the top.
    of
        The widget whose layout this becomes. None: none.
    spacing
        Space between the parts (px).
    stretch
        Index of the part that takes the remaining space; -1: none does.
    """
    return _filled(QVBoxLayout() if of is None else QVBoxLayout(of), parts, spacing, stretch)


def row_of(*parts: QWidget | QLayout, of: QWidget, spacing: int = SPACING, stretch: int = -1) -> QHBoxLayout:
    """Return a layout of parts side by side, without margins; see `column_of`."""
    return _filled(QHBoxLayout(of), parts, spacing, stretch)


def _filled(made: Box, parts: Sequence[QWidget | QLayout], spacing: int, stretch: int) -> Box:
    made.setContentsMargins(0, 0, 0, 0)
    made.setSpacing(spacing)
    for k, part in enumerate(parts):
        if isinstance(part, QLayout):
            made.addLayout(part, int(k == stretch))
        else:
            made.addWidget(part, int(k == stretch))
    return made


def line(*parts: QWidget | str, stretch: int = -1) -> QHBoxLayout:
    """Return a row of widgets and texts; the one with index ``stretch`` takes the remaining space."""
    row = QHBoxLayout()
    row.setSpacing(6)
    for k, part in enumerate(parts):
        widget = QLabel(part) if isinstance(part, str) else part
        row.addWidget(widget, int(k == stretch))
    if stretch < 0:
        row.addStretch()
    return row


def clear(area: QScrollArea) -> None:
    """Make a scroll area transparent, so that the card behind it is visible."""
    area.viewport().setAutoFillBackground(False)
    inner = area.widget()
    if inner is not None:
        inner.setAutoFillBackground(False)


class HeadedCard(QFrame):
    """A card with a head; its content is added to `column`."""

    def __init__(self, title: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "card")
        self.column = QVBoxLayout(self)
        self.column.setContentsMargins(10, 3, 4, 3)
        self.column.setSpacing(3)
        self.head = QHBoxLayout()
        self.title = ElidedLabel(title)
        self.title.setProperty("role", "heading")
        self.status = ElidedLabel()
        self.status.setProperty("role", "hint")
        self.head.addWidget(self.title)
        self.head.addWidget(self.status, 1)
        self.column.addLayout(self.head)

    def add_button(self, text: str, tip: str, action: Callable[[], object]) -> QPushButton:
        """Add a button to the end of the head."""
        made = button(text, tip, action)
        self.head.addWidget(made)
        return made

    def leave(self) -> None:
        """Remove the card."""
        self.setParent(None)
        self.deleteLater()


MUCH = 10_000


def split(*parts: QWidget | QLayout, sizes: Sequence[int], vertical: bool = False, fixed: int = 0) -> QSplitter:
    """Return ``parts`` side by side, or one above the other.

    Parameters
    ----------
    sizes
        Initial sizes of the parts, relative to each other.
    fixed
        Number of first parts whose sizes are pixels, and stay when the window grows.
    """
    made = QSplitter(Qt.Orientation.Vertical if vertical else Qt.Orientation.Horizontal)
    made.setChildrenCollapsible(False)
    made.setHandleWidth(8)
    for k, part in enumerate(parts):
        made.addWidget(_widget(part))
        made.setStretchFactor(k, 0 if k < fixed else sizes[k])
    # larger than any screen, so that Qt shrinks each part in proportion
    made.setSizes([size if k < fixed else size * MUCH // max(sizes) for k, size in enumerate(sizes)])
    return made


def _widget(part: QWidget | QLayout) -> QWidget:
    if isinstance(part, QWidget):
        return part
    holder = QWidget()
    part.setContentsMargins(0, 0, 0, 0)
    holder.setLayout(part)
    return holder


HEADS = {"good": "✓ Good", "fair": "▲ Fair", "bad": "▲ Bad", "unknown": "Not fully judged", "": "Not judged yet"}
"""Headline for each merit, with a mark that means the same as the colour."""


LONGEST = 200
"""Number of characters above which only the first sentence of a verdict is shown."""


class VerdictCard(QFrame):
    """A card with a verdict: mark, colour and sentence. The tooltip contains all of a long verdict."""

    why_asked = Signal()
    """The user asks for the reasons."""

    def __init__(self, why: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "verdict")
        self.head, self.sentence, self.why = ElidedLabel(), WrappedLabel(), QPushButton("Reasons")
        self.why.setProperty("role", "tight")
        self.why.setToolTip(why)
        self.why.clicked.connect(lambda: self.why_asked.emit())
        top = QHBoxLayout()
        top.addWidget(self.head, 1)
        top.addWidget(self.why)
        column = QVBoxLayout(self)
        column.setContentsMargins(12, 6, 8, 8)
        column.setSpacing(3)
        column.addLayout(top)
        column.addWidget(self.sentence)
        self.show_verdict("", "")

    def show_verdict(self, merit: str, sentence: str, head: str = "") -> None:
        """Show a verdict of merit ``"good"``, ``"fair"``, ``"bad"`` or ``"unknown"``; empty: there is none."""
        self.head.setText(head or HEADS[merit])
        first, end, _ = sentence.partition(". ")
        short = f"{first}{end.strip()}" if len(sentence) > LONGEST else sentence
        self.sentence.setText(short)
        self.sentence.setToolTip("" if short == sentence else sentence)
        self.sentence.setVisible(bool(sentence))
        set_role(self.head, merit if merit in ("good", "fair", "bad") else "hint")
        set_look(self, "merit", merit)
