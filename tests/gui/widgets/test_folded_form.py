"""Forms, typed into key by key: refused texts, folded fields, marks, units and layout."""

from __future__ import annotations

from typing import Any

import pytest
from PySide6.QtCore import QEvent, QObject, QPointF, Qt
from PySide6.QtGui import QEnterEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QComboBox, QLabel, QLineEdit, QToolButton
from pytestqt.qtbot import QtBot

from lfcal.tasks import PlanScan
from lfcal_gui.models import check_of, fields_of, options_in, shown_of
from lfcal_gui.models.form import Field
from lfcal_gui.widgets.folded_form import FoldedForm
from tests.gui.layout import flaws

FIELDS = (Field("f", "f-number"), Field("list", "Planes at v", kind="floats"), Field("auto", "Noise", optional=True))
BEFORE = {"f": 4.0, "list": (5.0, 4.0), "auto": None}


class Taking:
    """A page: it takes what a form reports, and shows it again."""

    def __init__(self, qtbot: QtBot, form: FoldedForm, values: dict[str, Any]) -> None:
        self.form, self.values, self.reported = form, dict(values), list[tuple[str, Any]]()
        qtbot.addWidget(form)
        form.set_values(self.values)
        form.edited.connect(self.take)

    def take(self, key: str, value: Any) -> None:
        self.values[key] = value
        self.reported.append((key, value))
        self.form.set_values(self.values)

    def type(self, key: str, text: str) -> QLineEdit:
        editor = self.form.editor(key)
        assert isinstance(editor, QLineEdit)
        editor.selectAll()
        QTest.keyClicks(editor, text)
        QTest.keyClick(editor, Qt.Key.Key_Return)
        return editor

    def button(self, name: str) -> QToolButton:
        (found,) = [one for one in self.form.findChildren(QToolButton) if one.accessibleName() == name]
        return found


@pytest.fixture
def page(qtbot: QtBot) -> Taking:
    return Taking(qtbot, FoldedForm(FIELDS), BEFORE)


def folded(qtbot: QtBot) -> Taking:
    """Return a page with 14 folded values."""
    more = tuple(Field(f"n{k}", f"Number {k}", "px", kind="int", default=k, group="Sizes") for k in range(13))
    choice = Field("way", "Way", kind="choice", choices=(("a", "fast"), ("b", "slow")), default="a", tip="How long")
    values = {"f": 4.0, "way": "a"} | {field.key: field.default for field in more}
    made = Taking(qtbot, FoldedForm(FIELDS[:1], (*more, choice)), values)
    made.form.show()
    return made


@pytest.fixture
def folding(qtbot: QtBot) -> Taking:
    return folded(qtbot)


def test_half_of_a_refused_text_is_not_taken(qtbot: QtBot) -> None:
    for key, text in (
        *(("f", "2,8"), ("f", "28x"), ("f", "1_00"), ("list", "3,5"), ("list", "2; 3,5"), ("auto", "2,5")),
    ):
        page = Taking(qtbot, FoldedForm(FIELDS), BEFORE)
        editor = page.type(key, text)
        assert page.values == BEFORE and page.reported, "the first digits were taken meanwhile"
        assert editor.text() == text and editor.property("invalid") and page.form.error
        # another field leaves it as it is, to be corrected
        page.type("list" if key == "f" else "f", "7")
        assert editor.text() == text and page.form.error and page.values[key] == BEFORE[key]
        page.type(key, "6")
        assert page.values[key] == ((6.0,) if key == "list" else 6.0) and not page.form.error


def test_a_text_that_is_typed_over_is_kept(page: Taking) -> None:
    """Within one field, half a number leads back to the value that was taken last."""
    editor = page.type("f", "3")
    editor.selectAll()
    QTest.keyClicks(editor, "5.6")
    editor.selectAll()
    QTest.keyClicks(editor, "8,2")
    assert page.values["f"] == 5.6 and page.form.error
    # replacing the point by a comma continues the edit, though the digits alone are a number
    editor.selectAll()
    QTest.keyClicks(editor, "60.5")
    QTest.keyClick(editor, Qt.Key.Key_Return)
    editor.setCursorPosition(3)
    QTest.keyClick(editor, Qt.Key.Key_Backspace)
    assert page.values["f"] == 605
    QTest.keyClicks(editor, ",")
    assert editor.text() == "60,5" and page.values["f"] == 60.5


