"""The columns of a list, what each holds, and its first rows."""

from __future__ import annotations

from PySide6.QtCore import QSignalBlocker, Signal
from PySide6.QtWidgets import QAbstractItemView, QComboBox, QTableWidget, QTableWidgetItem

from gui.pages.frames.model_import import HOLDS, ROWS, UNITS, columns_text
from gui.widgets.cards import choice_box
from lfcal.frames.lists.columns import Column
from lfcal.frames.lists.table import Table

__all__ = ["ColumnsTable"]

WORDS = {"": "unit found", "index": "number of position"}


class ColumnsTable(QTableWidget):
    """A row of choices over a row of units over the first rows of the list.

    Signals
    -------
    changed(text)
        What the columns hold, as ``lfcal assemble --columns`` takes it.
    """

    changed = Signal(str)

    def __init__(self) -> None:
        super().__init__()
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.verticalHeader().hide()
        self.setAccessibleName("columns of the list")
        self.setToolTip("Say above each column what it holds, where that was not found or is wrong")
        self.boxes: list[tuple[QComboBox, QComboBox]] = []
        self.hide()

    def show_table(self, table: Table | None, used: tuple[Column, ...]) -> None:
        """Show the list and what its columns hold; without a list nothing."""
        self.setVisible(table is not None)
        if table is None:
            return
        shown = table.rows[:ROWS]
        self.clear()
        self.setColumnCount(len(table.columns))
        self.setRowCount(2 + len(shown))
        self.setHorizontalHeaderLabels(list(table.columns))
        self.boxes = []
        by_name = {column.name: column for column in used}
        for k, name in enumerate(table.columns):
            self._add_boxes(k, by_name.get(name))
            for row, cells in enumerate(shown):
                self.setItem(2 + row, k, QTableWidgetItem(cells[k]))
        self.resizeColumnsToContents()
        for k in range(len(table.columns)):
            self.setColumnWidth(k, max(150, self.columnWidth(k)))
        heights = sum(self.rowHeight(row) for row in range(self.rowCount()))
        self.setFixedHeight(self.horizontalHeader().sizeHint().height() + heights + 18)

    def _add_boxes(self, k: int, column: Column | None) -> None:
        role = choice_box(HOLDS, "What this column holds")
        unit = choice_box(tuple((name, WORDS.get(name, name)) for name in UNITS), "Unit of this column")
        blockers = [QSignalBlocker(role), QSignalBlocker(unit)]
        role.setCurrentIndex(role.findData("" if column is None else column.role))
        unit.setCurrentIndex(max(0, unit.findData("" if column is None else column.unit)))
        unit.setEnabled(column is not None and column.role in ("x", "y", "z", "exposure"))
        for one in blockers:
            one.unblock()
        for row, box in enumerate((role, unit)):
            box.currentIndexChanged.connect(self._changed)
            self.setCellWidget(row, k, box)
        self.boxes.append((role, unit))

    def _changed(self) -> None:
        sender = self.sender()
        holds: dict[str, tuple[str, str]] = {}
        chosen = {role.currentData() for role, _ in self.boxes if role is sender}
        for k, (role, unit) in enumerate(self.boxes, 1):
            value = role.currentData()
            # what another column is said to hold now is no longer in this one
            if value in chosen and role is not sender:
                value = ""
            holds[str(k)] = (value, unit.currentData())
        self.changed.emit(columns_text(holds))
