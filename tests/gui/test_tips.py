"""Every control says when one would use it: on all pages, in docks and dialogs."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

import pyqtgraph as pg
import pytest
from PySide6.QtCore import QSettings
from PySide6.QtWidgets import (
    QAbstractButton,
    QCheckBox,
    QComboBox,
    QLineEdit,
    QPushButton,
    QTabBar,
    QTabWidget,
    QWidget,
)
from pytestqt.qtbot import QtBot

from lfcal_gui._help import Manual
from lfcal_gui._rescue import RestoreDialog
from lfcal_gui._welcome import Welcome
from lfcal_gui.base_page import EmptyState
from lfcal_gui.crash_dialog import CrashDialog
from lfcal_gui.job_panel import JobLogView
from lfcal_gui.models.autosave import UnsavedCopy
from lfcal_gui.models.job import JobLog
from lfcal_gui.models.page import PAGES
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.frames._import_dialog import ImportDialog
from lfcal_gui.pages.h.panel import LEVELS
from lfcal_gui.palette import Palette
from lfcal_gui.preferences import Preferences
from lfcal_gui.widgets.naming import controls, name_controls
from lfcal_gui.window import MainWindow
from tests.gui.waiting import idle

BESIDE = {"Close", "Cancel"}
"""What each dialog has; its tip may be the same elsewhere."""


def words(text: str) -> list[str]:
    return re.findall(r"[^\W_]+", text.lower())


def label(control: QWidget) -> str:
    text = control.text() if isinstance(control, QAbstractButton) else ""
    return text or control.accessibleName()


def repeats(tip: str, name: str) -> bool:
    """Return whether a tip says no more than a label; names that are taken from tips are no labels."""
    return set(words(tip)) <= set(words(name)) and not (name and tip.startswith(name) and len(words(name)) > 3)


def untold(root: QWidget) -> list[str]:
    """Return the controls and tabs in ``root`` whose tip is missing, or says no more than their label."""
    told = [
        (type(one).__name__, label(one), one.toolTip())
        for one in controls(root)
        if not isinstance(one, pg.GraphicsView)
    ]
    for bar in root.findChildren(QTabBar):
        told += [("tab", bar.tabText(k), bar.tabToolTip(k)) for k in range(bar.count())]
    return [f"{kind} {name!r}: {tip!r}" for kind, name, tip in told if not words(tip) or not name or repeats(tip, name)]


def shared(root: QWidget) -> list[str]:
    """Return the tips that several controls in ``root`` have: of a row or frame, they say nothing about one of them."""
    kinds = (QPushButton, QCheckBox, QComboBox, QLineEdit)
    # what leads on from an empty page does the same as a button of its head
    found = [one for one in controls(root) if isinstance(one, kinds) and not isinstance(one.parent(), EmptyState)]
    seen = {(label(one), one.toolTip()) for one in found}
    return [tip for tip, count in Counter(tip for name, tip in seen if name not in BESIDE).items() if count > 1]


@pytest.fixture
def all_pages(window: MainWindow, qtbot: QtBot) -> dict[str, Any]:
    """Return every page with its body made, and with what is shown where there is nothing."""
    pages: dict[str, Any] = {}
    for spec in window.specs:
        window.go(spec.key)
        idle(window.jobs, qtbot)
        pages[spec.key] = window.page(spec.key)
    for level in LEVELS:  # made when they are looked at
        pages["h"].look_into(level)
    assert pages["h"].fitting.view.rounds and pages["h"].panel.fitted
    return pages


def test_every_control_of_every_page_says_when_one_would_use_it(all_pages: dict[str, Any]) -> None:
    assert set(all_pages) == set(PAGES.names())
    assert sum(len(controls(page)) for page in all_pages.values()) > 300
    lacking = {key: found for key, page in all_pages.items() if (found := untold(page))}
    assert lacking == {}, lacking


def test_no_two_controls_of_a_page_have_one_tip(all_pages: dict[str, Any]) -> None:
    several = {key: found for key, page in all_pages.items() if (found := shared(page))}
    assert several == {}


def test_what_leads_on_from_an_empty_page_says_so(window: MainWindow, qtbot: QtBot) -> None:
    window.project.update("plan", plan=None)
    empty = 0
    for spec in window.specs:
        window.go(spec.key)
        idle(window.jobs, qtbot)
        for state in window.page(spec.key).findChildren(EmptyState):
            empty += 1
            assert untold(state) == [], spec.key
    assert empty >= 5


def test_docks_and_dialogs_of_the_window(window: MainWindow) -> None:
    tools = window.tools
    window.show_palette()
    (palette,) = window.findChildren(Palette)
    for part in (
        window.job_line,
        window.job_line.sheet,
        window.log_dock,
        tools.verify(),
        tools.doctor(),
        tools.preferences(),
        tools.welcome(),
    ):
        assert untold(part) == [], part.windowTitle()
        part.hide()
    assert untold(palette) == []
    palette.close()
    window.jobs.close()


def test_other_dialogs(qtbot: QtBot, tmp_path: Path, window: MainWindow) -> None:
    made: list[QWidget] = [
        CrashDialog(tmp_path / "log.txt"),
        JobLogView(JobLog("work")),
        Manual(),
        Preferences(QSettings(str(tmp_path / "s.ini"), QSettings.Format.IniFormat)),
        RestoreDialog(UnsavedCopy(tmp_path / "copy.lfcal", ProjectState(), "", 0.0)),
        Welcome([], shown=True),
        ImportDialog(window.jobs),
    ]
    for dialog in made:
        qtbot.addWidget(dialog)
        name_controls(dialog)
        assert untold(dialog) == [], type(dialog).__name__


def test_a_tip_that_repeats_the_label_is_none(qtbot: QtBot) -> None:
    root = QTabWidget()
    qtbot.addWidget(root)
    button = QPushButton("Show frame")
    root.addTab(button, "Frame")
    button.setToolTip("Show frame")
    assert untold(root) == ["QPushButton 'Show frame': 'Show frame'", "tab 'Frame': ''"]
    root.setTabToolTip(0, "The frame as the camera gave it")
    button.setToolTip("See where the image lies")
    assert untold(root) == []
