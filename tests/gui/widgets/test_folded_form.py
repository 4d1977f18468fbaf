"""Forms, typed into key by key."""

from __future__ import annotations

from typing import Any

import pytest
from PySide6.QtCore import QEvent, QPointF, Qt
from PySide6.QtGui import QEnterEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel, QLineEdit, QToolButton
from pytestqt.qtbot import QtBot

from lfcal.tasks import PlanScan
from lfcal_gui.models import check_of, fields_of, options_in, shown_of
from lfcal_gui.models.form import Field
from lfcal_gui.widgets.folded_form import FoldedForm
from tests.gui.layout import flaws

FIELDS = (Field("f", "f-number"), Field("list", "Planes at v", kind="floats"), Field("auto", "Noise", optional=True))
BEFORE = {"f": 4.0, "list": (5.0, 4.0), "auto": None}


class Kept:
    """A page: it takes what a form reports, and shows it as it stands."""

    def __init__(self, qtbot: QtBot) -> None:
        self.form, self.values, self.told = FoldedForm(FIELDS), dict[str, Any](BEFORE), list[Any]()
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
    """Of planes "3, 4.0" the page shows "3, 4": it must not replace what is being typed."""
    fields = fields_of(PlanScan)
    form = FoldedForm(tuple(one for one in fields if one.key == "virtual_depths"))
    qtbot.addWidget(form)
    form.check = check_of(PlanScan)
    form.edited.connect(lambda key, value: form.set_values(shown_as(options_in(PlanScan, {key: value}))))
    editor = form.editor("virtual_depths")
    assert isinstance(editor, QLineEdit)
    QTest.keyClicks(editor, "3, 4.05")
    assert editor.text() == "3, 4.05" and not form.error


class Folding:
    """A page with 14 folded values, which takes what is reported."""

    def __init__(self, qtbot: QtBot) -> None:
        more = tuple(Field(f"n{k}", f"Number {k}", "px", kind="int", default=k, group="Sizes") for k in range(13))
        choice = Field("way", "Way", kind="choice", choices=(("a", "fast"), ("b", "slow")), default="a", tip="How long")
        self.form, self.told = FoldedForm(FIELDS[:1], (*more, choice)), list[tuple[str, Any]]()
        self.values: dict[str, Any] = {"f": 4.0, "way": "a"} | {field.key: field.default for field in more}
        qtbot.addWidget(self.form)
        self.form.edited.connect(self.take)
        self.form.set_values(self.values)
        self.form.show()

    def take(self, key: str, value: Any) -> None:
        self.values[key] = value
        self.told.append((key, value))
        self.form.set_values(self.values)

    def button(self, name: str) -> QToolButton:
        (found,) = [one for one in self.form.findChildren(QToolButton) if one.accessibleName() == name]
        return found


def test_the_row_of_a_fold_says_what_differs_and_resets_it(qtbot: QtBot) -> None:
    page = Folding(qtbot)
    form, head = page.form, page.form.head
    assert head.words == "defaults" and form.reset_all.isHidden() and not form.editor("n3").isVisible()
    QTest.keyClick(head, Qt.Key.Key_Space)
    assert form.editor("n3").isVisible() and form.search is not None and form.search.isVisible()
    for key in ("n3", "n5"):
        editor = form.editor(key)
        assert isinstance(editor, QLineEdit)
        editor.selectAll()
        QTest.keyClicks(editor, "77")
    assert head.words == "2 changed" and head.accessibleName() == "More settings: 2 changed"
    assert form.editor("n3").property("changed") and not form.editor("n4").property("changed")
    reset = page.button("Reset Number 3")
    assert form.editor("n3").nextInFocusChain() is reset, "the keyboard reaches it after its field"
    assert reset.toolTip() == "Reset to the default: 3 px"
    QTest.keyClick(reset, Qt.Key.Key_Space)
    assert page.values["n3"] == 3 and head.words == "1 changed" and reset.isHidden()
    page.take("way", "b")
    assert head.words == "2 changed" and page.button("Reset Way").toolTip() == "Reset to the default: fast"
    QTest.keyClick(form.reset_all, Qt.Key.Key_Space)
    assert form.changed == () and head.words == "defaults" and page.values["way"] == "a"


