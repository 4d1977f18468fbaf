"""Parts of a page whose border the user moves."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QLayout, QSplitter, QWidget

__all__ = ["split"]

MUCH = 10_000


def split(*parts: QWidget | QLayout, sizes: Sequence[int], vertical: bool = False, fixed: int = 0) -> QSplitter:
    """Return ``parts`` beside each other, or one above the other.

    Parameters
    ----------
    sizes
        Of the parts at first, as shares of what there is.
    fixed
        So many of the first parts have their size in pixels, and keep it when the window grows.
    """
    made = QSplitter(Qt.Orientation.Vertical if vertical else Qt.Orientation.Horizontal)
    made.setChildrenCollapsible(False)
    made.setHandleWidth(8)
    made.setStyleSheet("QSplitter::handle { background: transparent; }")  # the cards' frames show where it is
    for k, part in enumerate(parts):
        made.addWidget(_widget(part))
        made.setStretchFactor(k, 0 if k < fixed else sizes[k])
    # more than any screen has: what is too much is taken from each by its share
    made.setSizes([size if k < fixed else size * MUCH // max(sizes) for k, size in enumerate(sizes)])
    return made


def _widget(part: QWidget | QLayout) -> QWidget:
    if isinstance(part, QWidget):
        return part
    holder = QWidget()
    part.setContentsMargins(0, 0, 0, 0)
    holder.setLayout(part)
    return holder