def test_the_check_of_a_form_refuses_values(page: Taking) -> None:
    page.form.check = lambda key, value: "too large" if value == 28 else ""
    page.type("f", "28")
    assert page.values["f"] == 4 and page.form.error == "too large"
    assert [value for _, value in page.reported] == [2, 4]
    page.type("f", "3")
    page.type("f", "28")
    assert page.values["f"] == 3


def test_a_value_that_changes_elsewhere_is_shown(page: Taking) -> None:
    """By undo, for example."""
    editor = page.type("f", "2,8")
    page.form.set_values({**BEFORE, "f": 5.6})
    assert editor.text() == "5.6" and not page.form.error and not editor.property("invalid")
    # while it is typed, half a number leads back to the value that is shown
    QTest.keyClicks(editor, "8")
    page.form.set_values({**BEFORE, "f": 11.0})
    editor.setCursorPosition(2)
    QTest.keyClicks(editor, "2,")
    assert page.values["f"] == 11 and page.form.error


def test_a_text_with_the_same_value_is_kept(qtbot: QtBot) -> None:
    """Of planes "3, 4.0" the page shows "3, 4": it must not replace what is being typed."""
    form = FoldedForm(tuple(one for one in fields_of(PlanScan) if one.key == "virtual_depths"))
    qtbot.addWidget(form)
    form.check = check_of(PlanScan)

    def show(key: str, value: Any) -> None:
        shown = shown_of(PlanScan, options_in(PlanScan, {key: value}))
        form.set_values({"virtual_depths": shown["virtual_depths"]})

    form.edited.connect(show)
    editor = form.editor("virtual_depths")
    assert isinstance(editor, QLineEdit)
    QTest.keyClicks(editor, "3, 4.05")
    assert editor.text() == "3, 4.05" and not form.error


# -- folded fields -----------------------------------------------------------------------------------------
def test_the_row_of_a_fold_says_what_differs_and_resets_it(folding: Taking) -> None:
    form, head = folding.form, folding.form.head
    assert head.words == "defaults" and form.reset_all.isHidden() and not form.editor("n3").isVisible()
    QTest.keyClick(head, Qt.Key.Key_Space)
    assert form.editor("n3").isVisible() and form.search is not None and form.search.isVisible()
    for key in ("n3", "n5"):
        folding.type(key, "77")
    assert head.words == "2 changed" and head.accessibleName() == "More settings: 2 changed"
    assert form.editor("n3").property("changed") and not form.editor("n4").property("changed")
    reset = folding.button("Reset Number 3")
    assert form.editor("n3").nextInFocusChain() is reset, "the keyboard reaches it after its field"
    assert reset.toolTip() == "Reset to the default: 3 px"
    QTest.keyClick(reset, Qt.Key.Key_Space)
    assert folding.values["n3"] == 3 and head.words == "1 changed" and reset.isHidden()
    folding.take("way", "b")
    assert head.words == "2 changed" and folding.button("Reset Way").toolTip() == "Reset to the default: fast"
    QTest.keyClick(form.reset_all, Qt.Key.Key_Space)
    assert form.changed == () and head.words == "defaults" and folding.values["way"] == "a"


def test_a_changed_value_is_bold_and_its_button_appears_with_the_pointer(qtbot: QtBot) -> None:
    page = folded(qtbot)  # without the focus, which it has once events were processed
    form = page.form
    form.open()
    form.set_values({**page.values, "n3": 8})
    reset = page.button("Reset Number 3")
    assert form.changed == ("n3",) and not reset.isVisible() and not form.reset_all.isVisible()
    QApplication.sendEvent(form, QEnterEvent(QPointF(2, 2), QPointF(2, 2), QPointF(2, 2)))
    assert reset.isVisible()
    QApplication.sendEvent(form, QEvent(QEvent.Type.Leave))
    assert not reset.isVisible()


def test_a_default_that_is_refused_is_not_reported(folding: Taking) -> None:
    folding.take("n2", 9)
    folding.form.check = lambda key, value: "not while it records"
    folding.form.reset("n2")
    assert folding.form.error == "not while it records" and folding.values["n2"] == 9


def test_folded_values_are_searched(folding: Taking, qtbot: QtBot) -> None:
    form = folding.form
    form.open()
    assert form.search is not None
    QTest.keyClicks(form.search, "how LONG")
    assert form.editor("way").isVisible() and not form.editor("n3").isVisible()
    assert form.editor("f").isVisible(), "fields that are not folded stay"
    form.search.clear()
    assert form.editor("n3").isVisible()
    form.set_shown("n3", False)
    assert not form.editor("n3").isVisible() and form.editor("n4").isVisible()
    few = FoldedForm((), FIELDS)
    qtbot.addWidget(few)
    few.open()
    assert few.search is None


