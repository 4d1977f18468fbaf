"""Whole sittings in the window, and how many clicks they take."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from benchmarks._window_clicks import SITTINGS, Hand
from lfcal_gui.jobs import JobState
from lfcal_gui.models.project import Project
from lfcal_gui.pages.frames.model import FrameSettings
from lfcal_gui.scenes.stage import Stage
from lfcal_gui.window import MainWindow
from tests.cli.conftest import true_frame
from tests.gui.recorded import write_recorded
from tests.gui.waiting import GUARD_MS, idle, page_of


def test_from_dropped_frames_to_a_saved_project(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    """Drop frames, correct them, assemble H, look at HT, export, save, open again."""
    window.take_files([str(write_recorded(tmp_path / "recorded"))])
    frames = page_of(window, "frames")
    assert window.shown is frames
    idle(window.jobs, qtbot)
    assert frames.opened is not None and frames.loaded is not None
    np.testing.assert_array_equal(frames.loaded.raw, true_frame(0, 0, 0) + 100)
    np.testing.assert_allclose(frames.loaded.fixed, true_frame(0, 0, 0), atol=0.5)
    columns = frames.panel.view.overlays[0].points[:, 1]
    qtbot.keyClick(frames, Qt.Key.Key_Right)
    idle(window.jobs, qtbot)
    assert frames.position == (0, 0, 1)
    moved = frames.panel.view.overlays[0].points[:, 1]
    assert (moved == columns + 1).all() and np.ptp(columns) > 0, "the cutout moves one pixel with the point"
    frames.panel.choices.editor("use_dark").setChecked(False)
    assert not FrameSettings.of(window.project.state).use_dark
    window.project.undo()
    assert frames.panel.choices.editor("use_dark").isChecked()
    idle(window.jobs, qtbot)
    target = tmp_path / "H.h5"
    with qtbot.waitSignal(window.jobs.finished, timeout=GUARD_MS) as end:
        frames.assemble(str(target))
    assert end.args[0].state is JobState.DONE, end.args[0].error
    assert window.project.state.psf == str(target)
    window.go("h", (1, 2, 3))
    psf = page_of(window, "h")
    idle(window.jobs, qtbot)
    np.testing.assert_allclose(psf.panel.main_view.values.max(), 20000, rtol=0.01)
    qtbot.keyClick(psf, Qt.Key.Key_T)
    assert psf.intent.transposed
    np.testing.assert_array_equal(psf.panel.main_view.values, psf.matrix.T[1, 2, 3])
    with qtbot.waitSignal(window.jobs.finished, timeout=GUARD_MS) as end:
        page_of(window, "reconstruct").exporting.start(str(tmp_path / "H.npy"))
    assert end.args[0].state is JobState.DONE and (tmp_path / "H.npy").exists()
    window.project.save(tmp_path / "s.lfcal")
    other = Project()
    other.open(tmp_path / "s.lfcal")
    assert other.state == window.project.state


# -- clicks: `python -m benchmarks window --only clicks` prints the same ---------------------------------------


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

QUICK = {"multiplexed"}


@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.long) for n in SITTINGS])
def test_a_sitting_takes_so_many_clicks(window: MainWindow, qapp: QApplication, tmp_path: Path, name: str) -> None:
    hand = Hand(Stage(qapp, window, tmp_path / "made"))
    SITTINGS[name](hand)
    assert (hand.sat.clicks, hand.sat.names, hand.sat.keys) == WANTED[name], hand.sat.did
    failed = [job.error for job in window.jobs.jobs() if job.state is JobState.FAILED]
    assert not failed


def test_every_sitting_is_counted() -> None:
    assert WANTED.keys() == SITTINGS.keys()
