"""Sittings that are clicked through the window; `python -m benchmarks window --only clicks` prints the same."""

from __future__ import annotations

from pathlib import Path

import pytest
from PySide6.QtWidgets import QApplication

from benchmarks._window_clicks import SITTINGS, Hand
from lfcal_gui.jobs import JobState
from lfcal_gui.scenes.stage import Stage
from lfcal_gui.window import MainWindow

WANTED = {
    "sample": (1, 0, 0),
    "sample_export": (2, 0, 0),
    "raytrix": (4, 1, 0),
    "folder": (2, 1, 0),
    "dropped": (1, 0, 0),
    "computed": (3, 0, 0),
    "fitted": (2, 0, 0),
    "reconstructed": (3, 1, 0),
    "multiplexed": (0, 0, 1),
    "repaired": (1, 0, 0),
    "left_out": (1, 0, 0),
}
"""Clicks, names and other keys of each sitting."""

QUICK = {"dropped", "computed", "multiplexed"}


@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.long) for n in SITTINGS])
def test_a_sitting_takes_so_many_clicks(window: MainWindow, qapp: QApplication, tmp_path: Path, name: str) -> None:
    hand = Hand(Stage(qapp, window, tmp_path / "made"))
    SITTINGS[name](hand)
    assert (hand.sat.clicks, hand.sat.names, hand.sat.keys) == WANTED[name], hand.sat.did
    failed = [job.error for job in window.jobs.jobs() if job.state is JobState.FAILED]
    assert not failed


def test_every_sitting_is_counted() -> None:
    assert WANTED.keys() == SITTINGS.keys()
