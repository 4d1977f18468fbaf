"""The dialog shows what concerns a kind of file, and asks once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.psf import PSFMatrix, save
from lfcal_gui.jobs import JobState
from lfcal_gui.pages.psf import page as page_module
from lfcal_gui.pages.psf._export_dialog import ExportDialog
from lfcal_gui.pages.psf.export_model import ExportIntent
from lfcal_gui.window import MainWindow
from tests.gui.pages.psf.test_export_model import incomplete, matrix
from tests.gui.waiting import GUARD_MS, idle


def test_only_what_concerns_the_file_is_shown(qtbot: QtBot) -> None:
    dialog = ExportDialog(matrix(), ExportIntent())
    qtbot.addWidget(dialog)
    dialog.show()
    shown = {name for name, box in dialog.boxes.items() if box.isVisible()}
    assert shown == {"lens_centred", "moved", "rows_first", "include_transpose", "allow_missing", "compress"}
    assert "8.50" in dialog.notes.text() and dialog.notes_card.isVisible()
    assert "--" not in dialog.notes.text(), "the window has boxes where the command line has options"
    dialog.layout().activate()
    assert dialog.notes.height() >= dialog.notes.heightForWidth(dialog.notes.width()), "no word is cut"
    dialog.boxes["moved"].click()
    assert dialog.boxes["lens_centred"].isChecked() and not dialog.notes_card.isVisible()
    dialog.kind_box.setCurrentIndex(dialog.kind_box.findData(".tif"))
    assert {name for name, box in dialog.boxes.items() if box.isVisible()} == {"transposed", "here", "allow_missing"}
    asked: list[ExportIntent] = []
    dialog.asked.connect(asked.append)
    dialog.go.click()
    assert [intent.suffix for intent in asked] == [".tif"] and not dialog.isVisible()


def test_missing_positions_must_be_allowed(qtbot: QtBot) -> None:
    dialog = ExportDialog(incomplete(), ExportIntent())
    qtbot.addWidget(dialog)
    assert not dialog.go.isEnabled() and "1 of 18 positions is missing" in dialog.notes.text()
    dialog.boxes["allow_missing"].click()
    assert dialog.go.isEnabled() and "1 of 18 positions is missing" in dialog.notes.text()
    dialog.boxes["allow_missing"].click()
    dialog.kind_box.setCurrentIndex(dialog.kind_box.findData(".h5"))
    assert dialog.go.isEnabled() and "the file marks them" in dialog.notes.text()


def test_without_a_camera_no_lens_can_be_centred(qtbot: QtBot) -> None:
    dialog = ExportDialog(PSFMatrix(np.ones((1, 3, 3, 3, 3))), ExportIntent())
    qtbot.addWidget(dialog)
    assert not dialog.boxes["lens_centred"].isEnabled() and dialog.boxes["rows_first"].isEnabled()
    assert "not say where its lenses are" in dialog.notes.text()


def test_the_page_exports_what_was_asked_for(
    window: MainWindow, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    window.go("psf")
    page: Any = window.page("psf")
    page.export()
    assert "no H to export" in window.log_view.toPlainText()
    save(matrix(), tmp_path / "H.h5")
    window.project.update("open", psf=str(tmp_path / "H.h5"))
    idle(window.jobs, qtbot)
    page.export()
    dialog = page.findChild(ExportDialog)
    dialog.boxes["lens_centred"].click()
    monkeypatch.setattr(page_module, "ask_target", lambda *_: str(tmp_path / "H.mat"))
    with qtbot.waitSignal(window.jobs.finished, timeout=GUARD_MS) as end:
        dialog.go.click()
    assert end.args[0].state is JobState.DONE, end.args[0].error
    with h5py.File(tmp_path / "H.mat") as file:
        np.testing.assert_allclose(file["lensCentre"][()], [[8.5], [8.5]])


def test_a_choice_of_the_project_is_proposed_and_written(
    window: MainWindow, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    window.go("psf")
    page: Any = window.page("psf")
    save(matrix(), tmp_path / "H.h5")
    window.project.update("open", psf=str(tmp_path / "H.h5"))
    idle(window.jobs, qtbot)
    said = {"suffix": ".h5", "sixteen": True, "compress": False}
    window.project.update("export", settings={**window.project.state.settings, "psf": said})
    page.export()
    dialog = page._export_dialog
    assert dialog.boxes["sixteen"].isChecked() and not dialog.boxes["compress"].isChecked()
    out = tmp_path / "small.h5"
    monkeypatch.setattr(page_module, "ask_target", lambda *_: str(out))
    with qtbot.waitSignal(window.jobs.finished, timeout=GUARD_MS) as end:
        dialog.go.click()
    assert end.args[0].state is JobState.DONE, end.args[0].error
    with h5py.File(out) as file:
        assert file["step"][...].all() and file["H"].compression is None
    idle(window.jobs, qtbot)
