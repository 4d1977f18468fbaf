"""Controls: every key does what the list of keys says, and every control has a name, a tooltip and a tab stop."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyqtgraph as pg
import pytest
from PySide6 import QtWidgets as qt
from PySide6.QtCore import QSettings, Qt
from PySide6.QtGui import QKeySequence
from PySide6.QtTest import QTest
from pytestqt.qtbot import QtBot

from lfcal.psf import PSFMatrix
from lfcal_gui._help import Manual, cheat_sheet
from lfcal_gui._rescue import RestoreDialog
from lfcal_gui._welcome import Welcome
from lfcal_gui.base_page import EmptyState
from lfcal_gui.crash_dialog import CrashDialog
from lfcal_gui.job_panel import JobLogView
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import Field
from lfcal_gui.models.autosave import UnsavedCopy
from lfcal_gui.models.job import JobLog
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.frames._import_dialog import ImportDialog
from lfcal_gui.pages.h.panel import LEVELS
from lfcal_gui.palette import Palette
from lfcal_gui.preferences import Preferences
from lfcal_gui.widgets import INSPECTOR, Contrast, CostCurve, FoldedForm
from lfcal_gui.widgets.enlarging import enlarged_of
from lfcal_gui.widgets.naming import controls, name_controls, unnamed
from lfcal_gui.widgets.plots import LinePlot
from lfcal_gui.window import MainWindow
from tests.gui.waiting import GUARD_MS, go, idle, page_of

SHAPE = (3, 4, 5, 9, 11)


def press(keys: str, widget: qt.QWidget) -> None:
    """Press keys as the user does: once, in whatever has the keyboard."""
    combination: Any = QKeySequence(keys)[0]  # type: ignore[index]
    QTest.keyClick(widget, combination.key(), combination.keyboardModifiers())


@pytest.fixture
def psf(window: MainWindow, qtbot: QtBot) -> Any:
    """Return the page with an H and a reference, with the keyboard in it."""
    values = np.random.default_rng(3).random(SHAPE, np.float32)
    for name in ("H", "before"):
        window.context.matrices.put(name, PSFMatrix(values + (name == "H")))
    window.project.update("open", psf="H", reference="before")
    page = go(window, "h")
    qtbot.waitUntil(lambda: page.plane is not None and page.reference_plane is not None, timeout=GUARD_MS)
    return page


def views(page: Any) -> tuple[str, bool]:
    return page.intent.view, page.intent.transposed


STEPS: tuple[tuple[str, Callable[[Any], Any], tuple[Any, ...]], ...] = (
    ("T", views, (("both", False), ("one", True), ("one", False), ("both", False))),
    ("D", lambda page: page.intent.view, ("both", "difference", "both")),
    ("L", lambda page: page.intent.display.scale, ("linear", "log", "linear")),
    ("G", lambda page: page.intent.display.scale, ("linear", "gamma", "linear")),
    ("Left", lambda page: page.intent.x, (2, 1, 0, 4)),
    ("Right", lambda page: page.intent.x, (2, 3, 4, 0)),
    ("Up", lambda page: page.intent.y, (2, 1, 0, 3)),
    ("Down", lambda page: page.intent.y, (2, 3, 0, 1)),
    ("PgUp", lambda page: page.intent.z, (1, 0, 0)),
    ("PgDown", lambda page: page.intent.z, (1, 2, 2)),
)


def test_keys_of_h(psf: Any, qtbot: QtBot) -> None:
    for keys, look, (before, *after) in STEPS:
        psf.set_intent(z=1, y=2, x=2)
        assert look(psf) == before, keys
        for wanted in after:
            press(keys, psf)
            assert look(psf) == wanted, keys
    idle(psf.context.jobs, qtbot)


def test_keys_of_pictures_and_typed_letters(psf: Any, qtbot: QtBot) -> None:
    """F enlarges a picture, A makes the contrast automatic; a letter that is typed into a field does neither."""
    press("F", psf)
    (alone,) = [one for one in (psf.panel.main_view, psf.panel.linked_view) if enlarged_of(one) is not None]
    press("Esc", enlarged_of(alone))
    assert enlarged_of(alone) is None
    press("F", psf)
    press("F", psf)
    assert enlarged_of(alone) is None
    contrast: Contrast = psf.panel.contrast
    low, high = contrast.levels
    contrast.set_levels((low, low + (high - low) / 2))
    press("A", psf)
    assert contrast.levels[1] > low + 0.6 * (high - low)
    edit = qt.QLineEdit(psf)
    edit.show()
    edit.setFocus()
    qtbot.waitUntil(lambda: qt.QApplication.focusWidget() is edit, timeout=GUARD_MS)
    before = psf.intent
    for key in "tdlaf":
        press(key.upper(), edit)
    assert edit.text() == "tdlaf" and psf.intent == before and enlarged_of(psf.panel.main_view) is None


def test_keys_of_the_window(window: MainWindow) -> None:
    for number, place in enumerate(("setup", "record", "h", "use"), 1):
        press(f"Ctrl+{number}", window)
        assert window.shown.spec.place == place
    for hidden in (False, True):
        press("Ctrl+J", window)
        assert window.job_line.sheet.isHidden() == hidden
    for keys in ("Ctrl+K", "Ctrl+Shift+P"):
        press(keys, window)
        (palette,) = (one for one in window.findChildren(Palette) if one.isVisible())
        palette.close()
    for page in ("setup", "frames", "simulate", "h", "reconstruct", "acquire"):
        window.go(page)
        shown = window.page(page)
        areas = [one for one in shown.findChildren(qt.QWidget) if one.property(INSPECTOR)]
        assert areas
        for hidden in (True, False):
            press("Ctrl+I", shown)
            assert all(one.isHidden() == hidden for one in areas), page


def test_the_list_of_keys_has_all_keys(window: MainWindow) -> None:
    sheet = cheat_sheet(window.specs)
    for keys in ("Ctrl+K", "F or Ctrl+E", "A", "Ctrl+I", "Ctrl+J", "T", "D", "L, G", "Space", "Esc", "Ctrl+Return"):
        assert f"<b>{keys}</b>" in sheet or f"<b>{keys}," in sheet, keys


def test_alt_down_chooses_the_file_of_a_field(qtbot: QtBot) -> None:
    asked: list[str] = []
    form = FoldedForm((Field("white", "White image", kind="text", file="All files (*)"),), (), "More", "")
    qtbot.addWidget(form)
    form._browse = lambda key, edit: asked.append(key)  # type: ignore[method-assign]
    form.show()
    editor = form.editor("white")
    editor.setFocus()
    qtbot.waitUntil(editor.hasFocus, timeout=GUARD_MS)
    press("Alt+Down", editor)
    assert asked == ["white"]


# -- tab stops ---------------------------------------------------------------------------------------------


def tab_stops(root: qt.QWidget) -> list[qt.QWidget]:
    """Return the widgets that Tab reaches, in turn."""
    root.activateWindow()
    found: list[qt.QWidget] = []
    for _ in range(300):
        QTest.keyClick(qt.QApplication.focusWidget() or root, Qt.Key.Key_Tab)
        now = qt.QApplication.focusWidget()
        if now is None or now in found:
            break
        found.append(now)
    return found


def is_reached(control: qt.QWidget, stops: list[qt.QWidget]) -> bool:
    """Return whether a control or a part of it is a stop, or whether its group or field is one."""
    parent, parts = control.parentWidget(), (control, *control.findChildren(qt.QWidget))
    group = control.group() if isinstance(control, qt.QAbstractButton) else None
    if isinstance(parent, qt.QLineEdit):
        return parent in stops and any(not one.shortcut().isEmpty() for one in parent.actions())
    if isinstance(parent, CostCurve):
        return parent in stops
    in_group = group is not None and group.exclusive() and any(one in stops for one in group.buttons())
    if isinstance(control, qt.QAbstractButton) and control.autoExclusive() and parent is not None:
        in_group = any(one in stops for one in parent.findChildren(qt.QAbstractButton))
    return in_group or any(one in stops for one in parts)


def test_tab_reaches_every_control_of_a_page_by_a_name(window: MainWindow, psf: Any, qtbot: QtBot) -> None:
    setup = go(window, "setup")
    setup.make_default()
    for spec in window.specs:
        window.go(spec.key)
        page = window.page(spec.key)
        for fold in page.findChildren(qt.QAbstractButton):
            if fold.property("role") == "fold" and fold.isVisible() and not fold.isChecked():
                fold.click()
        idle(window.jobs, qtbot)
        page.window().activateWindow()
        qtbot.waitUntil(page.window().isActiveWindow, timeout=GUARD_MS)
        stops = tab_stops(page.window())
        assert 1 < len(stops) < 300
        missed = [one for one in controls(page) if one.isVisible() and one.isEnabled() and not is_reached(one, stops)]
        assert not [(spec.key, type(one).__name__, one.accessibleName() or one.toolTip()) for one in missed]
        silent = [one for one in stops if not one.accessibleName() and not getattr(one, "text", str)()]
        assert not [(spec.key, type(one).__name__, type(one.parentWidget()).__name__) for one in silent]


# -- names and tooltips ------------------------------------------------------------------------------------
COMMON = {"Close", "Cancel"}
"""Buttons of every dialog; their tooltips may be the same."""


def words(text: str) -> list[str]:
    return re.findall(r"[^\W_]+", text.lower())


def label(control: qt.QWidget) -> str:
    text = control.text() if isinstance(control, qt.QAbstractButton) else ""
    return text or control.accessibleName()


def repeats(tip: str, name: str) -> bool:
    """Return whether a tooltip repeats the label; a name that was taken from the tooltip is no label."""
    return set(words(tip)) <= set(words(name)) and not (name and tip.startswith(name) and len(words(name)) > 3)


def unexplained(root: qt.QWidget) -> list[str]:
    """Return the controls and tabs in ``root`` whose tooltip is missing or repeats their label."""
    found_tips = [
        (type(one).__name__, label(one), one.toolTip())
        for one in controls(root)
        if not isinstance(one, pg.GraphicsView)
    ]
    for bar in root.findChildren(qt.QTabBar):
        found_tips += [("tab", bar.tabText(k), bar.tabToolTip(k)) for k in range(bar.count())]
    return [
        f"{kind} {name!r}: {tip!r}"
        for kind, name, tip in found_tips
        if not words(tip) or not name or repeats(tip, name)
    ]


def shared(root: qt.QWidget) -> list[str]:
    """Return the tooltips that several controls in ``root`` share."""
    kinds = (qt.QPushButton, qt.QCheckBox, qt.QComboBox, qt.QLineEdit)
    # an empty page offers again what a button of its head does
    found = [one for one in controls(root) if isinstance(one, kinds) and not isinstance(one.parent(), EmptyState)]
    seen = {(label(one), one.toolTip()) for one in found}
    return [tip for tip, count in Counter(tip for name, tip in seen if name not in COMMON).items() if count > 1]


def test_every_control_of_the_window_has_a_name_and_its_own_tooltip(window: MainWindow, qtbot: QtBot) -> None:
    count = empty = 0
    for spec in window.specs:
        window.go(spec.key)
        idle(window.jobs, qtbot)
        page = page_of(window, spec.key)
        if spec.key == "h":  # levels are made when they are looked at
            for level in LEVELS:
                page.look_into(level)
            assert page.fitting.view.rounds and page.panel.fitted
        assert unexplained(page) == [] and shared(page) == [], spec.key
        assert [(type(one).__name__, one.toolTip()) for one in unnamed(page)] == [], spec.key
        count += len(controls(page))
        empty += len(page.findChildren(EmptyState))
    assert count > 300 and empty >= 5, "pages without data are looked at as well"
    tools = window.tools
    window.show_palette()
    (palette,) = window.findChildren(Palette)
    dialogs = (palette, tools.verify(), tools.doctor(), tools.preferences(), tools.welcome())
    for part in (*dialogs, window.job_line, window.job_line.sheet, window.log_dock):
        assert unexplained(part) == [] and unnamed(part) == [], part.windowTitle()
        part.hide()
    window.jobs.close()


def test_every_control_of_other_dialogs_has_a_tooltip(qtbot: QtBot, tmp_path: Path, jobs: Jobs) -> None:
    made: list[qt.QWidget] = [
        CrashDialog(tmp_path / "log.txt"),
        JobLogView(JobLog("work")),
        Manual(),
        Preferences(QSettings(str(tmp_path / "s.ini"), QSettings.Format.IniFormat)),
        RestoreDialog(UnsavedCopy(tmp_path / "copy.lfcal", ProjectState(), "", 0.0)),
        Welcome([], shown=True),
        ImportDialog(jobs),
    ]
    for dialog in made:
        qtbot.addWidget(dialog)
        name_controls(dialog)
        assert unexplained(dialog) == [], type(dialog).__name__


def test_a_tooltip_that_repeats_the_label_is_found(qtbot: QtBot) -> None:
    root = qt.QTabWidget()
    qtbot.addWidget(root)
    button = qt.QPushButton("Show frame")
    root.addTab(button, "Frame")
    button.setToolTip("Show frame")
    assert unexplained(root) == ["QPushButton 'Show frame': 'Show frame'", "tab 'Frame': ''"]
    root.setTabToolTip(0, "The frame as the camera gave it")
    button.setToolTip("See where the image lies")
    assert unexplained(root) == []


def test_names_come_from_label_tooltip_axes_and_placeholder(qtbot: QtBot) -> None:
    root = qt.QWidget()
    qtbot.addWidget(root)
    form = qt.QFormLayout(root)
    number, box, line, slider, plot = (
        qt.QSpinBox(),
        qt.QComboBox(),
        qt.QLineEdit(),
        qt.QSlider(),
        LinePlot("x (px)", "y (counts)"),
    )
    box.setToolTip("How intensity becomes colour; log shows four decades")
    line.setPlaceholderText("folder")
    form.addRow("Threads", number)
    for widget in (box, line, slider, plot):
        form.addRow(widget)
    assert slider in unnamed(root) and number in unnamed(root)
    name_controls(root)
    assert number.accessibleName() == "Threads" and box.accessibleName() == "How intensity becomes colour"
    assert line.accessibleName() == "folder"
    (graphics,) = plot.findChildren(pg.GraphicsView)
    assert graphics.accessibleName() == "y (counts) over x (px)"
    assert unnamed(root) == [slider]