def test_a_default_that_is_refused_now_stays_unreported(qtbot: QtBot) -> None:
    page = Folding(qtbot)
    page.take("n2", 9)
    page.form.check = lambda key, value: "not while it records"
    page.form.reset("n2")
    assert page.form.error == "not while it records" and page.values["n2"] == 9


def test_folded_values_are_searched(qtbot: QtBot) -> None:
    page = Folding(qtbot)
    form = page.form
    form.open()
    assert form.search is not None
    QTest.keyClicks(form.search, "how LONG")
    assert form.editor("way").isVisible() and not form.editor("n3").isVisible()
    assert form.editor("f").isVisible(), "what is in view stays"
    form.search.clear()
    assert form.editor("n3").isVisible()
    form.set_shown("n3", False)
    assert not form.editor("n3").isVisible() and form.editor("n4").isVisible()
    few = FoldedForm((), FIELDS)
    qtbot.addWidget(few)
    few.open()
    assert few.search is None


def test_assumed_values_are_confirmed_by_their_tick(qtbot: QtBot) -> None:
    form, told = FoldedForm((), FIELDS, "All values"), list[str]()
    qtbot.addWidget(form)
    form.confirmed.connect(told.append)
    form.set_state({"f": 4.0, "auto": None}, {"f": ("assumed", "typical"), "auto": ("measured", "in frames")})
    form.show()
    form.open()
    assert form.head.words == "1 assumed" and not form.editor("list").isVisible(), "a value that is not there"
    tick = form.mark("f")
    assert tick.accessibleName() == "f-number: assumed, confirm"
    assert form.editor("f").nextInFocusChain() is tick
    QTest.keyClick(tick, Qt.Key.Key_Space)
    assert told == ["f"]
    form.set_marks({"f": ("stated", "")})
    assert form.head.words == "all known" and form.mark("f").focusPolicy() == Qt.FocusPolicy.NoFocus


def test_labels_fields_and_units_have_their_edges(qtbot: QtBot) -> None:
    page = Folding(qtbot)
    form = page.form
    page.take("n2", 5)
    form.open()
    form.resize(300, 600)
    qtbot.waitUntil(lambda: form.editor("n3").width() < form.editor("f").width())
    editors = [form.editor(key) for key, field in form.fields.items() if field.unit]
    labels = [one for one in form.findChildren(QLabel) if one.buddy() is not None]
    units = [one for one in form.findChildren(QLabel) if one.text() == "px"]
    assert len({one.x() for one in labels}) == 1 and len({one.x() for one in units}) == 1
    assert len({one.geometry().right() for one in editors}) == 1 and len({one.x() for one in editors}) == 1
    assert all(one.x() > editors[0].geometry().right() for one in units)


def test_the_label_of_a_long_text_names_its_unit(qtbot: QtBot) -> None:
    form = FoldedForm((Field("f", "Focal length", "mm"), Field("cutout", "Cutout", "px"), Field("t", "Time", "s")))
    qtbot.addWidget(form)
    form.own_line("cutout")
    form.resize(260, 200)
    form.show()
    assert "Cutout (px)" in [one.text() for one in form.findChildren(QLabel)]
    edges = {key: form.editor(key).geometry() for key in form.fields}
    assert edges["cutout"].right() > edges["f"].right() and edges["cutout"].left() < edges["f"].left()


def test_fields_of_forms_with_units_end_at_one_edge(qtbot: QtBot) -> None:
    found = []
    for unit in ("mm", "s"):
        form = FoldedForm((Field("f", "Value", unit),))
        qtbot.addWidget(form)
        form.resize(260, 60)
        form.show()
        found.append(form.editor("f").geometry().right())
    assert found[0] == found[1]


