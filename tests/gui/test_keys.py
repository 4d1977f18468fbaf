"""Every key of the window does what the sheet of keys says, and a typed letter stays a letter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from PySide6.QtGui import QKeySequence
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLineEdit, QWidget
from pytestqt.qtbot import QtBot

from lfcal.psf import PSFMatrix
from lfcal_gui._help import cheat_sheet
from lfcal_gui.palette import Palette
from lfcal_gui.widgets import INSPECTOR, Contrast
from lfcal_gui.widgets.enlarging import enlarged_of
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


def test_the_sheet_has_all_keys(window: MainWindow) -> None:
    sheet = cheat_sheet(window.specs)
    for keys in ("Ctrl+K", "F or Ctrl+E", "A", "Ctrl+I", "Ctrl+J", "T", "D", "L, G", "Space", "Esc", "Ctrl+Return"):
        assert f"<b>{keys}</b>" in sheet or f"<b>{keys}," in sheet, keys
