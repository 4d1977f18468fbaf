"""A white image beside the camera: what fits, what differs, which lattice it shows."""

from __future__ import annotations

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QColor
from PySide6.QtWidgets import (
    QHBoxLayout,
    QHeaderView,
    QPushButton,
    QStackedWidget,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from lfcal.judge import judgement_of
from lfcal.lattice import DIFFERS, FITS, WRONG
from lfcal_gui.base_page import EmptyState
from lfcal_gui.models import typeset
from lfcal_gui.pages.camera._lattice_view import LatticeView
from lfcal_gui.pages.camera.model_check import Checked
from lfcal_gui.pages.camera.model_lattice_map import lattice_words
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import WrappedLabel, line

__all__ = ["CheckPanel"]

EMPTY = "Hold the camera against a white image: is the lattice where the description says?"
WHITE = "A frame of an even light, taken with this camera: shows whether pitch, rotation and offset are right"
DARK = "A frame without light, taken off the white image: needed where the sensor has a black level or hot pixels"
COLUMNS = ("", "Verdict", "Off by (px)", "Camera", "White image")
ROW = 19
"""Height of a row (px): all are seen below the forms of a low window."""


class CheckPanel(QWidget):
    """Picture and table, or what to do where there is none.

    Signals
    -------
    asked
        A white image is to be chosen.
    dark_asked
        A dark frame is to be chosen.
    taken
        The measured lattice is to become the camera's.
    """

    asked = Signal()
    dark_asked = Signal()
    taken = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.stack = QStackedWidget()
        layout = QVBoxLayout(self)
        layout.setContentsMargins(4, 4, 4, 4)
        layout.addWidget(self.stack)
        self.empty = EmptyState(
            EMPTY, {"White image …": (WHITE, self.asked.emit), "Dark frame …": (DARK, self.dark_asked.emit)}
        )
        self.stack.addWidget(self.empty)
        self.view = LatticeView()
        self._make_table()
        self.words, self.about = WrappedLabel(), WrappedLabel()
        self.words.setProperty("role", "value")
        right = QWidget()
        column = QVBoxLayout(right)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(4)
        head = QHBoxLayout()
        head.addWidget(self.words, 1)
        head.addLayout(self._buttons())
        column.addLayout(head)
        column.addWidget(self.about)
        column.addWidget(self.table, 1)
        both = QWidget()
        row = QHBoxLayout(both)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self.view, 1)
        row.addWidget(right, 3)
        self.stack.addWidget(both)
        self._shown: Checked | None = None

    def _make_table(self) -> None:
        self.table = QTableWidget(0, len(COLUMNS))
        self.table.setAccessibleName("camera and white image")
        self.table.setToolTip(
            "What the description says and what the white image shows, and by how many pixels they part"
        )
        self.table.setHorizontalHeaderLabels(list(COLUMNS))
        self.table.verticalHeader().hide()
        self.table.verticalHeader().setMinimumSectionSize(ROW)
        self.table.verticalHeader().setDefaultSectionSize(ROW)
        self.table.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
        self.table.setSelectionMode(QTableWidget.SelectionMode.NoSelection)
        self.table.setWordWrap(False)
        self.table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)

    def _buttons(self) -> QHBoxLayout:
        self.take = QPushButton("Take measured lattice")
        self.take.setProperty("role", "primary")
        self.take.setToolTip(
            "Make pitch, rotation and offset found in the white image the camera's; undo takes it back"
        )
        self.take.clicked.connect(lambda: self.taken.emit())
        again = QPushButton("White image …")
        again.setToolTip(WHITE)
        again.clicked.connect(lambda: self.asked.emit())
        dark = QPushButton("Dark frame …")
        dark.setToolTip(DARK)
        dark.clicked.connect(lambda: self.dark_asked.emit())
        return line(again, dark, self.take)

    def show_waiting(self, name: str) -> None:
        """Say that an image is being compared."""
        self.empty.label.setText(f"Fitting the lattice of {name} …")
        self.stack.setCurrentIndex(0)

    def show_nothing(self, words: str = EMPTY) -> None:
        """Show what to do."""
        self._shown = None
        self.empty.label.setText(words)
        self.stack.setCurrentIndex(0)

    def show_check(self, found: Checked) -> None:
        """Show a comparison."""
        self._shown = found
        self.stack.setCurrentIndex(1)
        self.view.show_check(found)
        self.words.setText(f"{found.name}: {judgement_of(found.check).verdict}")
        self._tell("" if found.check.fit is None else lattice_words(found.check.fit))
        self.take.setEnabled(found.check.camera is not None)
        self._fill()

    def show_taken(self) -> None:
        """Say that the measured lattice is the camera's."""
        self.words.setText("The measured lattice is the camera's now; save the camera to use it elsewhere.")
        self._tell("")
        self.take.setEnabled(False)

    def _tell(self, words: str) -> None:
        self.about.setText(words)
        self.about.setVisible(bool(words))

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
