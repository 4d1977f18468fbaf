"""The selected effect: why it is on or off, its magnitudes, and its influence at one position."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import (
    QComboBox,
    QGridLayout,
    QHeaderView,
    QLabel,
    QLineEdit,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from lfcal.base import InputError
from lfcal.simulate.effects import Magnitude
from lfcal_gui.models import Shot, levels_of
from lfcal_gui.pages.simulate.model import GIVEN
from lfcal_gui.pages.simulate.model_effects import FRAMES_ONLY, EffectRow, read_terms, refused
from lfcal_gui.pages.simulate.model_frames import InfluencePictures
from lfcal_gui.widgets import (
    Picture,
    button,
    clear,
    column_of,
    line,
    link,
    name_controls,
    scrolling,
    set_look,
    share_contrast,
    split,
    wrapped,
)

TERM_TIPS = {("n", "m", "waves"): "R(n, |m|) cos(m θ), with sin for m < 0; value at the rim of the pupil"}


class TermCells(QTableWidget):
    """Table cells; Delete removes the selected row."""

    removed = Signal()
    """Delete was pressed."""

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Remove the selected row when Delete is pressed."""
        if event.key() == Qt.Key.Key_Delete:
            self.removed.emit()
            return
        super().keyPressEvent(event)


class TermsTable(QWidget):
    """Editor of a magnitude that consists of several rows, such as Zernike terms.

    Parameters
    ----------
    effect, magnitude
        Name of the effect, and the magnitude edited in the table.
    """

    changed = Signal(object, str, arguments=["terms", "why"])
    """The terms after a change, or None and the reason if they are invalid."""

    def __init__(self, effect: str, magnitude: Magnitude) -> None:
        super().__init__()
        self._effect, self._magnitude = effect, magnitude
        self.cells = TermCells(0, len(magnitude.columns))
        self.cells.setHorizontalHeaderLabels(magnitude.columns)
        self.cells.verticalHeader().hide()
        self.cells.setMinimumHeight(84)
        self.cells.setMaximumHeight(120)
        self.cells.setAccessibleName(magnitude.title)
        self.cells.setToolTip(
            TERM_TIPS.get(magnitude.columns, f"{magnitude.title}: one row for each. Delete removes the selected row")
        )
        self.cells.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        self.cells.cellChanged.connect(lambda *_: self._edited())
        self.cells.removed.connect(self.remove)
        self.setFocusProxy(self.cells)
        add = "Add a row at the end. It is used when all of its cells are filled"
        self.add_button = button("Add row", add, self.add)
        self.remove_button = button("Remove", "Delete the selected row (Delete)", self.remove)
        column_of(self.cells, line(self.add_button, self.remove_button), of=self)

    def show_terms(self, terms: tuple[tuple[int, int, float], ...]) -> None:
        """Show terms, unless the cells already contain them."""
        try:
            if self._read() == terms and self.cells.rowCount() >= len(terms):
                return
        except InputError:
            pass
        with QSignalBlocker(self.cells):
            self.cells.setRowCount(0)
            for n, m, waves in terms:
                self._append(str(n), str(m), f"{waves:.10g}")

    def _read(self) -> tuple[tuple[int, int, float], ...]:
        return read_terms(self._effect, self._magnitude, self.words())

    def words(self) -> list[tuple[str, str, str]]:
        """Return the texts of the cells, row by row."""
        cells = self.cells
        items = [[cells.item(k, c) for c in range(3)] for k in range(cells.rowCount())]
        return [(a.text() if a else "", b.text() if b else "", c.text() if c else "") for a, b, c in items]

    def add(self) -> None:
        """Add a row, and start editing it."""
        with QSignalBlocker(self.cells):
            self._append("", "", "")
        self.cells.setCurrentCell(self.cells.rowCount() - 1, 0)
        self.cells.edit(self.cells.currentIndex())

    def remove(self) -> None:
        """Remove the selected row."""
        if self.cells.currentRow() >= 0:
            self.cells.removeRow(self.cells.currentRow())
            self._edited()

    def _append(self, *words: str) -> None:
        row = self.cells.rowCount()
        self.cells.insertRow(row)
        for column, word in enumerate(words):
            self.cells.setItem(row, column, QTableWidgetItem(word))

    def _edited(self) -> None:
        try:
            terms = self._read()
        except InputError as error:
            self.changed.emit(None, str(error))
            return
        self.changed.emit(terms, "")


