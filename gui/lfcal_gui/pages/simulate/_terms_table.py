"""A list of triples as a small table, such as Zernike terms: n, m and waves of each."""

from __future__ import annotations

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import (
    QHBoxLayout,
    QHeaderView,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from lfcal.base import InputError
from lfcal.simulate.effects import Magnitude
from lfcal_gui.pages.simulate.model_effects import read_terms

TIPS = {("n", "m", "waves"): "R(n, |m|) cos(m θ), for m < 0 sin; the value at the rim of the pupil"}


class TermCells(QTableWidget):
    """The cells; Delete takes the selected row away.

    Signals
    -------
    removed()
        Delete was pressed.
    """

    removed = Signal()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Take a term away with Delete."""
        if event.key() == Qt.Key.Key_Delete:
            self.removed.emit()
            return
        super().keyPressEvent(event)


class TermsTable(QWidget):
    """Rows to edit.

    Parameters
    ----------
    effect, magnitude
        The effect's name and the magnitude that the table holds.

    Signals
    -------
    changed(terms, why)
        The terms after a change, or None and a line that says what is wrong with them.
    """

    changed = Signal(object, str)

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
            TIPS.get(magnitude.columns, f"{magnitude.title}: one row each; Delete removes the selected one")
        )
        self.cells.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        self.cells.cellChanged.connect(lambda *_: self._edited())
        self.cells.removed.connect(self.remove)
        self.setFocusProxy(self.cells)
        self.add_button = QPushButton("Add row")
        self.add_button.setToolTip("Add a term at the end; it is used as soon as all of its cells are filled")
        self.add_button.clicked.connect(lambda _=False: self.add())
        self.remove_button = QPushButton("Remove")
        self.remove_button.setToolTip("Delete the selected row (Delete)")
        self.remove_button.clicked.connect(lambda _=False: self.remove())
        row = QHBoxLayout()
        row.addWidget(self.add_button)
        row.addWidget(self.remove_button)
        row.addStretch()
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.addWidget(self.cells)
        column.addLayout(row)

    def show_terms(self, terms: tuple[tuple[int, int, float], ...]) -> None:
        """Show terms, unless they are what the cells say already."""
        try:
            if self._read() == terms and self.cells.rowCount() >= len(terms):
                return
        except InputError:
            pass
        blocker = QSignalBlocker(self.cells)
        self.cells.setRowCount(0)
        for n, m, waves in terms:
            self._append(str(n), str(m), f"{waves:.10g}")
        blocker.unblock()

    def _read(self) -> tuple[tuple[int, int, float], ...]:
        return read_terms(self._effect, self._magnitude, self.words())

    def words(self) -> list[tuple[str, str, str]]:
        """Return what the cells say, row by row."""
        cells = self.cells
        items = [[cells.item(k, c) for c in range(3)] for k in range(cells.rowCount())]
        return [(a.text() if a else "", b.text() if b else "", c.text() if c else "") for a, b, c in items]

    def add(self) -> None:
        """Add a row and begin to type in it."""
        blocker = QSignalBlocker(self.cells)
        self._append("", "", "")
        blocker.unblock()
        self.cells.setCurrentCell(self.cells.rowCount() - 1, 0)
        self.cells.edit(self.cells.currentIndex())

    def remove(self) -> None:
        """Take the selected row away."""
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
