"""Forms with units, ranges and validation as you type."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QFormLayout,
    QLabel,
    QLineEdit,
    QWidget,
)

from gui.models.form import Field, parse, text_of
from lfcal.errors import InputError

__all__ = ["Form"]


class Form(QWidget):
    """A column of fields.

    A value that does not parse, or that ``check`` refuses, is marked red with the reason under the form; only
    values that pass are reported.

    Signals
    -------
    edited(key, value)
        The user changed a value, and it passes.
    """

    edited = Signal(str, object)

    def __init__(self, fields: tuple[Field, ...], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.fields = {f.key: f for f in fields}
        self.check: Callable[[str, Any], str] = lambda key, value: ""
        self._editors: dict[str, QWidget] = {}
        self._layout = QFormLayout(self)
        self._layout.setContentsMargins(0, 0, 0, 0)
        self._layout.setHorizontalSpacing(10)
        self._layout.setVerticalSpacing(6)
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
            editor.currentIndexChanged.connect(lambda _=0, key=field.key: self._changed(key))
        elif field.kind == "bool":
            editor = QCheckBox()
            editor.toggled.connect(lambda _=False, key=field.key: self._changed(key))
        else:
            editor = QLineEdit()
            editor.setMinimumWidth(80)
            editor.textEdited.connect(lambda _="", key=field.key: self._changed(key))
        for widget in (label, editor):
            widget.setToolTip(field.tip)
        label.setBuddy(editor)
        editor.setAccessibleName(field.label)
        self._editors[field.key] = editor
        self._layout.addRow(label, editor)

    # -- values ----------------------------------------------------------------------------------------
    def editor(self, key: str) -> QWidget:
        """Return the widget of a field."""
        return self._editors[key]

    def set_values(self, values: dict[str, Any]) -> None:
        """Show values without reporting them; a field being typed in keeps its text if it means the same."""
        for key, value in values.items():
            editor, field = self._editors[key], self.fields[key]
            blocker = QSignalBlocker(editor)
            if isinstance(editor, QComboBox):
                editor.setCurrentIndex(max(0, editor.findData(value)))
            elif isinstance(editor, QCheckBox):
                editor.setChecked(bool(value))
            elif isinstance(editor, QLineEdit):
                if not editor.text() or not _means(field, editor.text(), value):
                    editor.setText(text_of(field, value))
                self._mark(editor, "")
            blocker.unblock()
        self._show_error()

    def set_enabled(self, key: str, enabled: bool) -> None:
        """Enable or disable one field with its label."""
        editor = self._editors[key]
        editor.setEnabled(enabled)
        label = self._layout.labelForField(editor)
        if label is not None:
            label.setEnabled(enabled)

    def _changed(self, key: str) -> None:
        editor, field = self._editors[key], self.fields[key]
        error = ""
        if isinstance(editor, QComboBox):
            value: Any = editor.currentData()
        elif isinstance(editor, QCheckBox):
            value = editor.isChecked()
        else:
            assert isinstance(editor, QLineEdit)
            try:
                value = parse(field, editor.text())
            except InputError as refused:
                value, error = None, str(refused)
        error = error or self.check(key, value)
        self._mark(editor, error)
        self._show_error()
        if not error:
            self.edited.emit(key, value)

    def _mark(self, editor: QWidget, error: str) -> None:
        if bool(editor.property("invalid")) != bool(error):
            editor.setProperty("invalid", bool(error))
            editor.style().unpolish(editor)
            editor.style().polish(editor)
        editor.setProperty("reason", error)

    def _show_error(self) -> None:
        errors = [str(e.property("reason")) for e in self._editors.values() if e.property("reason")]
        self._error.setText(errors[0] if errors else "")
        self._error.setVisible(bool(errors))

    @property
    def error(self) -> str:
        """The reason shown, or empty."""
        return self._error.text() if not self._error.isHidden() else ""


def _means(field: Field, text: str, value: Any) -> bool:
    """Return whether ``text`` already says ``value``, in whatever words: "5.0" is 5."""
    try:
        return bool(parse(field, text) == value)
    except InputError:
        return False
