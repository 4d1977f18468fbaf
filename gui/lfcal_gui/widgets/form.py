"""Forms with units, ranges and validation as you type."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QWidget,
)

from lfcal.base import InputError
from lfcal_gui.models import Field, parse, text_of
from lfcal_gui.widgets.words import set_look

__all__ = ["Form"]

SHORTEST = 5
"""Letters of a choice that are seen in any case."""

MARKS = {"stated": "✓", "assumed": "<a href='confirm'>assumed</a>"}
"""What is shown for words of marks: a tick, and what can be clicked."""

_UNKNOWN = object()


class Form(QWidget):
    """A column of fields.

    With ``marked`` there is room for a word beside each field (`set_marks`). A ``dense`` form is low: for many fields.

    A value that does not parse, or that ``check`` refuses, is marked red with the reason under the form; only
    values that pass are reported. Where what was typed first did pass, as the 2 of "2,8", the value from before the
    field was touched is reported again, and the refused text stays until the value becomes another one. Of several
    reasons that of the field touched last is shown; a field that is disabled shows its value again, and has none.

    Signals
    -------
    edited(key, value)
        The user changed a value, and it passes.
    confirmed(key)
        The user says that a value is right of which a mark says that it is assumed.
    """

    edited = Signal(str, object)
    confirmed = Signal(str)

    def __init__(
        self, fields: tuple[Field, ...], parent: QWidget | None = None, *, marked: bool = False, dense: bool = False
    ) -> None:
        super().__init__(parent)
        self.setProperty("dense", dense)
        self._marked = marked
        self._labels: dict[str, QLabel] = {}
        self._mark_labels: dict[str, QLabel] = {}
        self.fields = {f.key: f for f in fields}
        self.check: Callable[[str, Any], str] = lambda key, value: ""
        self._editors: dict[str, QWidget] = {}
        # what each field stands for, and what it stood for before it was typed in
        self._values: dict[str, Any] = {}
        self._untouched: dict[str, Any] = {}
        self._selected: dict[str, str] = {}
        self._reported = self._last = ""
        self._layout = QFormLayout(self)
        self._layout.setContentsMargins(0, 0, 0, 0)
        self._layout.setHorizontalSpacing(6 if dense else 10)
        self._layout.setVerticalSpacing(2 if dense else 6)
        self._layout.setLabelAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        self._layout.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        for field in fields:
            self._add(field)
        self._error = QLabel("")
        self._error.setProperty("role", "error")
        self._error.setWordWrap(True)
        self._error.hide()
        self._layout.addRow(self._error)

    def _add(self, field: Field) -> None:
        label = QLabel(f"{field.label} ({field.unit})" if field.unit else field.label)
        editor: QWidget
        if field.kind == "choice":
            editor = QComboBox()
            for value, text in field.choices:
                editor.addItem(text, value)
            if self._marked:  # a narrow column
                editor.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
                editor.setMinimumContentsLength(SHORTEST)
            editor.currentIndexChanged.connect(lambda _=0, key=field.key: self._changed(key))
        elif field.kind == "bool":
            editor = QCheckBox()
            editor.toggled.connect(lambda _=False, key=field.key: self._changed(key))
        elif field.kind == "shown":
            editor = QLabel()
            editor.setWordWrap(True)
        else:
            editor = QLineEdit()
            editor.setPlaceholderText(field.empty)
            editor.setMinimumWidth(60 if self._marked else 80)
            editor.textEdited.connect(lambda _="", key=field.key: self._changed(key))
            editor.editingFinished.connect(lambda key=field.key: self._untouched.pop(key, None))
            editor.selectionChanged.connect(lambda key=field.key, editor=editor: self._select(key, editor))
        for widget in (label, editor):
            widget.setToolTip(field.tip)
        label.setBuddy(editor)
        editor.setAccessibleName(field.label)
        self._editors[field.key], self._labels[field.key] = editor, label
        if self._marked:
            self._layout.addRow(label, self._with_mark(field.key, editor))
        else:
            self._layout.addRow(label, editor)

    def _with_mark(self, key: str, editor: QWidget) -> QHBoxLayout:
        """Return the editor with room for a word beside it."""
        mark = QLabel()
        mark.setProperty("mark", "stated")
        mark.linkActivated.connect(lambda _, key=key: self.confirmed.emit(key))
        self._mark_labels[key] = mark
        row = QHBoxLayout()
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(5)
        row.addWidget(editor, 1)
        row.addWidget(mark)
        return row

    def set_marks(self, marks: dict[str, tuple[str, str]]) -> None:
        """Show a word next to each field of a form with marks: pairs of word, which is also its style, and tip.

        A click on *assumed* confirms the value.
        """
        wide = 0
        for key, (word, tip) in marks.items():
            label = self._mark_labels[key]
            label.setText(MARKS.get(word, word))
            label.setAccessibleName(f"{self.fields[key].label}: {word}")
            label.setToolTip(tip)
            # screen readers read the description after the name
            self._editors[key].setAccessibleDescription(tip)
            set_look(label, "mark", word)
            wide = max(wide, label.sizeHint().width())
        for key in marks:
            self._mark_labels[key].setFixedWidth(wide)

    # -- values ----------------------------------------------------------------------------------------
    def editor(self, key: str) -> QWidget:
        """Return the widget of a field."""
        return self._editors[key]

    def mark(self, key: str) -> QLabel:
        """Return what says where the value of a field comes from; its property ``mark`` is the word."""
        return self._mark_labels[key]

    def set_values(self, values: dict[str, Any]) -> None:
        """Show values without reporting them; a field being typed in keeps its text if it means the same."""
        for key, value in values.items():
            editor = self._editors[key]
            blocker = QSignalBlocker(editor)
            if isinstance(editor, QComboBox):
                editor.setCurrentIndex(max(0, editor.findData(value)))
            elif isinstance(editor, QCheckBox):
                editor.setChecked(bool(value))
            elif isinstance(editor, QLabel):
                editor.setText(str(value))
            elif isinstance(editor, QLineEdit):
                self._set_text(key, editor, value)
            blocker.unblock()
        self._show_error()

    def _set_text(self, key: str, editor: QLineEdit, value: Any) -> None:
        same = self._stands_for(key, value)
        self._values[key] = value
        if not same and key != self._reported:  # changed elsewhere: what was typed before is over
            self._untouched.pop(key, None)
        if same and editor.property("reason"):
            return  # the text that was refused can still be corrected
        if not editor.text() or not _means(self.fields[key], editor.text(), value):
            editor.setText(text_of(self.fields[key], value))
            editor.setCursorPosition(0)  # of a long number the beginning counts
        self._mark(editor, "")

    def set_enabled(self, key: str, enabled: bool, why: str = "") -> None:
        """Enable or disable one field with its label; ``why`` it is disabled is said in its tip meanwhile."""
        editor = self._editors[key]
        if not enabled and isinstance(editor, QLineEdit) and editor.property("reason"):
            self._mark(editor, "")
            editor.setText(text_of(self.fields[key], self._values.get(key)))
            self._show_error()
        for widget in (self._editors[key], self._labels[key]):
            widget.setEnabled(enabled)
            widget.setToolTip(why or self.fields[key].tip)

    def own_line(self, key: str, width: int) -> None:
        """Give a field that needs ``width`` pixels a line of its own, below its label, where the form is narrower."""
        self._layout.setRowWrapPolicy(QFormLayout.RowWrapPolicy.WrapLongRows)
        self._editors[key].setMinimumWidth(width)

    def set_shown(self, key: str, shown: bool) -> None:
        """Show or hide one field with its label."""
        self._layout.setRowVisible(self._labels[key], shown)

    def _select(self, key: str, editor: QLineEdit) -> None:
        """Remember a text that is selected whole: what is typed over it is a new beginning."""
        if editor.selectedText() and editor.selectedText() == editor.text():
            self._selected[key] = editor.text()

    def _changed(self, key: str) -> None:
        editor, field = self._editors[key], self.fields[key]
        error = ""
        if isinstance(editor, QComboBox):
            value: Any = editor.currentData()
        elif isinstance(editor, QCheckBox):
            value = editor.isChecked()
        else:
            assert isinstance(editor, QLineEdit)
            if self._selected.pop(key, editor.text()) not in editor.text():
                self._untouched.pop(key, None)
            self._untouched.setdefault(key, self._values.get(key, None if field.optional else _UNKNOWN))
            try:
                value = parse(field, editor.text())
            except InputError as refused:
                value, error = None, str(refused)
        error = error or self.check(key, value)
        self._last = key
        self._mark(editor, error)
        self._show_error()
        if error:
            value = self._untouched.get(key, _UNKNOWN)
            if value is _UNKNOWN or self._stands_for(key, value):
                return
        self._values[key], self._reported = value, key
        try:
            self.edited.emit(key, value)
        finally:
            self._reported = ""

    def _stands_for(self, key: str, value: Any) -> bool:
        """Return whether the field was last shown, or reported, with this value."""
        return key in self._values and text_of(self.fields[key], self._values[key]) == text_of(self.fields[key], value)

    def _mark(self, editor: QWidget, error: str) -> None:
        set_look(editor, "invalid", bool(error))
        editor.setProperty("reason", error)

    def _show_error(self) -> None:
        errors = {key: str(e.property("reason")) for key, e in self._editors.items() if e.property("reason")}
        self._error.setText(errors.get(self._last, next(iter(errors.values()), "")))
        self._error.setVisible(bool(errors))

    @property
    def error(self) -> str:
        """The reason shown, or empty."""
        return self._error.text() if not self._error.isHidden() else ""


def _means(field: Field, text: str, value: Any) -> bool:
    """Return whether ``text`` already says ``value``, in whatever words: "5.0" is 5."""
    try:
        if field.read is not None and isinstance(value, str):
            return bool(field.read(text) == field.read(value))
        return bool(parse(field, text) == value)
    except InputError:
        return False