def test_folded_fields_are_made_when_they_are_needed(qtbot: QtBot) -> None:
    """Most are never seen, and made a third of the first look at a page."""
    more = tuple(Field(f"n{k}", f"Number {k}", "px", kind="int", default=k) for k in range(5))
    way = Field("way", "Way", kind="choice", choices=(("a", "fast"),), default="a", tip="How long")
    form = FoldedForm((Field("f", "f-number"),), (*more, way))
    qtbot.addWidget(form)
    form.show()
    form.set_values({"f": 4.0, "n0": 0, "n1": 7, "n2": 2, "n3": 3, "n4": 4, "way": "b"})
    form.set_choices("way", (("a", "fast"), ("b", "slow")))
    form.set_enabled("n2", False, "measured")
    form.set_marks({"n3": ("assumed", "typical")})
    form.own_line("n4")
    assert len(form.findChildren(QLineEdit)) == 1 and not form.findChildren(QComboBox)
    assert form.head.words == "2 changed, 1 assumed" and form.changed == ("n1", "way")
    assert form.editor("n1").text() == "7" and form.editor("n1").isHidden()
    form.open()
    box, label = form.editor("way"), form.editor("n4")
    assert box.currentText() == "slow" and box.isVisible() and box.property("changed") is True
    assert not form.editor("n2").isEnabled() and form.editor("n2").toolTip() == "measured"
    assert form.mark("n3").property("mark") == "assumed" and form.mark("n3").isVisible()
    assert label.width() > 1.2 * form.editor("n0").width(), "a long text has a separate line"
    order = [form.head, *(form.editor(f"n{k}") for k in range(4)), form.mark("n3"), label, box]
    places = []
    widget = form.head
    while len(places) < len(order):
        if widget in order:
            places.append(order.index(widget))
        widget = widget.nextInFocusChain()
    assert places == list(range(len(order))), "Tab follows the rows"


def test_unfolding_arranges_the_form_once(qtbot: QtBot) -> None:
    """Qt arranged the form again for every widget of a field that appeared."""
    more = tuple(Field(f"n{k}", f"Number {k}", "px", kind="int", default=k) for k in range(8))
    form = FoldedForm((Field("f", "f-number"),), more)
    qtbot.addWidget(form)
    form.show()
    form.open()
    form.head.setChecked(False)
    QApplication.processEvents()
    arranged: list[int] = []

    class Watch(QObject):
        def eventFilter(self, watched: QObject, event: QEvent) -> bool:
            arranged.append(1) if event.type() in (QEvent.Type.Resize, QEvent.Type.Move) else None
            return False

    watch = Watch()
    last = form.editor("n7")
    last.installEventFilter(watch)
    form.open()
    QApplication.processEvents()
    assert len(arranged) <= 2 and last.isVisible()


def test_assumed_values_are_confirmed_by_their_tick(qtbot: QtBot) -> None:
    form, reported = FoldedForm((), FIELDS, "All values"), list[str]()
    qtbot.addWidget(form)
    form.confirmed.connect(reported.append)
    form.set_state({"f": 4.0, "auto": None}, {"f": ("assumed", "typical"), "auto": ("measured", "in frames")})
    form.show()
    form.open()
    assert form.head.words == "1 assumed" and not form.editor("list").isVisible(), "a value that is not there"
    tick = form.mark("f")
    assert tick.accessibleName() == "f-number: assumed, confirm"
    assert form.editor("f").nextInFocusChain() is tick
    QTest.keyClick(tick, Qt.Key.Key_Space)
    assert reported == ["f"]
    form.set_marks({"f": ("stated", "")})
    assert form.head.words == "all known" and form.mark("f").focusPolicy() == Qt.FocusPolicy.NoFocus


# -- layout ------------------------------------------------------------------------------------------------


def test_labels_fields_and_units_have_common_edges(folding: Taking, qtbot: QtBot) -> None:
    form = folding.form
    folding.take("n2", 5)
    form.open()
    form.resize(300, 600)
    qtbot.waitUntil(lambda: form.editor("n3").width() < form.editor("f").width())
    editors = [form.editor(key) for key, field in form.fields.items() if field.unit]
    labels = [one for one in form.findChildren(QLabel) if one.buddy() is not None]
    units = [one for one in form.findChildren(QLabel) if one.text() == "px"]
    for edges in (map(QLabel.x, labels), map(QLabel.x, units), (one.geometry().right() for one in editors)):
        assert len(set(edges)) == 1
    assert len({one.x() for one in editors}) == 1
    assert all(one.x() > editors[0].geometry().right() for one in units)


