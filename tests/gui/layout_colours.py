"""Colours of another theme that a change of theme left: dark words on dark, or pale ones on white."""

from __future__ import annotations

import re
from collections.abc import Iterator

from PySide6.QtWidgets import QGraphicsView, QLabel, QTableWidget, QWidget

from lfcal_gui.theme import THEMES, Theme, current_theme

__all__ = ["of_other_themes"]

COLOUR = re.compile(r"#[0-9a-fA-F]{6}\b")


def _colours(theme: Theme) -> set[str]:
    return {value for value in vars(theme).values() if isinstance(value, str) and COLOUR.fullmatch(value)}


def of_other_themes(root: QWidget) -> Iterator[str]:
    """Yield which seen parts of ``root`` say something in a colour that only another theme has."""
    own = _colours(current_theme())
    others = set().union(*(_colours(theme) for theme in THEMES.values())) - own
    for widget in (root, *root.findChildren(QWidget)):
        if not widget.isVisible():
            continue
        text = widget.styleSheet()
        if isinstance(widget, QLabel):
            text += widget.text()
        elif isinstance(widget, QTableWidget):
            text += "".join(_cells(widget))
        elif isinstance(widget, QGraphicsView):
            text += widget.backgroundBrush().color().name()
        for colour in sorted(set(COLOUR.findall(text.lower())) & others):
            yield f"{type(widget).__name__} {text[-80:]!r} has {colour}, which is none of {current_theme().name}'s"


def _cells(table: QTableWidget) -> Iterator[str]:
    for row in range(table.rowCount()):
        for column in range(table.columnCount()):
            cell = table.item(row, column)
            if cell is not None and cell.foreground().style().value:
                yield cell.foreground().color().name()
