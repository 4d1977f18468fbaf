"""Pages of a window, and waiting for it: on conditions and signals, never for a time."""

from __future__ import annotations

from typing import Any

from pytestqt.qtbot import QtBot

from lfcal_gui.jobs import Jobs
from lfcal_gui.window import MainWindow

__all__ = ["GUARD_MS", "go", "idle", "page_of"]

GUARD_MS = 600_000
"""Ends a test that hangs; far more than a correct program takes on the slowest machine."""


def idle(jobs: Jobs, qtbot: QtBot) -> None:
    """Wait until nothing is computed."""
    qtbot.waitUntil(lambda: not jobs.busy, timeout=GUARD_MS)


def page_of(window: MainWindow, key: str) -> Any:
    """Return a page of the window."""
    return window.page(key)


def go(window: MainWindow, key: str, *place: Any) -> Any:
    """Show a page of the window, and return it."""
    window.go(key, *place)
    return window.page(key)
