"""No scroll bar where the content fits: pages of the sample at the size of a whole screen."""

from __future__ import annotations

from typing import Any

import pytest
from PySide6.QtWidgets import QAbstractScrollArea, QApplication, QScrollArea
from pytestqt.qtbot import QtBot

from gui.models.project import ProjectState
from gui.window import MainWindow
from lfcal.cli.sample import sample_recording
from tests.gui.waiting import idle


def scrolled(page: Any) -> list[str]:
    """Return the areas of a page that scroll up and down."""
    areas = [area for area in page.findChildren(QScrollArea) if area.isVisible()]
    return [type(area.widget()).__name__ for area in areas if area.verticalScrollBar().maximum() > 0]


def settle() -> None:
    for _ in range(5):
        QApplication.processEvents()


@pytest.mark.parametrize("height", [1040, 1080])
def test_the_forms_of_the_camera_are_whole(window: MainWindow, height: int) -> None:
    window.resize(1920, height)
    window.go("camera")
    settle()
    page: Any = window.page("camera")
    assert scrolled(page) == []
    below = page.panel.split.sizes()[1]
    assert below > 300, "and what follows has room"
    window.resize(1280, 800)
    settle()
    assert page.panel.split.sizes()[1] >= 240


def test_the_splitter_stays_where_the_user_put_it(window: MainWindow) -> None:
    window.go("camera")
    page: Any = window.page("camera")
    page.panel.split.setSizes([200, 500])
    page.panel.split.splitterMoved.emit(200, 1)
    before = page.panel.split.sizes()
    window.resize(window.width(), window.height() + 40)
    settle()
    assert page.panel.split.sizes()[0] < before[0] + 41


def test_the_column_of_the_frames_is_whole(window: MainWindow, qtbot: QtBot) -> None:
    window.resize(1920, 1080)
    window.go("frames")
    page: Any = window.page("frames")
    assert page.accept_drop([str(sample_recording())])
    idle(window.jobs, qtbot)
    window.job_dock.hide()
    settle()
    assert page.loaded is not None and scrolled(page) == []


def test_the_unknowns_of_a_fit_are_whole(window: MainWindow, qtbot: QtBot) -> None:
    window.files.start_with(ProjectState())
    window.resize(1920, 1080)
    window.go("fit")
    page: Any = window.page("fit")
    page.show_body()
    settle()
    page.panel.choices.show_settings(page.settings, None, {})
    settle()
    groups: QAbstractScrollArea = page.panel.choices.groups
    assert page.panel.choices.width() > 300 and groups.verticalScrollBar().maximum() == 0
