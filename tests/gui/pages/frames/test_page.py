from __future__ import annotations

from typing import Any

from PySide6.QtWidgets import QComboBox, QLineEdit
from pytestqt.qtbot import QtBot

from gui.context import Context
from gui.pages.frames.model import FrameSettings
from lfcal.cli.sample import sample_recording
from tests.gui.waiting import GUARD_MS


def test_a_recorded_session_opens_by_dropping_it(qtbot: QtBot, context: Context, open_page: Any) -> None:
    page = open_page("frames")
    assert page.accept_drop([str(sample_recording())])
    qtbot.waitUntil(lambda: page.loaded is not None, timeout=GUARD_MS)
    assert context.state.plan is not None and context.state.plan.shape[:3] == (1, 19, 33)
    assert context.state.camera == context.state.plan.camera
    assert "627 frames of 55 × 55 px" in page.hint.text()
    assert "saturated pixels: <b>0</b>" in page.panel.numbers.text()
    page.panel.lattice_box.setChecked(True)
    points = sum(len(item.getData()[0]) for item in page.panel.view.lattice)
    assert points > 4, "lenslets of the place the cutout was taken from"


def test_what_the_settings_say_is_what_the_widgets_show(qtbot: QtBot, context: Context, open_page: Any) -> None:
    page = open_page("frames")
    pattern: QLineEdit = page.panel.pattern
    box: QComboBox = page.panel.interpolation
    pattern.setText("z{z}_y{y}_x{x}.tif")
    pattern.editingFinished.emit()
    box.setCurrentIndex(box.findData("linear"))
    settings = FrameSettings.of(context.state)
    assert (settings.pattern, settings.interpolation) == ("z{z}_y{y}_x{x}.tif", "linear")
    context.project.undo()
    context.project.undo()
    assert pattern.text() == "" and box.currentData() == ""
