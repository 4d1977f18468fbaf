"""Table of texts that can be sorted by numbers, and copied to spreadsheets."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from PySide6.QtCore import QLocale, QPoint, Qt
from PySide6.QtGui import QColor, QKeyEvent, QKeySequence, QResizeEvent
from PySide6.QtWidgets import (
    QAbstractItemView,
    QApplication,
    QHeaderView,
    QMenu,
    QStyledItemDelegate,
    QTableWidget,
    QTableWidgetItem,
)

from lfcal_gui.models import minus
from lfcal_gui.widgets.enlarging import can_be_enlarged, enlarge, enlarged_of

ROW_PX, ROOMY_PX = 26, 480
"""Height of a row, and smallest width of a table that shows all columns (px)."""

NUMBER, ROW = Qt.ItemDataRole.UserRole, Qt.ItemDataRole.UserRole + 1


LEFT = Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter
RIGHT = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter


class Cell(QTableWidgetItem):
    """A cell that is sorted by its number or, without one, by its text."""

    def __lt__(self, other: QTableWidgetItem) -> bool:
        """Return whether this cell is sorted before another one; cells with the number NaN come last."""
        one, two = self.data(NUMBER), other.data(NUMBER)
        if one is None or two is None:
            return self.text().lower() < other.text().lower()
        return (math.isnan(one), one) < (math.isnan(two), two)


class MinusSigns(QStyledItemDelegate):
    """Delegate that draws negative numbers with minus signs; copied cells contain hyphens."""

    def displayText(self, value: object, locale: QLocale | QLocale.Language) -> str:
        """Return the displayed text of a cell."""
        return minus(super().displayText(value, locale))


class RowsTable(QTableWidget):
    """A table of rows. A click on a header sorts; Ctrl+C copies the selected rows, or all if none is selected.

    Parameters
    ----------
    header
        Titles of the columns.
    wide
        The column that takes the remaining width.
    sizes
        Indices of the columns that contain numbers.
    brief
        Indices of the columns whose texts may be cut, because they are shown elsewhere and in tooltips.
    spare
        Indices of the columns that are hidden if the table is narrower than ``roomy`` (px). They are still copied.
    whole
        Whether the table is as high as its rows, for use in a scroll area.
    """

    def __init__(
        self,
        header: tuple[str, ...],
        wide: int,
        sizes: Sequence[int] = (),
        brief: Sequence[int] = (),
        spare: Sequence[int] = (),
        *,
        roomy: int = ROOMY_PX,
        whole: bool = False,
    ) -> None:
        super().__init__(0, len(header))
        self._spare, self._roomy, self._whole = tuple(spare), roomy, whole
        self._header, self._sizes, self.brief = header, tuple(sizes), tuple(brief)
        self.setHorizontalHeaderLabels(header)
        self.verticalHeader().hide()
        self.verticalHeader().setDefaultSectionSize(ROW_PX)
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setWordWrap(False)
        self.setItemDelegate(MinusSigns(self))
        self.setTabKeyNavigation(False)  # Tab leaves the table
        self.setToolTip("Click a header to sort; Ctrl+C copies the selected rows, or all of them")
        top = self.horizontalHeader()
        for k in range(len(header)):
            stretch = QHeaderView.ResizeMode.Stretch if k == wide else QHeaderView.ResizeMode.ResizeToContents
            top.setSectionResizeMode(k, stretch)
            title = self.horizontalHeaderItem(k)
            if title is not None:
                title.setTextAlignment(RIGHT if k in self._sizes else LEFT)
        self.setContextMenuPolicy(Qt.ContextMenuPolicy.CustomContextMenu)
        self.customContextMenuRequested.connect(self._menu)
        if spare:
            can_be_enlarged(self)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Hide the spare columns if there is not enough space."""
        for column in self._spare:
            self.setColumnHidden(column, self.width() < self._roomy)
        super().resizeEvent(event)
        self._fit_height()

    def _fit_height(self) -> None:
        """Set the height to the height of all rows, unless the table is enlarged; it then scrolls."""
        if not self._whole:
            return
        inside = enlarged_of(self) is None
        policy = Qt.ScrollBarPolicy
        self.setVerticalScrollBarPolicy(policy.ScrollBarAlwaysOff if inside else policy.ScrollBarAsNeeded)
        if self.wordWrap():
            self.resizeRowsToContents()
        if inside:
            head = self.horizontalHeader().sizeHint().height()
            self.setFixedHeight(head + self.verticalHeader().length() + 2 * self.frameWidth())

    def show_rows(
        self,
        rows: Sequence[tuple[str, ...]],
        numbers: Sequence[tuple[float, ...]] = (),
        colour: Callable[[int, int], str] = lambda row, column: "",
    ) -> None:
        """Show rows in their order, with the sort keys ``numbers``; ``colour`` returns the colour of (row, column)."""
        self.setSortingEnabled(False)
        self.setRowCount(len(rows))
        for k, row in enumerate(rows):
            for column, text in enumerate(row):
                cell = Cell(text)
                cell.setData(ROW, k)
                cell.setToolTip(text)
                if column in self._sizes:
                    cell.setData(NUMBER, float(numbers[k][column]))
                    cell.setTextAlignment(RIGHT)
                if own := colour(k, column):
                    cell.setForeground(QColor(own))
                self.setItem(k, column, cell)
        self.horizontalHeader().setSortIndicator(-1, Qt.SortOrder.AscendingOrder)
        self.setSortingEnabled(True)
        self._fit_height()

    def number_of(self, row: int) -> int:
        """Return the original index of the row that is displayed in a row of the table; -1: none."""
        item = self.item(row, 0)
        return -1 if item is None else int(item.data(ROW))

    def chosen(self) -> int:
        """Return the original index of the selected row, or of the first selected one; -1: none."""
        return min((self.number_of(index.row()) for index in self.selectedIndexes()), default=-1)

    def choose(self, number: int) -> None:
        """Select a row by its original index; unknown indices are ignored."""
        for row in range(self.rowCount()):
            if self.number_of(row) == number:
                self.selectRow(row)

    def text(self) -> str:
        """Return the selected rows, or all, with the header, as text separated by tabs."""
        chosen = sorted({index.row() for index in self.selectedIndexes()}) or range(self.rowCount())
        cells = [[self.item(k, c) for c in range(self.columnCount())] for k in chosen]
        rows = [self._header, *(tuple("" if cell is None else cell.text() for cell in row) for row in cells)]
        return "\n".join("\t".join(row) for row in rows) + "\n"

    def copy(self) -> None:
        """Copy the selected rows, or all, to the clipboard."""
        QApplication.clipboard().setText(self.text())

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Copy rows instead of one cell."""
        if event.matches(QKeySequence.StandardKey.Copy):
            self.copy()
            return
        super().keyPressEvent(event)

    def _menu(self, position: QPoint) -> None:
        menu = QMenu(self)
        menu.addAction("Copy rows").triggered.connect(lambda _=False: self.copy())
        if self._spare:
            words = "Enlarge, with all columns" if enlarged_of(self) is None else "Restore (Esc)"
            menu.addAction(words).triggered.connect(lambda _=False: enlarge(self))
        menu.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        menu.popup(self.viewport().mapToGlobal(position))
