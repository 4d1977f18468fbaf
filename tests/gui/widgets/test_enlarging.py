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
from lfcal_gui.widgets.enlarging import Enlarged, enlarge, pictures_in, toggle_in, whole_page
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


def test_a_page_gets_smaller_while_something_is_enlarged(page: QWidget, qtbot: QtBot) -> None:
    """The place that was kept for it had its size as the least: the window could not be made smaller."""
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


def test_a_card_goes_with_its_only_picture(page: QWidget, qtbot: QtBot) -> None:
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


def test_what_is_enlarged_goes_on(psf: Any, window: MainWindow, qtbot: QtBot) -> None:
    view = psf.panel.main_view
    enlarge(view)
    holder = psf.findChild(Enlarged)
    QTest.keyClick(holder, Qt.Key.Key_Right)
    assert psf.intent.x == 3 and "x 3" in view.shot.caption, "keys are the page's"
    np.testing.assert_array_equal(view.values, psf.matrix[1, 1, 3])
    QTest.keyClick(holder, Qt.Key.Key_Escape)
    assert psf.findChildren(Enlarged) == [] and view.isVisible()


def test_escape_is_not_the_pages_own(window: MainWindow, qtbot: QtBot, psf: Any, monkeypatch: Any) -> None:
    """Pages stop their jobs at Esc."""
    page = psf
    stopped: list[int] = []
    monkeypatch.setattr(window.jobs, "cancel", stopped.append)
    going = window.jobs.start("Report", "h", lambda: iter(()))
    assert going and toggle_in(page)
    holder = page.findChild(Enlarged)
    QTest.keyClick(holder, Qt.Key.Key_Escape)
    assert page.findChildren(Enlarged) == [] and stopped == []
    idle(window.jobs, qtbot)


def area(widget: QWidget) -> int:
    return widget.width() * widget.height() if widget.isVisible() else 0


def test_menu_key_and_menu_bar(psf: Any, window: MainWindow, qtbot: QtBot) -> None:
    view = psf.panel.main_view
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


def test_a_page_that_becomes_empty_hides_it_and_it_is_there_again(psf: Any, window: MainWindow, qtbot: QtBot) -> None:
    enlarge(psf.panel.sum_view)
    window.project.update("close", psf="")
    idle(window.jobs, qtbot)
    assert psf.empty is not None and psf.empty.isVisible() and not psf.panel.sum_view.isVisible()
    window.project.undo()
    idle(window.jobs, qtbot)
    psf.findChild(Enlarged).put_back()
    assert psf.panel.sum_view.isVisible()


def test_borders_are_the_users(window: MainWindow) -> None:
    window.resize(1600, 1000)
    window.go("h")
    page: Any = window.page("h")
    page.show_body()
    QApplication.processEvents()
    before = page.panel.split.sizes()
    page.panel.split.setSizes([before[0] + 10, before[1] - 10])
    assert page.panel.split.sizes()[0] == before[0] + 10
