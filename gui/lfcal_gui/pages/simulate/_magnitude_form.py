"""Form of the magnitudes of one effect: value, unit and source. The reason for a refused value is shown below it."""

from __future__ import annotations

from typing import Any

from PySide6.QtCore import QSignalBlocker, Signal
from PySide6.QtWidgets import QComboBox, QGridLayout, QLabel, QLineEdit, QVBoxLayout, QWidget

from lfcal.simulate.effects import Magnitude
from lfcal_gui.pages.simulate._terms_table import TermsTable
from lfcal_gui.pages.simulate.model import GIVEN
from lfcal_gui.pages.simulate.model_effects import EffectRow, refused
from lfcal_gui.widgets import set_look

NONE = ""
"""Item data of the source of a value that was not given."""


class MagnitudeEditor(QWidget):
    """Value and source of one magnitude.

    Signals
    -------
    given(field, value, mark)
        A value that passes, and how it is known; None: given no longer.
    """

    given = Signal(str, object, str)

    def __init__(self, effect: str, magnitude: Magnitude) -> None:
        super().__init__()
        self.effect, self.magnitude = effect, magnitude
        self.value: QWidget
        if magnitude.kind == "terms":
            self.table = TermsTable(effect, magnitude)
            self.table.changed.connect(self._terms_changed)
            self.value = self.table
        else:
            self.edit = QLineEdit()
            self.edit.setMinimumWidth(70)
            self.edit.setEnabled(magnitude.kind != "other")
            self.edit.textEdited.connect(lambda text: self._check(text))
            self.edit.editingFinished.connect(self._finished)
            self.value = self.edit
        self.value.setAccessibleName(f"{magnitude.title} ({magnitude.unit})")
        self.source = QComboBox()
        self.source.setAccessibleName(f"source of {magnitude.title}")
        self.source.activated.connect(lambda _: self._source_chosen())
        self.error = QLabel()
        self.error.setProperty("role", "error")
        self.error.setWordWrap(True)
        self.error.hide()

    # -- showing ---------------------------------------------------------------------------------------
    def show_magnitude(self, magnitude: Magnitude) -> None:
        """Show value and source; text that is being typed is kept."""
        same, self.magnitude = self.magnitude == magnitude, magnitude
        if same and not self.error.isHidden():
            return  # the user is still correcting the refused value
        if magnitude.kind == "terms":
            self.table.show_terms(magnitude.counts or ())
        elif not (self.edit.hasFocus() and self.edit.isModified()):
            self.edit.setText(magnitude.text(magnitude.counts))
            self.edit.setCursorPosition(0)
            self.edit.setModified(False)
        tip = magnitude.range_text()
        self.value.setToolTip(f"{magnitude.title}: {tip}" if tip else magnitude.title)
        self._show_source()
        self._say("")

    def _show_source(self) -> None:
        blocker = QSignalBlocker(self.source)
        self.source.clear()
        self.source.addItem(self._default_words(), NONE)
        for mark in GIVEN:
            self.source.addItem(mark, mark)
        mark = self.magnitude.mark if self.magnitude.source == "given" else NONE
        self.source.setCurrentIndex(self.source.findData(mark))
        self.source.setToolTip(
            "stated or measured: given by you. camera: from the camera's description. typical: says nothing about "
            "this camera."
        )
        blocker.unblock()

    def _default_words(self) -> str:
        source, mark = self.magnitude.otherwise
        if self.magnitude.kind == "terms":
            return "none"
        return f"camera: {mark}" if mark else source

    # -- editing ---------------------------------------------------------------------------------------
    def _check(self, text: str) -> Any:
        """Return what ``text`` means, or None and say why it means nothing."""
        value, why = refused(self.effect, self.magnitude, text)
        self._say(why)
        return None if why else value

    def _finished(self) -> None:
        text = self.edit.text()
        if not self.edit.isModified():
            return
        if not text.strip() and self.magnitude.kind != "text":
            self.edit.setModified(False)
            self.given.emit(self.magnitude.field, None, "")
            return
        value = self._check(text)
        if value is not None:
            self.edit.setModified(False)
            mark = self.magnitude.mark if self.magnitude.source == "given" else "stated"
            self.given.emit(self.magnitude.field, value, mark)

    def _terms_changed(self, terms: object, why: str) -> None:
        self._say(why)
        if not why:
            mark = self.magnitude.mark if self.magnitude.source == "given" else "stated"
            self.given.emit(self.magnitude.field, terms or None, mark)

    def _source_chosen(self) -> None:
        mark = self.source.currentData()
        if mark == NONE:
            if self.magnitude.kind != "terms":
                self.edit.setText(self.magnitude.text(self.magnitude.counts))
                self.edit.setModified(False)
            self._say("")
            self.given.emit(self.magnitude.field, None, "")
        elif self.magnitude.counts or self.magnitude.kind != "terms":
            self.given.emit(self.magnitude.field, self.magnitude.counts, mark)
        else:
            self._say("add a row first")
            self._show_source()

    def _say(self, why: str) -> None:
        self.error.setText(why)
        self.error.setVisible(bool(why))
        set_look(self.value, "invalid", bool(why))


class MagnitudeForm(QWidget):
    """The magnitudes of the effect that is selected.

    Signals
    -------
    given(effect, field, value, mark)
        The user gave a magnitude, or with a value of None takes it back.
    """

    given = Signal(str, str, object, str)

    def __init__(self) -> None:
        super().__init__()
        self._column = QVBoxLayout(self)
        self._column.setContentsMargins(0, 0, 0, 0)
        self._body: QWidget | None = None
        self._shown: tuple[str, tuple[str, ...]] = ("", ())
        self.editors: dict[str, MagnitudeEditor] = {}

    def show_row(self, row: EffectRow) -> None:
        """Show the magnitudes of an effect; the same effect's widgets stay, and with them what is being typed."""
        shape = row.name, tuple(one.field for one in row.magnitudes)
        if shape != self._shown:
            self._build(row)
            self._shown = shape
        for one in row.magnitudes:
            self.editors[one.field].show_magnitude(one)

    def _build(self, row: EffectRow) -> None:
        if self._body is not None:
            self._column.removeWidget(self._body)
            self._body.hide()
            self._body.deleteLater()
        self._body = QWidget()
        self._column.addWidget(self._body)
        grid = QGridLayout(self._body)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setVerticalSpacing(4)
        self.editors = {}
        for k, one in enumerate(row.magnitudes):
            editor = MagnitudeEditor(row.name, one)
            editor.setParent(self._body)
            editor.hide()  # holds the state of the shown widgets
            editor.given.connect(lambda field, value, mark, name=row.name: self.given.emit(name, field, value, mark))
            label = QLabel(one.title)
            label.setBuddy(editor.value)
            wide = one.kind == "terms"  # a table below its name, over the whole width
            grid.addWidget(label, 3 * k, 0)
            grid.addWidget(editor.value, 3 * k + wide, 0 if wide else 1, 1, 4 if wide else 1)
            grid.addWidget(QLabel(one.unit), 3 * k, 2)
            grid.addWidget(editor.source, 3 * k, 3)
            grid.addWidget(editor.error, 3 * k + 2, 0, 1, 4)
            self.editors[one.field] = editor
        grid.setColumnStretch(1, 1)

    def focus_first(self) -> None:
        """Put the keyboard into the first magnitude."""
        for editor in self.editors.values():
            editor.value.setFocus()
            if isinstance(editor.value, QLineEdit):
                editor.value.selectAll()
            return
