"""The window with content is laid out well: no text is cut, nothing overlaps, no scroll bar for a few pixels."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pyqtgraph as pg
import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor
from PySide6.QtWidgets import (
    QApplication,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QListWidget,
    QPushButton,
    QScrollArea,
    QSpinBox,
    QTableWidget,
    QTableWidgetItem,
    QTextBrowser,
    QVBoxLayout,
    QWidget,
)
from pytestqt.qtbot import QtBot

from lfcal_gui.scenes.all import SCENES
from lfcal_gui.scenes.sample import h, open_sample, setup
from lfcal_gui.scenes.stage import Capture, Scene, Stage
from lfcal_gui.theme import DARK, LIGHT, apply_theme
from lfcal_gui.widgets._axes import Axis, Plot
from lfcal_gui.widgets.words import WrappedLabel
from lfcal_gui.window import MainWindow
from tests.gui.layout import flaws
from tests.gui.layout_colours import of_other_themes

LEAST, SMALL, LARGE = (1000, 600), (1280, 800), (1920, 1080)


@pytest.fixture
def stage(qapp: QApplication, window: MainWindow, tmp_path: Path) -> Stage:
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
    """Change the theme and back; yield the parts that kept colours of the one before."""
    for theme in ("dark", "light"):
        stage.window.set_theme(theme)
        stage.turn(2)
        yield f"{shot.name}, {theme}", list(of_other_themes(stage.seen(shot)))


def test_a_large_window_with_the_log_can_be_made_the_smallest_at_once(stage: Stage) -> None:
    stage.window.log_dock.show()
    for spec in stage.window.specs:
        stage.window.go(spec.key)
    stage.resize(*LARGE)
    stage.turn()
    stage.resize(*LEAST)
    stage.turn()
    assert (stage.window.width(), stage.window.height()) == LEAST


def test_every_page_has_room_in_the_smallest_window(stage: Stage) -> None:
    """A longer name of a button made the window 17 px wider than that."""
    for spec in stage.window.specs:
        stage.window.go(spec.key)
        stage.turn()
        assert stage.window.minimumSizeHint().width() <= LEAST[0], spec.key


@pytest.mark.long
def test_pages_with_the_sample_session(stage: Stage) -> None:
    open_sample(stage)
    for scene in (setup, h):
        assert not list(looked_at(stage, scene, LEAST, SMALL))


@pytest.mark.long
@pytest.mark.parametrize("name", SCENES)
def test_every_state_at_all_sizes(name: str, stage: Stage) -> None:
    wrong = list(looked_at(stage, SCENES[name], LEAST, SMALL, LARGE))
    assert not wrong, "\n".join(wrong)


def test_what_is_wrong_is_found(qtbot: QtBot) -> None:
    root = QWidget()
    qtbot.addWidget(root)
    row = QHBoxLayout(root)
    first, second = QLabel("words that have less room than they need"), QLabel("other words")
    for label in (first, second):
        row.addWidget(label)
    root.show()
    root.resize(600, 60)
    assert not flaws(root)
    first.setFixedWidth(60)
    QApplication.processEvents()
    assert any("needs" in one and "has 60" in one for one in flaws(root))
    first.setFixedWidth(280)
    QApplication.processEvents()
    second.move(first.x() + 20, second.y())
    assert any("overlaps" in one for one in flaws(root))
    second.move(590, second.y())
    assert any("reaches out" in one for one in flaws(root))


def shown(qtbot: QtBot, root: QWidget, width: int, height: int) -> QWidget:
    qtbot.addWidget(root)
    root.show()
    root.resize(width, height)
    QApplication.processEvents()
    return root


def test_a_table_of_words_that_a_label_below_it_squeezes_is_found(qtbot: QtBot) -> None:
    root, numbers, note = QWidget(), QLabel(), WrappedLabel("Does not pay.")
    rows = "".join(f"<tr><td>row {k}</td><td><b>{k}</b></td></tr>" for k in range(10))
    numbers.setText(f"<table cellspacing='3'>{rows}</table>")
    column = QVBoxLayout(root)
    for part in (QLineEdit(), numbers, note, QPushButton("Save …")):
        column.addWidget(part)
    column.addStretch()
    shown(qtbot, root, 240, 40)
    assert not flaws(root), "as high as it needs to be"
    note.setText(
        "Showing eleven frames together, coded: does not pay at 16000 electrons in the brightest pixel of a point"
    )
    root.setFixedHeight(root.height())
    QApplication.processEvents()
    found = flaws(root)
    assert any("row 0" in one and "needs a height" in one for one in found), found
    note.setText("Does not pay.")
    QApplication.processEvents()
    assert not flaws(root)


def test_controls_that_are_lower_than_their_words_are_found(qtbot: QtBot) -> None:
    root, edit = QWidget(), QLineEdit("5")
    column = QVBoxLayout(root)
    column.addWidget(edit)
    column.addWidget(QSpinBox())
    shown(qtbot, root, 200, 90)
    assert not flaws(root)
    edit.resize(edit.width(), 14)
    assert any("needs a height" in one and "has 14" in one for one in flaws(root))


def test_rows_that_no_scroll_bar_reaches_are_found(qtbot: QtBot) -> None:
    root, table, names = QWidget(), QTableWidget(6, 1), QListWidget()
    names.addItems([f"name {k}" for k in range(12)])
    row = QHBoxLayout(root)
    for view in (table, names):
        view.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        row.addWidget(view)
    shown(qtbot, root, 400, 400)
    assert not flaws(root)
    root.resize(400, 110)
    QApplication.processEvents()
    found = [one for one in flaws(root) if "no scroll bar" in one]
    assert any("QTableWidget" in one for one in found) and any("QListWidget" in one for one in found)
    table.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAsNeeded)
    QApplication.processEvents()
    assert not any("QTableWidget" in one for one in flaws(root)), "half of its rows are reached by a bar"
    root.resize(400, root.height() + table.verticalHeader().length() - table.viewport().height() - 9)
    QApplication.processEvents()
    assert any("QTableWidget" in one and "less than a row" in one for one in flaws(root))


def test_text_and_columns_that_do_not_fit_are_found(qtbot: QtBot) -> None:
    root, page, area, inner = QWidget(), QTextBrowser(), QScrollArea(), QWidget()
    page.setPlainText("\n".join("abcdef"))
    inner.setFixedSize(120, 80)
    area.setWidget(inner)
    area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    area.setMinimumWidth(60)
    row = QHBoxLayout(root)
    row.addWidget(page)
    row.addWidget(area)
    shown(qtbot, root, 500, 300)
    assert not flaws(root)
    area.setFixedWidth(70)
    lines = round(page.document().size().height())
    page.setFixedHeight(lines + 2 * page.frameWidth() - 12)
    QApplication.processEvents()
    found = flaws(root)
    assert any("120 px wide" in one for one in found) and any("one line" in one for one in found), found
    page.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    QApplication.processEvents()
    assert any("its text needs" in one for one in flaws(root))


class Crowded(Axis):
    """Numbers wherever it is told, whether there is room or not."""

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
    assert not flaws(view)
    words.setPos(4.5, 0.5)
    QApplication.processEvents()
    assert any("are cut" in one for one in flaws(view))
    plot.removeItem(words)
    plot.vb.setXRange(1000, 1060, padding=0)
    QApplication.processEvents()
    assert any("collide" in one for one in flaws(view))
    plot.vb.setXRange(0, 5, padding=0)
    view.resize(500, 64)
    QApplication.processEvents()
    assert any("px inside" in one for one in flaws(view))
    left = plot.getAxis("left")
    left.label.setPlainText("a name that is longer than any axis so low (px)")  # an axis itself leaves out its end
    pg.AxisItem.resizeEvent(left)
    assert any("'a name" in one and "needs" in one for one in flaws(view))
    plot.name_axes("place (px)", "count (1)")
    view.resize(500, 240)
    QApplication.processEvents()
    left.setWidth(24)
    plot.vb.setYRange(0, 50000, padding=0)
    QApplication.processEvents()
    assert any("shows 1 numbers of" in one for one in flaws(view)), flaws(view)
    left.setWidth(60)
    QApplication.processEvents()
    assert not any("count" in one for one in flaws(view)), flaws(view)
    left.label.setX(left.label.x() + 20)
    assert any("lies over its number" in one for one in flaws(view)), flaws(view)


class Whole(Axis):
    """Leaves out nothing of its name."""

    def labelString(self) -> str:
        return str(pg.AxisItem.labelString(self))


def test_names_of_plots_side_by_side_that_collide_are_found(qtbot: QtBot) -> None:
    view, row = pg.GraphicsView(), pg.GraphicsLayout()
    view.setCentralItem(row)
    for name in ("place along the first line (px)", "place along the second line (px)"):
        row.addItem(plot := Plot(bottom=Whole("bottom")))
        plot.name_axes(name, "count (1)")
    shown(qtbot, view, 600, 240)
    assert not flaws(view)
    view.resize(330, 240)
    QApplication.processEvents()
    assert any("over each other" in one for one in flaws(view))


def test_colours_that_a_change_of_theme_left_behind_are_found(qapp: QApplication, qtbot: QtBot) -> None:
    root, words, table = QWidget(), QLabel(f"<b style='color:{LIGHT.good}'>good</b>"), QTableWidget(1, 1)
    table.setItem(0, 0, QTableWidgetItem("bad"))
    table.item(0, 0).setForeground(QColor(LIGHT.bad))
    column = QVBoxLayout(root)
    column.addWidget(words)
    column.addWidget(table)
    shown(qtbot, root, 200, 200)
    assert not list(of_other_themes(root))
    apply_theme(qapp, DARK)
    found = list(of_other_themes(root))
    assert len(found) == 2 and all("none of dark's" in one for one in found)
