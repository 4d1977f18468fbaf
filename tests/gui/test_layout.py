"""The layout of the window: no text is cut, nothing overlaps, and nothing scrolls that fits."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyqtgraph as pg
import pytest
from PySide6 import QtWidgets as qt
from PySide6.QtCore import QPoint, QRect, Qt
from PySide6.QtGui import QColor
from pytestqt.qtbot import QtBot

from lfcal.camera import ScanPlan, preset
from lfcal.simulate import sample_recording
from lfcal_gui.models.page import PAGES
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.acquire.record_panel import RecordPanel
from lfcal_gui.scenes.all import SCENES
from lfcal_gui.scenes.stage import Capture, Scene, Stage
from lfcal_gui.theme import DARK, LIGHT, NIGHT, apply_theme
from lfcal_gui.widgets._axes import Axis, Plot
from lfcal_gui.widgets.words import WrappedLabel
from lfcal_gui.window import MainWindow
from tests.cli.conftest import small_plan
from tests.gui.layout import flaws
from tests.gui.layout_colours import of_other_themes
from tests.gui.waiting import GUARD_MS, go, idle, page_of

LEAST, SMALL, LARGE = (1000, 600), (1280, 800), (1920, 1080)


@pytest.fixture
def stage(qapp: qt.QApplication, window: MainWindow, tmp_path: Path) -> Stage:
    window.resize(*SMALL)
    return Stage(qapp, window, tmp_path / "made")


def looked_at(stage: Stage, scene: Scene, *sizes: tuple[int, int]) -> Iterator[str]:
    """Play a scene and yield what is wrong with each of its states."""
    for shot in scene(stage):
        before = {shot.name: flaws(stage.seen(shot))}
        for size in sizes:
            stage.resize(*size)
            stage.turn(20)
            found = flaws(stage.seen(shot))
            now = (stage.window.width(), stage.window.height())
            if now != size:
                found.append(f"the window is {now[0]} x {now[1]}")
            before[f"{shot.name} at {size[0]} x {size[1]}"] = found
        before.update(() if shot.theme else looked_at_in_the_dark(stage, shot))
        yield from (f"{state}: {one}" for state, wrong in before.items() for one in wrong)


def looked_at_in_the_dark(stage: Stage, shot: Capture) -> Iterator[tuple[str, list[str]]]:
    """Yield the parts that keep colours of another theme when the theme changes."""
    for theme in ("dark", "light"):
        stage.window.set_theme(theme)
        stage.until(stage.window.updatesEnabled, "the theme")
        stage.turn()
        yield f"{shot.name}, {theme}", list(of_other_themes(stage.seen(shot)))


def test_every_page_has_room_in_the_smallest_window(stage: Stage) -> None:
    """A longer name of a button made the window 17 px wider than that."""
    window = stage.window
    assert [spec.key for spec in window.specs] == list(PAGES.names())
    for spec in window.specs:
        window.go(spec.key)
        stage.turn()
        page = page_of(window, spec.key)
        assert window.shown is page and window.minimumSizeHint().width() <= LEAST[0], spec.key
        least = page.body.minimumSizeHint()
        assert least.width() <= SMALL[0] - 85 and least.height() <= 640, (spec.key, least)


def test_a_large_window_with_the_log_becomes_the_smallest_at_once(stage: Stage) -> None:
    window, plan = stage.window, ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0])
    window.log_dock.show()
    window.project.update("a plan", camera=plan.camera, plan=plan)
    stage.resize(*LARGE)
    window.go("acquire")  # only a page in view follows the size
    stage.settle()
    stage.resize(*LEAST)
    stage.turn()
    assert (window.width(), window.height()) == LEAST


@pytest.mark.long
@pytest.mark.parametrize("name", SCENES)
def test_every_state_at_all_sizes(name: str, stage: Stage) -> None:
    wrong = list(looked_at(stage, SCENES[name], LEAST, SMALL, LARGE))
    assert not wrong, "\n".join(wrong)


# -- nothing scrolls that fits -----------------------------------------------------------------------------


def settle() -> None:
    for _ in range(5):
        qt.QApplication.processEvents()


LISTS = (qt.QAbstractItemView, qt.QPlainTextEdit, qt.QTextEdit)
"""Tables, lists and texts may be longer than any window."""


def moving(page: Any, *, across: bool = True) -> list[str]:
    """Return the areas of a page, except lists, in which something lies outside the visible part."""
    areas = [one for one in page.findChildren(qt.QAbstractScrollArea) if one.isVisible() and not isinstance(one, LISTS)]
    bars = {one: (one.verticalScrollBar(), *((one.horizontalScrollBar(),) if across else ())) for one in areas}
    return [type(one).__name__ for one in areas if any(bar.maximum() > 0 for bar in bars[one])]


def whole(widget: Any, page: Any) -> bool:
    """Return whether a widget lies inside of all that it is part of."""
    around = widget.parentWidget()
    while around is not page and around.rect().contains(QRect(widget.mapTo(around, QPoint(0, 0)), widget.size())):
        around = around.parentWidget()
    return around is page


def test_values_scan_and_unknowns_are_whole_beside_the_picture(window: MainWindow) -> None:
    plan = ScanPlan.for_camera(preset("bench"), depths_um=(-20034.587, -26017.775))
    window.files.start_with(ProjectState(camera=plan.camera, plan=plan))
    page = page_of(window, "setup")
    inspector = page.panel.inspector
    for width, wide in ((1280, 304), (1920, 368)):
        window.resize(width, 800)
        window.go("setup")
        for fold in (inspector.values, inspector.scan):
            fold.head.setChecked(False)
        settle()
        assert moving(page, across=False) == [] and page.panel.area.width() == wide
        for fold in (inspector.values, inspector.scan):
            fold.open()
        settle()
        assert inspector.minimumSizeHint().width() <= page.panel.area.viewport().width(), "nothing is cut at the right"
        for key in ("virtual_depths", "depths"):
            field = inspector.scan.editor(key)
            assert field.fontMetrics().horizontalAdvance(field.text()) + 20 < field.width()
    window.resize(*LARGE)
    h = go(window, "h", "fit")
    h.show_body()
    choices = h.fitting.view.choices
    choices.unknowns.open()
    settle()
    choices.show_settings(h.fitting.settings, None, {})
    settle()
    groups: qt.QAbstractScrollArea = choices.groups
    assert choices.width() > 300 and groups.verticalScrollBar().maximum() == 0


def test_the_frames_of_the_sample_are_whole(window: MainWindow, qtbot: QtBot) -> None:
    window.resize(*SMALL)
    window.set_theme("night")
    page = go(window, "frames")
    assert page.accept_drop([str(sample_recording())])
    idle(window.jobs, qtbot)
    settle()
    assert page.loaded is not None and moving(page) == [] and page.panel.view.height() > 400
    for shown in (page.panel.contrast, page.panel.numbers):
        assert whole(shown, page), "it was cut off at its lower edge"
    assert NIGHT.text in page.panel.numbers.text()
    window.set_theme("light")
    idle(window.jobs, qtbot)
    assert NIGHT.text not in page.panel.numbers.text(), "numbers kept the colour of the theme before"
    window.resize(*LARGE)
    settle()
    assert moving(page) == []


@pytest.mark.parametrize("camera", ["bench", pytest.param("lfm_60x12", marks=pytest.mark.long)])
def test_no_page_scrolls_in_a_small_window(
    window: MainWindow, qtbot: QtBot, pytestconfig: pytest.Config, camera: str
) -> None:
    """Camera, Acquire, Frames and Reconstruct had scroll bars at 1280 x 800."""
    window.files.start_with(ProjectState(camera=preset(camera)))
    window.resize(*SMALL)
    themes = ("light", "dark", "night") if pytestconfig.getoption("--long") else ("light", "night")
    for spec in window.specs:
        page = go(window, spec.key)
        page.show_body()
        for theme in themes:
            window.set_theme(theme)
            settle()
            assert moving(page) == [], (spec.key, theme)
    multiplex = go(window, "multiplex")
    multiplex.panel.tabs.setCurrentIndex(1)
    idle(window.jobs, qtbot)
    settle()
    assert moving(multiplex) == [] and multiplex.panel.pictures.isVisible() and window.width() == SMALL[0]
    assert min(view.height() for view in multiplex.panel.pictures.views) > 200
    acquire = go(window, "acquire")
    acquire.panel.session.click()
    for theme in themes:
        window.set_theme(theme)
        settle()
        assert acquire.findChild(RecordPanel).isVisible() and moving(acquire) == [], "settings of a recording"


@pytest.mark.long
def test_the_target_is_whole(window: MainWindow, qtbot: QtBot) -> None:
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0, 4.0))
    window.files.start_with(ProjectState(camera=plan.camera, plan=plan))
    page = go(window, "setup")
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
    """The texts after connecting pushed the last card out of a small window."""
    plan = small_plan()
    window.files.start_with(ProjectState(camera=plan.camera, plan=plan))
    window.resize(1280, 800)
    page = go(window, "acquire")
    page.show_body()
    qtbot.waitUntil(lambda: page.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    page.setup.connect_devices()
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)
    for theme in ("light", "dark", "night"):
        window.set_theme(theme)
        settle()
        assert " mm to " in page.panel.setup.stage.fields[0].toolTip() and moving(page) == []


# -- flaws are found ---------------------------------------------------------------------------------------


def finds(root: qt.QWidget, *parts: str) -> bool:
    """Return whether each part is in a flaw of a widget."""
    qt.QApplication.processEvents()
    found = flaws(root)
    return all(any(part in one for one in found) for part in parts)


def shown(qtbot: QtBot, root: qt.QWidget, width: int, height: int, *parts: qt.QWidget, across: bool = False) -> None:
    """Show a widget without flaws, and the parts in it."""
    qtbot.addWidget(root)
    if parts:
        layout = qt.QHBoxLayout(root) if across else qt.QVBoxLayout(root)
        for part in parts:
            layout.addWidget(part)
    root.show()
    root.resize(width, height)
    qt.QApplication.processEvents()
    assert not flaws(root)


def test_labels_that_are_cut_or_overlap_are_found(qtbot: QtBot) -> None:
    root, first, second = qt.QWidget(), qt.QLabel("words that have less room than they need"), qt.QLabel("other words")
    shown(qtbot, root, 600, 60, first, second, across=True)
    first.setFixedWidth(60)
    assert finds(root, "has 60")
    first.setFixedWidth(280)
    qt.QApplication.processEvents()
    second.move(first.x() + 20, second.y())
    assert any("overlaps" in one for one in flaws(root))
    second.move(590, second.y())
    assert any("reaches out" in one for one in flaws(root))


def test_a_table_of_words_that_a_label_below_it_squeezes_is_found(qtbot: QtBot) -> None:
    root, numbers, note = qt.QWidget(), qt.QLabel(), WrappedLabel("Does not pay.")
    rows = "".join(f"<tr><td>row {k}</td><td><b>{k}</b></td></tr>" for k in range(10))
    numbers.setText(f"<table cellspacing='3'>{rows}</table>")
    shown(qtbot, root, 240, 40, qt.QLineEdit(), numbers, note, qt.QPushButton("Save …"), qt.QWidget())
    note.setText(
        "Showing eleven frames together, coded: does not pay at 16000 electrons in the brightest pixel of a point"
    )
    root.setFixedHeight(root.height())
    qt.QApplication.processEvents()
    found = flaws(root)
    assert any("row 0" in one and "needs a height" in one for one in found), found
    note.setText("Does not pay.")
    qt.QApplication.processEvents()
    assert not flaws(root)


def test_controls_that_are_lower_than_their_words_are_found(qtbot: QtBot) -> None:
    root, edit = qt.QWidget(), qt.QLineEdit("5")
    shown(qtbot, root, 200, 90, edit, qt.QSpinBox())
    edit.resize(edit.width(), 14)
    assert any("needs a height" in one and "has 14" in one for one in flaws(root))


def test_rows_that_no_scroll_bar_reaches_are_found(qtbot: QtBot) -> None:
    root, table, names = qt.QWidget(), qt.QTableWidget(6, 1), qt.QListWidget()
    names.addItems([f"name {k}" for k in range(12)])
    for view in (table, names):
        view.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    shown(qtbot, root, 400, 400, table, names, across=True)
    root.resize(400, 110)
    qt.QApplication.processEvents()
    found = [one for one in flaws(root) if "no scroll bar" in one]
    assert any("QTableWidget" in one for one in found) and any("QListWidget" in one for one in found)
    table.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAsNeeded)
    qt.QApplication.processEvents()
    assert not any("QTableWidget" in one for one in flaws(root)), "half of its rows are reached by a bar"
    root.resize(400, root.height() + table.verticalHeader().length() - table.viewport().height() - 9)
    qt.QApplication.processEvents()
    assert any("QTableWidget" in one and "less than a row" in one for one in flaws(root))


def test_text_and_columns_that_do_not_fit_are_found(qtbot: QtBot) -> None:
    root, page, area, inner = qt.QWidget(), qt.QTextBrowser(), qt.QScrollArea(), qt.QWidget()
    page.setPlainText("\n".join("abcdef"))
    inner.setFixedSize(120, 80)
    area.setWidget(inner)
    area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    area.setMinimumWidth(60)
    shown(qtbot, root, 500, 300, page, area, across=True)
    area.setFixedWidth(70)
    lines = round(page.document().size().height())
    page.setFixedHeight(lines + 2 * page.frameWidth() - 12)
    assert finds(root, "120 px wide", "one line")
    page.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    assert finds(root, "its text needs")


class Crowded(Axis):
    """An axis with a number at every tick, whether there is room or not."""

    def tickValues(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, list[float]]]:
        return [(1.0, [float(k) for k in range(int(minVal), int(maxVal) + 1)])]


def test_numbers_names_and_words_of_plots_that_collide_or_are_cut_are_found(qtbot: QtBot) -> None:
    view, plot = pg.GraphicsView(), Plot(bottom=Crowded("bottom"), margin=10)
    view.setCentralItem(plot)
    plot.apply_theme()
    plot.name_axes("place (px)", "count (1)")
    plot.vb.setXRange(0, 5, padding=0)
    words = pg.TextItem("words in a plot that are rather long")
    words.setPos(0.5, 0.5)
    plot.addItem(words)
    shown(qtbot, view, 500, 240)
    words.setPos(4.5, 0.5)
    assert finds(view, "are cut")
    plot.removeItem(words)
    plot.vb.setXRange(1000, 1060, padding=0)
    assert finds(view, "collide")
    plot.vb.setXRange(0, 5, padding=0)
    view.resize(500, 64)
    assert finds(view, "px inside")
    left = plot.getAxis("left")
    left.label.setPlainText("a name that is longer than any axis so low (px)")  # an axis itself shortens it
    pg.AxisItem.resizeEvent(left)
    assert any("'a name" in one and "needs" in one for one in flaws(view))
    plot.name_axes("place (px)", "count (1)")
    view.resize(500, 240)
    qt.QApplication.processEvents()
    left.setWidth(24)
    plot.vb.setYRange(0, 50000, padding=0)
    assert finds(view, "shows 1 numbers of")
    left.setWidth(60)
    assert not finds(view, "count")
    left.label.setX(left.label.x() + 20)
    assert any("lies over its number" in one for one in flaws(view)), flaws(view)


class Whole(Axis):
    """An axis that does not shorten its name."""

    def labelString(self) -> str:
        return str(pg.AxisItem.labelString(self))


def test_names_of_plots_side_by_side_that_collide_are_found(qtbot: QtBot) -> None:
    view, row = pg.GraphicsView(), pg.GraphicsLayout()
    view.setCentralItem(row)
    for name in ("place along the first line (px)", "place along the second line (px)"):
        row.addItem(plot := Plot(bottom=Whole("bottom")))
        plot.name_axes(name, "count (1)")
    shown(qtbot, view, 600, 240)
    view.resize(330, 240)
    assert finds(view, "overlap")


def test_colours_of_another_theme_are_found(qapp: qt.QApplication, qtbot: QtBot) -> None:
    root, words, table = qt.QWidget(), qt.QLabel(f"<b style='color:{LIGHT.good}'>good</b>"), qt.QTableWidget(1, 1)
    table.setItem(0, 0, qt.QTableWidgetItem("bad"))
    table.item(0, 0).setForeground(QColor(LIGHT.bad))
    shown(qtbot, root, 200, 200, words, table)
    assert not list(of_other_themes(root))
    apply_theme(qapp, DARK)
    found = list(of_other_themes(root))
    assert len(found) == 2 and all("none of dark's" in one for one in found)
