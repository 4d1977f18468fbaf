"""Forms, typed into key by key."""

from __future__ import annotations

from typing import Any

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QLineEdit
from pytestqt.qtbot import QtBot

from lfcal.tasks import PlanScan
from lfcal_gui.models import check_of, fields_of, options_in, shown_of
from lfcal_gui.models.form import Field
from lfcal_gui.widgets.form import Form

FIELDS = (Field("f", "f-number"), Field("list", "Planes at v", kind="floats"), Field("auto", "Noise", optional=True))
BEFORE = {"f": 4.0, "list": (5.0, 4.0), "auto": None}


class Kept:
    """A page: it takes what a form reports, and shows it as it stands."""

    def __init__(self, qtbot: QtBot) -> None:
        self.form, self.values, self.told = Form(FIELDS), dict[str, Any](BEFORE), list[Any]()
        qtbot.addWidget(self.form)
        self.form.set_values(self.values)
        self.form.edited.connect(self.take)

    def take(self, key: str, value: Any) -> None:
        self.values[key] = value
        self.told.append(value)
        self.form.set_values(self.values)

    def type(self, key: str, text: str) -> QLineEdit:
        editor = self.form.editor(key)
        assert isinstance(editor, QLineEdit)
        editor.selectAll()
        QTest.keyClicks(editor, text)
        QTest.keyClick(editor, Qt.Key.Key_Return)
        return editor


@pytest.fixture
def page(qtbot: QtBot) -> Kept:
    return Kept(qtbot)


@pytest.mark.parametrize(
    ("key", "text"), [("f", "2,8"), ("f", "28x"), ("f", "1_00"), ("list", "3,5"), ("list", "2; 3,5"), ("auto", "2,5")]
)
def test_half_of_what_is_refused_is_not_taken(page: Kept, key: str, text: str) -> None:
    editor = page.type(key, text)
    assert page.values == BEFORE and page.told, "what was typed first did pass"
    assert editor.text() == text and editor.property("invalid") and page.form.error
    # another field leaves it as it is, to be corrected
    page.type("list" if key == "f" else "f", "7")
    assert editor.text() == text and page.form.error and page.values[key] == BEFORE[key]
    page.type(key, "6")
    assert page.values[key] == ((6.0,) if key == "list" else 6.0) and not page.form.error


def test_a_text_that_is_typed_over_stands(page: Kept) -> None:
    """Without leaving the field: what was typed before was taken, and is what half a number leads back to."""
    editor = page.type("f", "3")
    editor.selectAll()
    QTest.keyClicks(editor, "5.6")
    editor.selectAll()
    QTest.keyClicks(editor, "8,2")
    assert page.values["f"] == 5.6 and page.form.error
    # a point that is made a comma is no new beginning, though its digits alone are a number
    editor.selectAll()
    QTest.keyClicks(editor, "60.5")
    QTest.keyClick(editor, Qt.Key.Key_Return)
    editor.setCursorPosition(3)
    QTest.keyClick(editor, Qt.Key.Key_Backspace)
    assert page.values["f"] == 605
    QTest.keyClicks(editor, ",")
    assert editor.text() == "60,5" and page.values["f"] == 60.5


def test_what_is_checked_is_held_to_as_well(page: Kept) -> None:
    page.form.check = lambda key, value: "too large" if value == 28 else ""
    page.type("f", "28")
    assert page.values["f"] == 4 and page.form.error == "too large" and page.told == [2, 4]
    page.type("f", "3")
    page.type("f", "28")
    assert page.values["f"] == 3


def test_what_becomes_another_value_elsewhere_is_shown(page: Kept) -> None:
    """By undo, for example."""
    editor = page.type("f", "2,8")
    page.form.set_values({**BEFORE, "f": 5.6})
    assert editor.text() == "5.6" and not page.form.error and not editor.property("invalid")
    # in the midst of typing: half a number leads back to what is shown, not to what was before it
    QTest.keyClicks(editor, "8")
    page.form.set_values({**BEFORE, "f": 11.0})
    editor.setCursorPosition(2)
    QTest.keyClicks(editor, "2,")
    assert page.values["f"] == 11 and page.form.error


def test_a_text_that_says_the_same_in_other_words_stands(qtbot: QtBot) -> None:
    """Of planes "3, 4.0" the page shows "3,4": it must not replace what is being typed."""
    fields = fields_of(PlanScan)
    form = Form(tuple(one for one in fields if one.key == "virtual_depths"))
    qtbot.addWidget(form)
    form.check = check_of(PlanScan)
    form.edited.connect(lambda key, value: form.set_values(shown_as(options_in(PlanScan, {key: value}))))
    editor = form.editor("virtual_depths")
    assert isinstance(editor, QLineEdit)
    QTest.keyClicks(editor, "3, 4.05")
    assert editor.text() == "3, 4.05" and not form.error


def shown_as(values: dict[str, Any]) -> dict[str, Any]:
    shown = shown_of(PlanScan, values)
    return {"virtual_depths": shown["virtual_depths"]}