NOT_GIVEN = ""
"""Item data of the entry for a value that was not given."""


class MagnitudeEditor(QWidget):
    """Value and source of one magnitude."""

    given = Signal(str, object, str, arguments=["field", "value", "mark"])
    """A valid value and its source. None: the value was removed."""

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
        self.source.setAccessibleName(f"Source of {magnitude.title}")
        self.source.activated.connect(lambda _: self._source_chosen())
        self.error = wrapped("error")
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
        with QSignalBlocker(self.source):
            self.source.clear()
            self.source.addItem(self._default_words(), NOT_GIVEN)
            for mark in GIVEN:
                self.source.addItem(mark, mark)
            mark = self.magnitude.mark if self.magnitude.source == "given" else NOT_GIVEN
            self.source.setCurrentIndex(self.source.findData(mark))
            self.source.setToolTip(
                "stated or measured: given by you. camera: from the camera description. typical: a "
                "typical value, not specific to this camera"
            )

    def _default_words(self) -> str:
        source, mark = self.magnitude.otherwise
        if self.magnitude.kind == "terms":
            return "none"
        return f"camera: {mark}" if mark else source

    # -- editing ---------------------------------------------------------------------------------------
    def _check(self, text: str) -> Any:
        """Return the value of ``text``; if it is invalid, show why and return None."""
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
        if mark == NOT_GIVEN:
            if self.magnitude.kind != "terms":
                self.edit.setText(self.magnitude.text(self.magnitude.counts))
                self.edit.setModified(False)
            self._say("")
            self.given.emit(self.magnitude.field, None, "")
        elif self.magnitude.counts or self.magnitude.kind != "terms":
            self.given.emit(self.magnitude.field, self.magnitude.counts, mark)
        else:
            self._say("add a row to the table first")
            self._show_source()

    def _say(self, why: str) -> None:
        self.error.setText(why)
        self.error.setVisible(bool(why))
        set_look(self.value, "invalid", bool(why))


class MagnitudeForm(QWidget):
    """Form of the magnitudes of the selected effect."""

    given = Signal(str, str, object, str, arguments=["effect", "field", "value", "mark"])
    """The user gave a magnitude; a value of None removes it."""

    def __init__(self) -> None:
        super().__init__()
        self._column = column_of(of=self)
        self._body: QWidget | None = None
        self._shown: tuple[str, tuple[str, ...]] = ("", ())
        self.editors: dict[str, MagnitudeEditor] = {}

    def show_row(self, row: EffectRow) -> None:
        """Show the magnitudes of an effect; for the same effect, widgets and text being typed are kept."""
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
            row_of_value = 4 * k + 1
            terms = one.kind == "terms"  # a table over the whole width, below its source
            grid.addWidget(label, 4 * k, 0, 1, 3)
            grid.addWidget(editor.value, row_of_value + terms, 0, 1, 3 if terms else 1)
            grid.addWidget(QLabel(one.unit), row_of_value, 1)
            grid.addWidget(editor.source, row_of_value, 2)
            grid.addWidget(editor.error, 4 * k + 3, 0, 1, 3)
            self.editors[one.field] = editor
        grid.setColumnStretch(0, 1)

    def focus_first(self) -> None:
        """Set the focus to the first magnitude."""
        for editor in self.editors.values():
            editor.value.setFocus()
            if isinstance(editor.value, QLineEdit):
                editor.value.selectAll()
            return


TITLES = ("without", "with", "difference")


