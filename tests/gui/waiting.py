"""Waiting for the window: on conditions and signals, never for a time."""

from __future__ import annotations

from pytestqt.qtbot import QtBot

from lfcal_gui.jobs import Jobs

__all__ = ["GUARD_MS", "idle"]

GUARD_MS = 600_000
"""Ends a test that hangs; far more than a correct program takes on the slowest machine."""


def idle(jobs: Jobs, qtbot: QtBot) -> None:
    """Wait until nothing is computed."""
    qtbot.waitUntil(lambda: not jobs.busy, timeout=GUARD_MS)
