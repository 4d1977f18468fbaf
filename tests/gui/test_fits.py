"""No scroll bar where the content fits: pages of the sample at the size of a whole screen."""

from __future__ import annotations

from typing import Any

import pytest
from PySide6.QtCore import QPoint, QRect
from PySide6.QtWidgets import (
    QAbstractItemView,
    QAbstractScrollArea,
    QApplication,
    QPlainTextEdit,
    QScrollArea,
    QTextEdit,
)
from pytestqt.qtbot import QtBot

from lfcal.camera import ScanPlan, preset
from lfcal.simulate import sample_recording
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.acquire.record_panel import RecordPanel
from lfcal_gui.theme import NIGHT
from lfcal_gui.window import MainWindow
from tests.cli.conftest import small_plan
from tests.gui.waiting import GUARD_MS, idle


def scrolled(page: Any) -> list[str]:
    """Return the areas of a page that scroll up and down."""
    areas = [area for area in page.findChildren(QScrollArea) if area.isVisible()]
    return [type(area.widget()).__name__ for area in areas if area.verticalScrollBar().maximum() > 0]


def settle() -> None:
    for _ in range(5):
        QApplication.processEvents()


@pytest.mark.parametrize(("width", "wide"), [(1280, 304), (1920, 368)])
def test_values_and_scan_are_whole_beside_the_picture(window: MainWindow, width: int, wide: int) -> None:
    plan = ScanPlan.for_camera(preset("bench"), depths_um=(-20034.587, -26017.775))
    window.files.start_with(ProjectState(camera=plan.camera, plan=plan))
    window.resize(width, 800)
    window.go("setup")
    settle()
    page: Any = window.page("setup")
    assert scrolled(page) == [] and page.panel.area.width() == wide
    inspector = page.panel.inspector
    for fold in (inspector.values, inspector.scan):
        fold.open()
    settle()
    assert inspector.minimumSizeHint().width() <= page.panel.area.viewport().width(), "nothing is cut at the right"
    for key in ("virtual_depths", "depths"):
        field = inspector.scan.editor(key)
        assert field.fontMetrics().horizontalAdvance(field.text()) + 20 < field.width()


def test_the_column_of_the_frames_is_whole(window: MainWindow, qtbot: QtBot) -> None:
    window.resize(1920, 1080)
    window.go("frames")
    page: Any = window.page("frames")
    assert page.accept_drop([str(sample_recording())])
    idle(window.jobs, qtbot)
    settle()
    assert page.loaded is not None and scrolled(page) == []


def test_the_unknowns_of_a_fit_are_whole(window: MainWindow, qtbot: QtBot) -> None:
    window.files.start_with(ProjectState())
    window.resize(1920, 1080)
    window.go("h", "fit")
    page: Any = window.page("h")
    page.show_body()
    choices = page.fitting.view.choices
    choices.unknowns.open()
    settle()
    choices.show_settings(page.fitting.settings, None, {})
    settle()
    groups: QAbstractScrollArea = choices.groups
    assert choices.width() > 300 and groups.verticalScrollBar().maximum() == 0


LISTS = (QAbstractItemView, QPlainTextEdit, QTextEdit)
"""Tables, lists and texts may be longer than any window."""


def within(widget: Any, kind: type) -> bool:
    while widget is not None and not isinstance(widget, kind):
        widget = widget.parentWidget()
    return widget is not None


def moving(page: Any) -> list[str]:
    """Return the areas of a page, no lists, in which something lies outside what is seen."""
    areas = [
        area for area in page.findChildren(QAbstractScrollArea) if area.isVisible() and not isinstance(area, LISTS)
    ]
    return [
        type(area).__name__
        for area in areas
        if area.verticalScrollBar().maximum() > 0 or area.horizontalScrollBar().maximum() > 0
    ]


@pytest.mark.parametrize(
    ("camera", "themes"),
    [
        ("bench", ("light", "night")),
        *(
            pytest.param(name, ("light", "dark", "night"), marks=pytest.mark.long, id=name)
            for name in ("bench", "lfm_60x12")
        ),
    ],
)
def test_no_page_scrolls_in_a_small_window(window: MainWindow, camera: str, themes: tuple[str, ...]) -> None:
    """Camera, Acquire, Frames and Reconstruct had scroll bars at 1280 x 800."""
    window.files.start_with(ProjectState(camera=preset(camera)))
    window.resize(1280, 800)
    found = {}
    for spec in window.specs:
        window.go(spec.key)
        page: Any = window.page(spec.key)
        page.show_body()
        for theme in themes:
            window.set_theme(theme)
            settle()
            found[spec.key, theme] = moving(page)
    assert len(found) == len(themes) * len(window.specs)
    assert {key: areas for key, areas in found.items() if areas} == {}


