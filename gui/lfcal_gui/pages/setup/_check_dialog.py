"""The comparison of the camera with a white image: what fits, what differs, which lattice it shows."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QDialog, QHBoxLayout, QHeaderView, QTableWidget, QTableWidgetItem, QVBoxLayout, QWidget

from lfcal.judge import judgement_of
from lfcal.lattice import DIFFERS, FITS, WRONG
from lfcal_gui.models import typeset
from lfcal_gui.pages.setup._lattice_view import LatticeView
from lfcal_gui.pages.setup.model_check import Checked
from lfcal_gui.pages.setup.model_lattice_map import lattice_words
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import WrappedLabel

__all__ = ["CheckDialog"]

COLUMNS = ("", "Verdict", "Off by (px)", "Camera", "White image")
SIZE = (960, 520)


class CheckDialog(QDialog):
    """The white image with both lattices, and a table of every value; it follows the check while it is open."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setWindowTitle("Camera compared with a white image")
        self.resize(*SIZE)
        self.view = LatticeView()
        self._make_table()
        self.words, self.about = WrappedLabel(), WrappedLabel()
        self.words.setProperty("role", "value")
        row = QHBoxLayout(self)
        column = QVBoxLayout()
        for part in (self.words, self.about):
            column.addWidget(part)
        column.addWidget(self.table, 1)
        row.addWidget(self.view, 2)
        row.addLayout(column, 3)
        self._shown: Checked | None = None

    def _make_table(self) -> None:
        self.table = QTableWidget(0, len(COLUMNS))
        self.table.setAccessibleName("camera and white image")
        self.table.setToolTip(
            "What the description says and what the white image shows, and by how many pixels they part"
        )
        self.table.setHorizontalHeaderLabels(list(COLUMNS))
        self.table.verticalHeader().hide()
        self.table.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
        self.table.setSelectionMode(QTableWidget.SelectionMode.NoSelection)
        self.table.setWordWrap(False)
        self.table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)

    def show_check(self, found: Checked) -> None:
        """Show a comparison."""
        self._shown = found
        self.view.show_check(found)
        self.words.setText(f"{found.name}: {judgement_of(found.check).verdict}")
        self.about.setText("" if found.check.fit is None else lattice_words(found.check.fit))
        self._fill()

    def _fill(self) -> None:
        found = self._shown
        if found is None:
            return
        theme = current_theme()
        colours = {FITS: theme.good, DIFFERS: theme.fair, WRONG: theme.bad}
        self.table.setRowCount(len(found.check.lines))
        for row, entry in enumerate(found.check.lines):
            edge = "" if entry.edge_px is None else f"{entry.edge_px:.2f}"
            label = entry.label[:1].upper() + entry.label[1:]
            texts = (label, entry.verdict, edge, typeset(entry.expected), typeset(entry.measured))
            for column, text in enumerate(texts):
                item = QTableWidgetItem(text)
                if column == 2:
                    item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                if column == 1:
                    item.setForeground(QColor(colours.get(entry.verdict, theme.muted)))
                self.table.setItem(row, column, item)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.view.apply_theme()
        self._fill()
