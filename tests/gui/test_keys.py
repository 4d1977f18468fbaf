"""Every key of the window does what the sheet of keys says, and a typed letter stays a letter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QAbstractButton, QApplication, QLineEdit, QWidget
from pytestqt.qtbot import QtBot

from lfcal.psf import PSFMatrix
from lfcal_gui._help import cheat_sheet
from lfcal_gui.models import Field, available_pages
from lfcal_gui.palette import Palette
from lfcal_gui.widgets import INSPECTOR, Contrast, CostCurve, FoldedForm
from lfcal_gui.widgets.enlarging import enlarged_of
from lfcal_gui.widgets.naming import controls
from lfcal_gui.window import MainWindow
from tests.gui.waiting import GUARD_MS, idle

SHAPE = (3, 4, 5, 9, 11)


def press(keys: str, widget: QWidget) -> None:
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
    window.go("h")
    page: Any = window.page("h")
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


@pytest.mark.parametrize(("keys", "look", "seen"), STEPS, ids=[keys for keys, _, _ in STEPS])
def test_keys_of_h(psf: Any, qtbot: QtBot, keys: str, look: Callable[[Any], Any], seen: tuple[Any, ...]) -> None:
    assert look(psf) == seen[0]
    for wanted in seen[1:]:
        press(keys, psf)
        assert look(psf) == wanted
    idle(psf.context.jobs, qtbot)


def test_f_shows_a_picture_alone(psf: Any, qtbot: QtBot) -> None:
    press("F", psf)
    alone = [one for one in (psf.panel.main_view, psf.panel.linked_view) if enlarged_of(one) is not None]
    assert len(alone) == 1
    holder = enlarged_of(alone[0])
    assert holder is not None
    press("Esc", holder)
    assert enlarged_of(alone[0]) is None
    press("F", psf)
    press("F", psf)
    assert enlarged_of(alone[0]) is None


def test_a_makes_the_contrast_automatic(psf: Any, qtbot: QtBot) -> None:
    contrast: Contrast = psf.panel.contrast
    low, high = contrast.levels
    contrast.set_levels((low, low + (high - low) / 2))
    press("A", psf)
    assert contrast.levels[1] > low + 0.6 * (high - low)


@pytest.mark.parametrize("page", ["setup", "frames", "simulate", "h", "reconstruct", "acquire"])
def test_ctrl_i_hides_the_inspector(window: MainWindow, page: str) -> None:
    window.go(page)
    shown = window.page(page)
    areas = [one for one in shown.findChildren(QWidget) if one.property(INSPECTOR)]
    assert areas
    press("Ctrl+I", shown)
    assert all(one.isHidden() for one in areas)
    press("Ctrl+I", shown)
    assert not any(one.isHidden() for one in areas)


@pytest.mark.parametrize("keys", ["Ctrl+K", "Ctrl+Shift+P"])
def test_the_palette(window: MainWindow, keys: str) -> None:
    press(keys, window)
    (palette,) = window.findChildren(Palette)
    palette.close()


def test_ctrl_j_lists_the_jobs(window: MainWindow) -> None:
    press("Ctrl+J", window)
    assert window.job_line.sheet.isVisible()
    press("Ctrl+J", window)
    assert window.job_line.sheet.isHidden()


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_ctrl_and_a_number_go_to_a_place(window: MainWindow, number: int) -> None:
    press(f"Ctrl+{number}", window)
    assert window.shown.spec.place == ("setup", "record", "h", "use")[number - 1]


def test_a_letter_that_is_typed_is_no_key(psf: Any, qtbot: QtBot) -> None:
    edit = QLineEdit(psf)
    edit.show()
    edit.setFocus()
    qtbot.waitUntil(lambda: QApplication.focusWidget() is edit, timeout=GUARD_MS)
    before = psf.intent
    for key in "tdlaf":
        press(key.upper(), edit)
    assert edit.text() == "tdlaf" and psf.intent == before and enlarged_of(psf.panel.main_view) is None


def test_tab_still_goes_from_field_to_field(window: MainWindow, qtbot: QtBot) -> None:
    window.go("setup")
    press("Tab", window.shown)
    first = QApplication.focusWidget()
    assert first is not None
    press("Tab", first)
    assert QApplication.focusWidget() not in (None, first)


def tab_stops(root: QWidget) -> list[QWidget]:
    """Return what has the keyboard in turn, from one press of Tab to the next, until it comes back."""
    root.activateWindow()
    found: list[QWidget] = []
    for _ in range(300):
        QTest.keyClick(QApplication.focusWidget() or root, Qt.Key.Key_Tab)
        now = QApplication.focusWidget()
        if now is None or now in found:
            break
        found.append(now)
    return found


def is_reached(control: QWidget, stops: list[QWidget]) -> bool:
    """Return whether a control or a part of it is a stop, or whether keys of its group or its field reach it."""
    parent, parts = control.parentWidget(), (control, *control.findChildren(QWidget))
    group = control.group() if isinstance(control, QAbstractButton) else None
    if isinstance(parent, QLineEdit):
        return parent in stops and any(not one.shortcut().isEmpty() for one in parent.actions())
    if isinstance(parent, CostCurve):
        return parent in stops
    in_group = group is not None and group.exclusive() and any(one in stops for one in group.buttons())
    if isinstance(control, QAbstractButton) and control.autoExclusive() and parent is not None:
        in_group = any(one in stops for one in parent.findChildren(QAbstractButton))
    return in_group or any(one in stops for one in parts)


@pytest.mark.parametrize("key", [spec.key for spec in available_pages()])
def test_tab_reaches_every_control_of_a_page_by_a_name(window: MainWindow, psf: Any, qtbot: QtBot, key: str) -> None:
    window.go("setup")
    setup: Any = window.page("setup")
    setup.make_default()
    window.go(key)
    page = window.page(key)
    for fold in page.findChildren(QAbstractButton):
        if fold.property("role") == "fold" and fold.isVisible() and not fold.isChecked():
            fold.click()
    idle(window.jobs, qtbot)
    stops = tab_stops(page.window())
    assert len(stops) < 300
    missed = [one for one in controls(page) if one.isVisible() and one.isEnabled() and not is_reached(one, stops)]
    assert not [(type(one).__name__, one.accessibleName() or one.toolTip()) for one in missed]
    silent = [one for one in stops if not one.accessibleName() and not getattr(one, "text", str)()]
    assert not [(type(one).__name__, type(one.parentWidget()).__name__) for one in silent]


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


def test_the_sheet_has_all_keys(window: MainWindow) -> None:
    sheet = cheat_sheet(window.specs)
    for keys in ("Ctrl+K", "F or Ctrl+E", "A", "Ctrl+I", "Ctrl+J", "T", "D", "L, G", "Space", "Esc", "Ctrl+Return"):
        assert f"<b>{keys}</b>" in sheet or f"<b>{keys}," in sheet, keys
