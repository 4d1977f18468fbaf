"""Enlarged pictures: they fill their page, keep working, and go back to their place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QAction
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QGridLayout, QMenu, QVBoxLayout, QWidget
from pytestqt.qtbot import QtBot

from lfcal.psf import PSFMatrix, save
from lfcal_gui.models.shot import Shot
from lfcal_gui.widgets.cards import card, split
from lfcal_gui.widgets.enlarging import Enlarged, enlarge, pictures_in, whole_page
from lfcal_gui.widgets.picture import Picture
from lfcal_gui.widgets.plots import LinePlot
from lfcal_gui.window import MainWindow
from tests.gui.waiting import GUARD_MS, idle


@pytest.fixture
def page(qtbot: QtBot) -> QWidget:
    """Return a page of 900 x 600 px."""
    made = QWidget()
    whole_page(made)
    qtbot.addWidget(made)
    made.resize(900, 600)
    return made


def shown(page: QWidget, qtbot: QtBot) -> None:
    page.show()
    qtbot.waitExposed(page, timeout=GUARD_MS)


def picture() -> Picture:
    view = Picture()
    view.set_shot(Shot(np.arange(12.0).reshape(3, 4)))
    return view


def test_a_picture_in_a_grid_fills_its_page_and_goes_back(page: QWidget, qtbot: QtBot) -> None:
    grid, views = QGridLayout(page), [picture() for _ in range(4)]
    for k, view in enumerate(views):
        grid.addWidget(view, k // 2, k % 2)
    views[1].setMaximumHeight(140)
    shown(page, qtbot)
    before = [view.geometry() for view in views]
    holder = enlarge(views[1])
    assert holder is not None and holder.geometry() == page.rect()
    QApplication.processEvents()
    assert views[1].width() > 800 and views[1].height() > 450, "whatever its limits on the page"
    page.resize(1000, 700)
    assert holder.geometry() == page.rect(), "it stays as large as the page"
    page.resize(900, 600)
    assert enlarge(views[1]) is None
    QApplication.processEvents()
    assert [view.geometry() for view in views] == before and views[1].maximumHeight() == 140
    assert grid.itemAtPosition(0, 1).widget() is views[1]


def test_a_page_can_become_smaller_while_a_picture_is_enlarged(page: QWidget, qtbot: QtBot) -> None:
    """Its empty place kept its size, so that the window could not be made smaller."""
    row, views = QVBoxLayout(page), [picture() for _ in range(2)]
    row.addWidget(split(*views, sizes=(800, 800)))
    page.resize(1600, 900)
    shown(page, qtbot)
    holder = enlarge(views[0])
    page.resize(700, 500)
    QApplication.processEvents()
    assert (page.width(), page.height()) == (700, 500) and holder is not None and holder.geometry() == page.rect()
    assert views[1].parentWidget().width() <= 700
    enlarge(views[0])
    QApplication.processEvents()
    assert views[0].width() > 100 and views[1].width() > 100


def test_a_card_is_enlarged_with_its_only_picture(page: QWidget, qtbot: QtBot) -> None:
    left, column = card("Profile")
    plot = LinePlot("x (px)", "counts")
    column.addWidget(plot)
    right, both = card("Two")
    first, second = picture(), picture()
    both.addWidget(first)
    both.addWidget(second)
    parts = split(left, right, sizes=(300, 500))
    QVBoxLayout(page).addWidget(parts)
    shown(page, qtbot)
    sizes = parts.sizes()
    holder = enlarge(plot)
    assert holder is not None and holder.part is left and parts.indexOf(left) < 0
    enlarge(plot)
    QApplication.processEvents()
    assert parts.indexOf(left) == 0 and parts.sizes() == sizes and plot.isVisible()
    holder = enlarge(second)
    assert holder is not None and holder.part is second, "its card has another one"
    holder.back.click()
    assert both.indexOf(second) == 2 and len(pictures_in(page)) == 3 and page.findChildren(Enlarged) == []


@pytest.fixture
def psf(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> Any:
    rng = np.random.default_rng(5)
    save(PSFMatrix(rng.random((2, 3, 4, 9, 11), np.float32), depths=[0.0, 10.0]), tmp_path / "H.h5")
    window.project.update("open", psf=str(tmp_path / "H.h5"))
    window.go("h")
    idle(window.jobs, qtbot)
    return window.page("h")


def area(widget: QWidget) -> int:
    return widget.width() * widget.height() if widget.isVisible() else 0


def test_an_enlarged_picture_keeps_its_keys_and_its_menu(
    psf: Any, window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = psf.panel.main_view
    enlarge(view)
    holder = psf.findChild(Enlarged)
    QTest.keyClick(holder, Qt.Key.Key_Right)
    assert psf.intent.x == 3 and "x 3" in view.shot.caption, "keys are those of the page"
    np.testing.assert_array_equal(view.values, psf.matrix[1, 1, 3])
    # pages stop their jobs at Esc
    stopped: list[int] = []
    monkeypatch.setattr(window.jobs, "cancel", stopped.append)
    assert window.jobs.start("Report", "h", lambda: iter(()))
    QTest.keyClick(holder, Qt.Key.Key_Escape)
    assert psf.findChildren(Enlarged) == [] and view.isVisible() and stopped == []
    idle(window.jobs, qtbot)
    view.customContextMenuRequested.emit(view.rect().center())
    menu = next(m for m in view.findChildren(QMenu) if m.isVisible())
    next(a for a in menu.actions() if a.text() == "Enlarge").trigger()
    menu.close()
    assert psf.findChild(Enlarged) is not None
    action = next(a for a in window.findChildren(QAction) if a.shortcut().toString() == "Ctrl+E")
    action.trigger()
    QApplication.processEvents()
    assert psf.findChildren(Enlarged) == []
    # the largest picture is known after the page is laid out again
    qtbot.waitUntil(lambda: area(psf.panel.main_view) > area(psf.panel.sum_view), timeout=GUARD_MS)
    action.trigger()
    largest = psf.findChild(Enlarged)
    assert largest is not None and {*pictures_in(largest)} & {psf.panel.main_view, psf.panel.linked_view}
    largest.put_back()
    enlarge(psf.panel.sum_view)
    window.project.update("close", psf="")
    idle(window.jobs, qtbot)
    assert psf.empty is not None and psf.empty.isVisible() and not psf.panel.sum_view.isVisible()
    window.project.undo()
    idle(window.jobs, qtbot)
    psf.findChild(Enlarged).put_back()
    assert psf.panel.sum_view.isVisible(), "a page that was empty for a while still has it"