def test_fields_with_and_without_units_end_at_one_edge(qtbot: QtBot) -> None:
    """Below each other, choices and numbers without a unit ended at three edges."""
    choice = Field("order", "Order", kind="choice", choices=(("a", "a"), ("b", "b")))
    edges = set()
    for others in ((), (Field("time", "Time", "ms", kind="float"),)):
        form = FoldedForm((Field("most", "Positions", kind="int", default=1), choice, *others))
        qtbot.addWidget(form)
        form.resize(260, 120)
        form.show()
        edges |= {form.editor(key).geometry().right() for key in ("most", "order")}
    assert len(edges) == 1


def test_the_words_of_a_choice_take_the_room_of_units(qtbot: QtBot) -> None:
    """In a narrow column, "main lens" was cut next to units such as counts/e⁻."""
    gain = Field("gain", "Quantum efficiency", "counts/e⁻")
    form = FoldedForm((gain, Field("kind", "Optics", kind="choice", choices=(("main", "main lens"),))))
    qtbot.addWidget(form)
    form.set_values({"kind": "main", "gain": 0.25})
    form.resize(210, 100)
    form.show()
    assert not flaws(form)


def test_a_late_field_reports_when_typing_ends(qtbot: QtBot) -> None:
    form, told = FoldedForm((Field("name", "Name", kind="text", default="", late=True),)), list[Any]()
    qtbot.addWidget(form)
    form.edited.connect(lambda key, value: told.append(value))
    form.set_values({"name": ""})
    editor = form.editor("name")
    QTest.keyClicks(editor, "z{z}")
    form.set_values({"name": ""})
    assert not told and isinstance(editor, QLineEdit) and editor.text() == "z{z}", "it is still typed"
    QTest.keyClick(editor, Qt.Key.Key_Return)
    QTest.keyClick(editor, Qt.Key.Key_Return)
    assert told == ["z{z}"]


def shown_as(values: dict[str, Any]) -> dict[str, Any]:
    shown = shown_of(PlanScan, values)
    return {"virtual_depths": shown["virtual_depths"]}


def test_resets_are_shown_while_one_is_in_the_form(qtbot: QtBot) -> None:
    """At first sight a changed value is bold, and nothing more."""
    page = Folding(qtbot)
    form = page.form
    form.open()
    form.set_values({**page.values, "n3": 8})
    reset = page.button("Reset Number 3")
    assert form.changed == ("n3",) and not reset.isVisible() and not form.reset_all.isVisible()
    QApplication.sendEvent(form, QEnterEvent(QPointF(2, 2), QPointF(2, 2), QPointF(2, 2)))
    assert reset.isVisible()
    QApplication.sendEvent(form, QEvent(QEvent.Type.Leave))
    assert not reset.isVisible()


def test_a_long_number_is_rounded_until_it_has_the_keyboard(qtbot: QtBot) -> None:
    form = FoldedForm((Field("angle", "Iris rotation", unit="°"), Field("f", "f-number")))
    qtbot.addWidget(form)
    form.show()
    qtbot.waitExposed(form)
    form.activateWindow()
    told: list[object] = []
    form.edited.connect(lambda key, value: told.append(value))
    form.set_values({"angle": 11.459155902616466, "f": 4.0})
    angle, other = (form.editor(key) for key in ("angle", "f"))
    assert isinstance(angle, QLineEdit)
    assert angle.displayText() == "11.4592" and angle.text() == "11.4591559", "seen, and exact"
    qtbot.waitUntil(form.isActiveWindow)
    angle.setFocus()
    angle.selectAll()
    assert angle.displayText() == angle.selectedText() == "11.4591559", "what is copied"
    other.setFocus()
    assert angle.displayText() == "11.4592" and not told, "no digit is lost on the way"
    angle.setFocus()
    angle.selectAll()
    QTest.keyClicks(angle, "12.3456789")
    other.setFocus()
    assert told[-1] == 12.3456789 and angle.displayText() == "12.3457" and angle.text() == "12.3456789"
    form.set_values({"angle": 5.5, "f": 1e9})
    assert angle.text() == angle.displayText() == "5.5", "an undo left the exact text of the value before"
    assert other.displayText() == "1000000000"
