"""The columns of a list, what each holds, and its first rows."""

from __future__ import annotations

from PySide6.QtCore import QSignalBlocker, Signal
from PySide6.QtWidgets import QAbstractItemView, QComboBox, QTableWidget, QTableWidgetItem

from lfcal.frames.lists import Column, Table
from lfcal_gui.pages.frames.list_columns import HOLDS, columns_text, not_held, unit_shown, units_of
from lfcal_gui.widgets import choice_box

WORDS = {"": "unit found", "index": "number of position"}
NO_UNIT = (("", "no unit"),)
ROWS = 3
"""Rows of the list that are shown."""


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
        self.setToolTip("Choose above a column what it holds, if that was not found or is wrong")
        self.boxes: list[tuple[QComboBox, QComboBox]] = []
        self.names: tuple[str, ...] = ()
        """Names of the columns."""
        self._used: set[str] = set()
        self._without: set[str] = set()
        self.hide()

    def show_table(self, table: Table | None, used: tuple[Column, ...], told: str = "") -> None:
        """Show the list and the meaning of its columns. Without a list, hide it; ``told``: the user's choices."""
        self.setVisible(table is not None)
        if table is None:
            return
        self.names = table.columns
        self._used, self._without = {column.role for column in used}, not_held(told)
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
        units = units_of("" if column is None else column.role)
        shown = tuple((name, WORDS.get(name, name)) for name in units) if len(units) > 1 else NO_UNIT
        unit = choice_box(shown, "Unit of this column")
        blockers = [QSignalBlocker(role), QSignalBlocker(unit)]
        role.setCurrentIndex(role.findData("" if column is None else column.role))
        unit.setCurrentIndex(max(0, unit.findData("" if column is None else unit_shown(column.unit))))
        unit.setEnabled(len(units) > 1)
        for one in blockers:
            one.unblock()
        for row, box in enumerate((role, unit)):
            box.currentIndexChanged.connect(self._changed)
            self.setCellWidget(row, k, box)
        self.boxes.append((role, unit))

    def _changed(self) -> None:
        holds = {str(k): (role.currentData(), unit.currentData()) for k, (role, unit) in enumerate(self.boxes, 1)}
        # else a role that the user removed would be found again from the column's name
        without = (self._without | self._used) - {role for role, _ in holds.values()}
        self.changed.emit(columns_text(holds, without))