def right_edges(qtbot: QtBot, *fields: Field) -> dict[str, int]:
    """Return where the fields of a form end (px)."""
    form = FoldedForm(fields)
    qtbot.addWidget(form)
    form.resize(260, 40 + 40 * len(fields))
    form.show()
    return {key: form.editor(key).geometry().right() for key in form.fields}


def test_fields_of_several_forms_end_at_one_edge(qtbot: QtBot) -> None:
    """Below each other, choices and numbers without a unit ended at three edges."""
    assert right_edges(qtbot, Field("f", "Value", "mm")) == right_edges(qtbot, Field("f", "Value", "s"))
    most = Field("most", "Positions", kind="int", default=1)
    choice = Field("order", "Order", kind="choice", choices=(("a", "a"), ("b", "b")))
    alone = right_edges(qtbot, most, choice)
    longer = right_edges(qtbot, most, choice, Field("time", "Time", "ms", kind="float"))
    assert len({*alone.values(), longer["most"], longer["order"]}) == 1


def test_long_texts_and_choices_have_room(qtbot: QtBot) -> None:
    """In a narrow column, "main lens" was cut next to units such as counts/e⁻."""
    form = FoldedForm((Field("f", "Focal length", "mm"), Field("cutout", "Cutout", "px"), Field("t", "Time", "s")))
    qtbot.addWidget(form)
    form.own_line("cutout")
    form.resize(260, 200)
    form.show()
    assert "Cutout (px)" in [one.text() for one in form.findChildren(QLabel)], "its label names the unit"
    edges = {key: form.editor(key).geometry() for key in form.fields}
    assert edges["cutout"].right() > edges["f"].right() and edges["cutout"].left() < edges["f"].left()
    gain = Field("gain", "Quantum efficiency", "counts/e⁻")
    narrow = FoldedForm((gain, Field("kind", "Optics", kind="choice", choices=(("main", "main lens"),))))
    qtbot.addWidget(narrow)
    narrow.set_values({"kind": "main", "gain": 0.25})
    narrow.resize(210, 100)
    narrow.show()
    assert not flaws(narrow)


# -- when values are reported ------------------------------------------------------------------------------


def test_a_late_field_reports_when_typing_ends(qtbot: QtBot) -> None:
    form, reported = FoldedForm((Field("name", "Name", kind="text", default="", late=True),)), list[Any]()
    qtbot.addWidget(form)
    form.edited.connect(lambda key, value: reported.append(value))
    form.set_values({"name": ""})
    editor = form.editor("name")
    QTest.keyClicks(editor, "z{z}")
    form.set_values({"name": ""})
    assert not reported and isinstance(editor, QLineEdit) and editor.text() == "z{z}", "the user still types"
    QTest.keyClick(editor, Qt.Key.Key_Return)
    QTest.keyClick(editor, Qt.Key.Key_Return)
    assert reported == ["z{z}"]


def test_a_long_number_is_rounded_until_it_has_the_keyboard(qtbot: QtBot) -> None:
    form = FoldedForm((Field("angle", "Iris rotation", unit="°"), Field("f", "f-number")))
    qtbot.addWidget(form)
    form.show()
    qtbot.waitExposed(form)
    form.activateWindow()
    reported: list[object] = []
    form.edited.connect(lambda key, value: reported.append(value))
    form.set_values({"angle": 11.459155902616466, "f": 4.0})
    angle, other = (form.editor(key) for key in ("angle", "f"))
    assert isinstance(angle, QLineEdit)
    assert angle.displayText() == "11.4592" and angle.text() == "11.4591559", "shown, and exact"
    qtbot.waitUntil(form.isActiveWindow)
    angle.setFocus()
    angle.selectAll()
    assert angle.displayText() == angle.selectedText() == "11.4591559", "what is copied"
    other.setFocus()
    assert angle.displayText() == "11.4592" and not reported, "no digit is lost on the way"
    angle.setFocus()
    angle.selectAll()
    QTest.keyClicks(angle, "12.3456789")
    other.setFocus()
    assert reported[-1] == 12.3456789 and angle.displayText() == "12.3457" and angle.text() == "12.3456789"
    form.set_values({"angle": 5.5, "f": 1e9})
    assert angle.text() == angle.displayText() == "5.5", "an undo left the exact text of the value before"
    assert other.displayText() == "1000000000"
