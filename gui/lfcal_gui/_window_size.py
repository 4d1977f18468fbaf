"""How large a new window is."""

from __future__ import annotations

from PySide6.QtWidgets import QWidget

__all__ = ["SIZE", "fit_screen", "size_within"]

SIZE = (1280, 800)

LEAST = 1000
"""Width that all views fit into (px)."""

TITLE = 40
"""Height of the title bar that the system puts over the window, at the most (px)."""


def size_within(room: tuple[int, int]) -> tuple[int, int]:
    """Return the size of a new window on a screen with ``room`` for it; one narrower than `LEAST` holds none."""
    width, height = room
    return SIZE if width < LEAST else (min(SIZE[0], width), min(SIZE[1], height - TITLE))


def fit_screen(window: QWidget) -> None:
    """Give a window the usual size, less where its screen has no room for it under a title bar."""
    room = window.screen().availableGeometry()
    window.resize(*size_within((room.width(), room.height())))
