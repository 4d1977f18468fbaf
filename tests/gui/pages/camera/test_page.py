from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from gui.window import MainWindow
from lfcal.camera import PRESETS, Camera, MainLens, preset
from tests.gui.waiting import idle


@pytest.mark.parametrize("name", PRESETS)
def test_camera_shows_and_takes_presets(window: MainWindow, name: str) -> None:
    page: Any = window.page("camera")
    page.presets.setCurrentIndex(page.presets.findData(name))
    page.presets.activated.emit(page.presets.currentIndex())
    assert window.project.state.camera == preset(name)
    lens = isinstance(preset(name).optics, MainLens)
    assert page.panel.forms["MainLens"].isVisibleTo(page) == lens
    assert page.panel.forms["lattice"].editor("lattice.pitch_um").text() == f"{preset(name).lattice.pitch_um:.10g}"
    assert "px" in page.panel.facts.text()
    assert not page.panel.view.grab().isNull()


def test_camera_files(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    page: Any = window.page("camera")
    page.save_file(str(tmp_path / "c.json"))
    assert Camera.from_json((tmp_path / "c.json").read_text()) == window.project.state.camera
    (tmp_path / "bad.json").write_text("{}")
    before = window.project.state
    page.import_file(str(tmp_path / "bad.json"))
    idle(window.jobs, qtbot)
    assert "camera description" in page.notice.label.text() and page.notice.isVisibleTo(page)
    assert window.project.state == before and "camera description" in window.log_view.toPlainText()