class InfluenceView(QWidget):
    """Linked pictures of the influence of an effect; the first two share their levels."""

    def __init__(self) -> None:
        super().__init__()
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(4)
        self.pictures = tuple(Picture() for _ in TITLES)
        link(*self.pictures)
        share_contrast(*self.pictures[:2])
        for k, (picture, title) in enumerate(zip(self.pictures, TITLES, strict=True)):
            picture.setAccessibleName(f"Pattern of a position: {title}")
            grid.addWidget(picture, k // 2, k % 2)
        self.words = wrapped()
        self.influence: InfluencePictures | None = None
        grid.addWidget(self.words, 1, 1)
        for k in range(2):
            grid.setRowStretch(k, 1)
            grid.setColumnStretch(k, 1)

    def show_influence(self, influence: InfluencePictures | None, words: str = "") -> None:
        """Show the pictures of one position; None clears them and shows the reason."""
        self.influence = influence
        self.words.setText(words or (influence.words if influence is not None else ""))
        if influence is None:
            for picture in self.pictures:
                picture.set_shot(None)
            return
        shown = influence.without, influence.with_it, influence.difference
        common = levels_of(np.stack(shown[:2]))
        for k, (picture, title, values) in enumerate(zip(self.pictures, TITLES, shown, strict=True)):
            signed = k == 2
            quantity = title if signed else influence.value
            levels = None if signed else common
            picture.setToolTip("{1} over {0}".format(*influence.axes))
            shot = Shot(values, title, quantity, f"effect_{title}", levels, signed, origin=influence.origin)
            picture.set_shot(shot)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        for picture in self.pictures:
            picture.apply_theme()


class EffectPanel(QWidget):
    """Panel with all data of one effect.

    Parameters
    ----------
    stop
        Called if the user cancels the computation of the pictures.
    """

    def __init__(self, stop: Callable[[], object]) -> None:
        super().__init__()
        self.title = wrapped("heading", "Select an effect to see its magnitudes and how it changes H.")
        self.why, self.formula = wrapped(""), wrapped()
        self.note = wrapped("hint", "This effect has no magnitudes. Its values are in the camera description.")
        self._typical = False
        self.form = MagnitudeForm()
        self.stop_button = button("Stop", "Stop computing these images. The effect keeps its setting", stop)
        inner = QWidget()
        parts = (self.title, self.why, self.form, self.note, self.formula, line(self.stop_button))
        column_of(*parts, of=inner).addStretch()
        area = scrolling(inner)
        clear(area)
        self._parts = split(area, sizes=(230,), vertical=True, fixed=1)
        column_of(self._parts, of=self)
        self.show_row(None)

    @cached_property
    def influence(self) -> InfluenceView:
        """Pictures of the influence of the effect, which are created on demand."""
        made = InfluenceView()
        name_controls(made)
        self._parts.addWidget(made)
        self._parts.setStretchFactor(1, 1)
        self._parts.setSizes([230, 400])
        return made

    # -- showing ---------------------------------------------------------------------------------------
    def show_row(self, row: EffectRow | None) -> None:
        """Show the data of an effect. None: no effect is selected."""
        there = row is not None
        for widget in (self.why, self.form, self.note, self.formula, self.stop_button):
            widget.setVisible(there)
        self.stop_button.setEnabled(False)
        if there or "influence" in vars(self):
            self.influence.setVisible(there)
        if row is None:
            return
        self._typical = row.effect.deviation and not row.given and row.share > 0
        self.title.setText(row.title if row.enters_h else f"{row.title}: {FRAMES_ONLY}")
        self.why.setText(row.verdict_text())
        self.formula.setText(f"Estimate: {row.formula}")
        self.note.setVisible(not row.magnitudes)
        self.form.show_row(row)

    def show_waiting(self, words: str) -> None:
        """Show that pictures are being computed, with a button to stop."""
        self.stop_button.setEnabled(True)
        self.influence.show_influence(None, words)

    def show_influence(self, influence: InfluencePictures | None, why: str = "") -> None:
        """Show the pictures, or why there are none."""
        self.stop_button.setEnabled(False)
        size = "At a typical size, " if self._typical else ""
        self.influence.show_influence(influence, why or (f"{size}{influence.words}" if influence is not None else ""))
