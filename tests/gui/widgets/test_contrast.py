"""Contrast: handles, shares, keys, menu."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QInputDialog, QMenu
from pytestqt.qtbot import QtBot

from lfcal_gui.models.shot import Shot
from lfcal_gui.widgets.contrast import Contrast
from lfcal_gui.widgets.picture import Picture, share_contrast
from tests.gui.waiting import GUARD_MS

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


def test_a_handle_that_is_dragged_changes_every_picture(bar: Contrast) -> None:
    QTest.mousePress(bar, Qt.MouseButton.LeftButton, pos=at(bar, 999))
    QTest.mouseMove(bar, at(bar, 500))
    QTest.mouseRelease(bar, Qt.MouseButton.LeftButton, pos=at(bar, 500))
    low, high = bar.levels
    assert low == 0 and high == pytest.approx(500, abs=3)
    for picture in bar.picture.sharing:
        assert picture.levels == bar.levels
        assert (picture.item.image[picture.values > high + 2] == 255).all()
    assert bar.clipped()[1] == pytest.approx(0.5, abs=0.02) and bar.clipped()[0] == 0
    QTest.mouseMove(bar, at(bar, 100))
    assert bar.levels == (low, high), "it is moved only while it is held"


def test_handles_do_not_pass_each_other(bar: Contrast) -> None:
    bar.set_levels((400.0, 600.0))
    QTest.mousePress(bar, Qt.MouseButton.LeftButton, pos=at(bar, 400))
    QTest.mouseMove(bar, at(bar, 900))
    assert 400 < bar.levels[0] < bar.levels[1] == 600


def test_keys_move_the_handles(bar: Contrast) -> None:
    QTest.keyClick(bar, Qt.Key.Key_Left)
    assert bar.levels == pytest.approx((0, 999 - 9.99), abs=0.1)
    QTest.keyClick(bar, Qt.Key.Key_Space)
    QTest.keyClick(bar, Qt.Key.Key_Right)
    assert bar.levels == pytest.approx((9.99, 999 - 9.99), abs=0.1)
    QTest.keyClick(bar, Qt.Key.Key_A)
    assert bar.levels == pytest.approx(np.quantile(VALUES, (0.001, 0.999)))


def test_the_histogram_is_seen_while_the_keyboard_is_there(bar: Contrast, qtbot: QtBot) -> None:
    """The frame that shows the focus was filled, and lay over all of it."""
    place = QPoint(bar.width() // 2, 6), QPoint(bar.width() // 2, 25)
    bar.clearFocus()
    before = [bar.grab().toImage().pixelColor(at) for at in place]
    bar.activateWindow()
    bar.setFocus()
    qtbot.waitUntil(bar.hasFocus, timeout=GUARD_MS)
    assert [bar.grab().toImage().pixelColor(at) for at in place] == before


def test_of_a_dark_picture_with_a_few_points_the_points_are_seen(bar: Contrast) -> None:
    values = np.zeros((100, 100))
    values[5, 5] = 9.0
    bar.picture.set_shot(Shot(values))
    bar.leave_out_tails()
    assert bar.levels == (0.0, 9.0)


@pytest.mark.parametrize(("given", "wanted"), [("250", (0.0, 250.0)), ("nan", (0.0, 999.0)), ("much", (0.0, 999.0))])
def test_a_value_is_typed(
    bar: Contrast, monkeypatch: pytest.MonkeyPatch, given: str, wanted: tuple[float, float]
) -> None:
    monkeypatch.setattr(QInputDialog, "getText", lambda *_, **__: (given, True))
    QTest.mouseDClick(bar, Qt.MouseButton.LeftButton, pos=at(bar, 999))
    assert bar.levels == wanted


def test_the_menu_takes_back_and_changes_scaling_and_colours(bar: Contrast, qtbot: QtBot) -> None:
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
