"""The strip of the contrast, and two H that are compared in pictures with one contrast."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QInputDialog, QMenu
from pytestqt.qtbot import QtBot

from lfcal.judge import pair
from lfcal_gui.models.comparison import both_at
from lfcal_gui.models.shot import Shot
from lfcal_gui.widgets.compare_panel import ComparePanel
from lfcal_gui.widgets.contrast import Contrast
from lfcal_gui.widgets.picture import Picture, share_contrast
from tests.gui.waiting import GUARD_MS
from tests.judge.test_comparison import moved

VALUES = np.arange(1000.0).reshape(20, 50)


@pytest.fixture
def bar(qtbot: QtBot) -> Contrast:
    first, second = Picture("light (counts)", legend=False), Picture("light (counts)", legend=False)
    share_contrast(first, second)
    made = Contrast(first)
    for widget in (first, second, made):
        qtbot.addWidget(widget)
    for picture in (first, second):
        picture.set_shot(Shot(VALUES))
    made.resize(420, 58)
    made.show()
    qtbot.waitExposed(made, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: len(made._counts) > 0 and not made._timer.isActive(), timeout=GUARD_MS)
    return made


def at(bar: Contrast, value: float) -> QPoint:
    return QPoint(round(bar._x_of(value)), 30)


def drag(bar: Contrast, start: float, end: float) -> None:
    QTest.mousePress(bar, Qt.MouseButton.LeftButton, pos=at(bar, start))
    QTest.mouseMove(bar, at(bar, end))


def test_a_dragged_handle_changes_every_picture_and_does_not_pass_the_other(bar: Contrast) -> None:
    drag(bar, 999, 500)
    QTest.mouseRelease(bar, Qt.MouseButton.LeftButton, pos=at(bar, 500))
    low, high = bar.levels
    assert low == 0 and high == pytest.approx(500, abs=3)
    for picture in bar.picture.sharing:
        assert picture.levels == bar.levels
        assert (picture.item.image[picture.values > high + 2] == 255).all()
    assert bar.clipped()[1] == pytest.approx(0.5, abs=0.02) and bar.clipped()[0] == 0
    QTest.mouseMove(bar, at(bar, 100))
    assert bar.levels == (low, high), "it moves only while the button is pressed"
    bar.set_levels((400.0, 600.0))
    drag(bar, 400, 900)
    assert 400 < bar.levels[0] < bar.levels[1] == 600


def test_keys_move_the_handles(bar: Contrast) -> None:
    QTest.keyClick(bar, Qt.Key.Key_Left)
    assert bar.levels == pytest.approx((0, 999 - 9.99), abs=0.1)
    QTest.keyClick(bar, Qt.Key.Key_Space)
    QTest.keyClick(bar, Qt.Key.Key_Right)
    assert bar.levels == pytest.approx((9.99, 999 - 9.99), abs=0.1)
    QTest.keyClick(bar, Qt.Key.Key_A)
    assert bar.levels == pytest.approx(np.quantile(VALUES, (0.001, 0.999)))
    # a few points in a dark picture stay visible
    values = np.zeros((100, 100))
    values[5, 5] = 9.0
    bar.picture.set_shot(Shot(values))
    bar.leave_out_tails()
    assert bar.levels == (0.0, 9.0)


def test_the_histogram_is_visible_with_the_focus(bar: Contrast, qtbot: QtBot) -> None:
    """The frame that shows the focus was filled, and lay over all of it."""
    place = QPoint(bar.width() // 2, 6), QPoint(bar.width() // 2, 25)
    bar.clearFocus()
    before = [bar.grab().toImage().pixelColor(at) for at in place]
    bar.activateWindow()
    bar.setFocus()
    qtbot.waitUntil(bar.hasFocus, timeout=GUARD_MS)
    assert [bar.grab().toImage().pixelColor(at) for at in place] == before


def test_a_value_is_typed(bar: Contrast, monkeypatch: pytest.MonkeyPatch) -> None:
    for typed, wanted in (("nan", (0.0, 999.0)), ("much", (0.0, 999.0)), ("250", (0.0, 250.0))):
        monkeypatch.setattr(QInputDialog, "getText", lambda *_, typed=typed, **__: (typed, True))
        QTest.mouseDClick(bar, Qt.MouseButton.LeftButton, pos=at(bar, 999))
        assert bar.levels == wanted, typed


def test_the_menu_resets_the_contrast_and_changes_scaling_and_colours(bar: Contrast, qtbot: QtBot) -> None:
    asked: list[dict[str, str]] = []
    bar.display_asked.connect(asked.append)
    bar.set_levels((1.0, 2.0))
    menu = bar.menu(QPoint(0, 0))
    entries = {action.text(): action for action in menu.actions()}
    entries["Automatic contrast"].trigger()
    assert bar.levels == (0.0, 999.0)
    inside = {action.text(): action for one in menu.findChildren(QMenu) for action in one.actions()}
    assert inside["linear"].isChecked() and inside["magma"].isChecked()
    inside["log, 4 decades"].trigger()
    inside["gray"].trigger()
    assert asked == [{"scale": "log"}, {"colour_map": "gray"}]
    for picture in bar.picture.sharing:
        assert (picture.display.scale, picture.display.colour_map) == ("log", "gray")
    menu.close()


def test_without_a_picture_nothing_can_be_chosen(bar: Contrast, qtbot: QtBot) -> None:
    bar.picture.set_shot(None)
    qtbot.waitUntil(lambda: not bar._timer.isActive(), timeout=GUARD_MS)
    assert not bar.isEnabled()
    drawn = bar.grab().toImage()
    colours = {drawn.pixel(x, y) for x in range(drawn.width()) for y in range(drawn.height())}
    assert len(colours) == 1, "a strip without a picture looks like an image that is dark"
    bar.leave_out_tails()
    bar.repaint()
    bar.picture.set_shot(Shot(np.full((2, 2), 5.0)))
    qtbot.waitUntil(lambda: not bar._timer.isActive(), timeout=GUARD_MS)
    assert bar.isEnabled() and bar.levels == (5.0, 6.0)
    bar.repaint()


# -- two H -------------------------------------------------------------------------------------------------


@pytest.fixture
def panel(qtbot: QtBot) -> ComparePanel:
    """Return the panel with a position of two H."""
    made = ComparePanel()
    qtbot.addWidget(made)
    made.resize(1000, 700)
    made.show()
    made.show_numbers(("H.h5", "earlier.h5"), ("", ""), [], [], [])
    made.show_both(both_at(pair(3 * moved(), moved()), (1, 2, 3)), "at (1, 2, 3)")
    return made


def test_two_h_are_shown_with_the_same_light(panel: ComparePanel) -> None:
    first, second, apart = (view.values for view in panel.views)
    assert first is not None and second is not None and apart is not None
    assert panel.titles[0].text() == "H.h5 at (1, 2, 3)" and first.sum() == pytest.approx(second.sum())
    assert np.array_equal(apart, first - second)


def test_pictures_are_zoomed_together(panel: ComparePanel) -> None:
    views = panel.views
    views[0].box.setRange(xRange=(5, 9), yRange=(5, 9), padding=0)
    views[0].box.sigRangeChangedManually.emit([True, True])
    seen = [view.box.viewRect() for view in views]
    assert seen[1].center() == seen[0].center() == seen[2].center()
    assert seen[1].width() == pytest.approx(seen[0].width(), rel=0.3)


@pytest.mark.long
def test_blink_shows_both_in_one_place(panel: ComparePanel, qtbot: QtBot) -> None:
    panel.mode.setCurrentIndex(panel.mode.findData("blink"))
    before = panel.views[0].values
    assert panel.views[1].isHidden() or not panel.views[1].isVisible()
    qtbot.waitUntil(lambda: panel.titles[0].text() == "earlier.h5", timeout=GUARD_MS)
    assert panel.views[0].values is not before
    qtbot.waitUntil(lambda: panel.titles[0].text() == "H.h5 at (1, 2, 3)", timeout=GUARD_MS)
    panel.mode.setCurrentIndex(panel.mode.findData("difference"))
    assert panel.views[2].isVisible() and not panel.views[0].isVisible() and not panel._timer.isActive()


def test_the_next_pair_clears_pictures_and_map(panel: ComparePanel) -> None:
    error = np.ones((4, 6))
    error[1, 2] = np.nan  # a position that was not compared
    panel.show_map(0, "Difference", error, (0.0, 2.0))
    assert panel.map.values is not None and not panel.map.blank.shown
    assert panel.map.overlays[0].points.tolist() == [[1, 2]], "crossed out"
    panel.show_map(1, "Difference", np.full((4, 6), np.nan), (0.0, 2.0))
    assert panel.map.values is None and panel.map.blank.words.startswith("Not compared")
    assert panel.map.shot.cross is None and not panel.map.overlays
    panel.show_map(0, "Difference", error, (0.0, 2.0))
    panel.show_numbers(("H.h5", "earlier.h5"), ("", ""), [], [], [])
    assert all(view.values is None for view in (*panel.views, panel.map))
    assert all(title.text() == " " for title in (*panel.titles, panel.map_title))