def test_the_routes_of_multiplexing_leave_room_for_pictures(window: MainWindow, qtbot: QtBot) -> None:
    window.files.start_with(ProjectState(camera=preset("bench")))
    window.resize(1280, 800)
    window.go("multiplex")
    page: Any = window.page("multiplex")
    page.panel.tabs.setCurrentIndex(1)
    page.show_body()
    idle(window.jobs, qtbot)
    settle()
    assert moving(page) == [] and page.panel.pictures.isVisible() and window.width() == 1280
    assert min(view.height() for view in page.panel.pictures.views) > 200


def test_the_settings_of_a_recording_are_whole(window: MainWindow) -> None:
    """They scrolled by up to 172 px."""
    window.files.start_with(ProjectState(camera=preset("bench")))
    window.resize(1280, 800)
    window.go("acquire")
    page: Any = window.page("acquire")
    page.show_body()
    page.panel.session.click()
    for theme in ("light", "dark", "night"):
        window.set_theme(theme)
        settle()
        assert page.findChild(RecordPanel).isVisible() and moving(page) == []


@pytest.mark.long
def test_the_target_is_whole(window: MainWindow, qtbot: QtBot) -> None:
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0, 4.0))
    window.files.start_with(ProjectState(camera=plan.camera, plan=plan))
    window.go("setup")
    page: Any = window.page("setup")
    page.panel.inspector.buttons["target"].click()
    dialog = page.target
    type_in = dialog.panel.form.editor("source")
    type_in.setText("array")
    type_in.textEdited.emit("array")
    dialog.plan_target()
    idle(window.jobs, qtbot)
    settle()
    assert dialog.panel.found is not None and moving(dialog) == []
    for shown in (dialog.panel.graphics, dialog.panel.map, dialog.panel.save_button):
        assert whole(shown, dialog)


def test_nothing_scrolls_beside_the_live_view(window: MainWindow, qtbot: QtBot) -> None:
    """Words that are known once it is connected pushed the last card out of a small window."""
    plan = small_plan()
    window.files.start_with(ProjectState(camera=plan.camera, plan=plan))
    window.resize(1280, 800)
    window.go("acquire")
    page: Any = window.page("acquire")
    page.show_body()
    qtbot.waitUntil(lambda: page.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    page.setup.connect_devices()
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)
    for theme in ("light", "dark", "night"):
        window.set_theme(theme)
        settle()
        assert " mm to " in page.panel.setup.stage.fields[0].toolTip() and moving(page) == []


@pytest.mark.long
def test_no_scroll_bar_beside_the_sample(window: MainWindow, qtbot: QtBot) -> None:
    window.resize(1280, 800)
    window.go("frames")
    page: Any = window.page("frames")
    assert page.accept_drop([str(sample_recording())])
    idle(window.jobs, qtbot)
    settle()
    assert page.loaded is not None and moving(page) == []
    assert page.panel.view.height() > 400
    for shown in (page.panel.contrast, page.panel.numbers):
        assert whole(shown, page), "was cut off below"


def whole(widget: Any, page: Any) -> bool:
    """Return whether a widget lies inside of all that it is part of."""
    around = widget.parentWidget()
    while around is not page and around.rect().contains(QRect(widget.mapTo(around, QPoint(0, 0)), widget.size())):
        around = around.parentWidget()
    return around is page


@pytest.mark.long
def test_numbers_of_a_frame_have_the_colour_of_the_theme(window: MainWindow, qtbot: QtBot) -> None:
    """They kept that of the theme in which the frame was opened."""
    window.set_theme("night")
    window.go("frames")
    page: Any = window.page("frames")
    assert page.accept_drop([str(sample_recording())])
    idle(window.jobs, qtbot)
    assert NIGHT.text in page.panel.numbers.text()
    window.set_theme("light")
    assert NIGHT.text not in page.panel.numbers.text()
