"""Comparison of two H: linked patterns, numbers, and positions that differ."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QSignalBlocker, QTimer, Signal
from PySide6.QtGui import QHideEvent
from PySide6.QtWidgets import (
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QVBoxLayout,
    QWidget,
)

from lfcal_gui.models import (
    COMPARED_COLUMNS,
    COMPARED_MODES,
    COMPARED_TIPS,
    SCALES,
    Both,
    DisplaySettings,
    Place,
    Shot,
    Symbols,
)
from lfcal_gui.widgets._blank import NOTHING
from lfcal_gui.widgets.cards import button, card, choice_box, column_of, line, told_or_shown
from lfcal_gui.widgets.picture import Picture, link, share_contrast
from lfcal_gui.widgets.rows_table import RowsTable
from lfcal_gui.widgets.words import ElidedLabel, WrappedLabel

BLINK_MS = 600
NOT_COMPARED = "Not compared: no position of this plane has light in both."
MISSING = "#ff5a5f"
PAIRING = (("depth", "by depth"), ("number", "by number"))
NUMBERS = (1, 2, 3, 4, 5)
SPARE = (1, 2, 4, 5)


_SEEN = {"side": (True, True, True), "blink": (True, False, False), "difference": (False, False, True)}
"""Pictures that each mode shows."""


class ComparedNumbers(QWidget):
    """Narrow column with the name of the second H, the verdict, the positions that differ most, and a table of numbers.

    Parameters
    ----------
    whole
        Whether the table of numbers is as high as its rows.
    """

    choose_asked, compare_asked, report_asked = Signal(), Signal(), Signal()
    """The user asks to choose a second H, to compare, or to write the report."""
    pairing_chosen = Signal(bool, arguments=["by_number"])
    """The user chose how planes are paired."""
    row_chosen = Signal(int, arguments=["row"])
    """A row of the table of numbers was selected."""
    place_chosen = Signal(tuple, arguments=["place"])
    """A position was selected."""

    def __init__(self, *, whole: bool = True) -> None:
        super().__init__()
        self.second = ElidedLabel("Second H: none", role="value")
        self.choose_button = button("Choose …", "Choose the H with which this one is compared", self.choose_asked.emit)
        self.pairing = choice_box(
            PAIRING, "Compare planes of the same depth, or of the same number", "pairing of the planes"
        )
        self.pairing.currentIndexChanged.connect(
            lambda: self.pairing_chosen.emit(self.pairing.currentData() == "number")
        )
        tip = "Write an HTML page with the images side by side, and files with all numbers"
        self.report_button = button("Write report …", tip, self.report_asked.emit)
        self.compare_button = button("Compare", "Compare all positions of both H (F5)", self.compare_asked.emit)
        self.verdict, self.notes = WrappedLabel(), WrappedLabel()
        self.verdict.setProperty("role", "value")
        self.notes.setProperty("role", "hint")
        self.worst = choice_box(
            [], "Show one of the positions (z, y, x) that differ most", "positions that differ most"
        )
        self.worst.activated.connect(lambda k: self.place_chosen.emit(self.worst.itemData(k)))
        self.table = RowsTable(COMPARED_COLUMNS, 0, NUMBERS, spare=SPARE, whole=whole)
        self.table.setAccessibleName("Numbers of the comparison")
        for k, tip in enumerate(COMPARED_TIPS):
            title = self.table.horizontalHeaderItem(k)
            if title is not None:
                title.setToolTip(tip)
        self.table.verticalHeader().setDefaultSectionSize(24)
        self.table.setSelectionMode(RowsTable.SelectionMode.SingleSelection)
        self.table.itemSelectionChanged.connect(self._row_chosen)
        column = column_of(of=self, spacing=6)
        self.message, self.stack = told_or_shown("", self._content())
        self._arrange(column)

    # -- building --------------------------------------------------------------------------------------
    def _arrange(self, column: QVBoxLayout) -> None:
        column.addLayout(line(self.second, self.choose_button, stretch=0))
        column.addLayout(line("Planes", self.pairing, stretch=1))
        column.addLayout(line(self.compare_button, self.report_button))
        column.addWidget(self.stack, 1)

    def _content(self) -> QWidget:
        content = QWidget()
        column = QVBoxLayout(content)
        column.setContentsMargins(0, 0, 0, 0)
        column.addWidget(self.verdict)
        column.addWidget(self.notes)
        column.addLayout(line("Differs most at", self.worst, stretch=1))
        column.addWidget(self.table)
        column.addStretch()
        return content

    # -- showing ---------------------------------------------------------------------------------------
    def show_second(self, name: str, *, by_number: bool) -> None:
        """Show the name of the second H; empty: there is none."""
        self.second.setText(f"Second H: {name or 'none'}")
        with QSignalBlocker(self.pairing):
            self.pairing.setCurrentIndex(int(by_number))

    def show_message(self, words: str) -> None:
        """Show a message in place of a comparison: what to do, the progress, or why there is none."""
        self.message.setText(words)
        self.stack.setCurrentIndex(0)

    def show_numbers(
        self,
        names: tuple[str, str],
        words: tuple[str, str],
        rows: Sequence[tuple[str, ...]],
        numbers: Sequence[tuple[float, ...]],
        worst: Sequence[tuple[str, Place]],
    ) -> None:
        """Show the numbers of a comparison; ``words`` are its verdict and what was omitted."""
        self.verdict.setText(words[0])
        self.notes.setText(words[1])
        with QSignalBlocker(self.table):
            self.table.show_rows(rows, numbers)
        self.worst.clear()
        for text, place in worst:
            self.worst.addItem(text, place)
        self.worst.setEnabled(bool(worst))
        self.stack.setCurrentIndex(1)

    def show_worst(self, place: Place) -> None:
        """Select the displayed position in the list of those that differ most, if it is in the list."""
        at = self.worst.findData(place)
        if at >= 0:
            self.worst.setCurrentIndex(at)

    def _row_chosen(self) -> None:
        number = self.table.chosen()
        if number >= 0:
            self.row_chosen.emit(number)


class ComparePanel(ComparedNumbers):
    """Numbers and pictures of the comparison of two H."""

    def __init__(self) -> None:
        self._both: Both | None = None
        self._plane = 0
        self._names = ("first", "second")
        self._second = False
        self._where = ""
        super().__init__(whole=False)
        self._timer = QTimer(self, interval=BLINK_MS)
        self._timer.timeout.connect(self._blink)

    # -- building --------------------------------------------------------------------------------------
    def _arrange(self, column: QVBoxLayout) -> None:
        parts = self.second, self.choose_button, "Planes", self.pairing, QWidget(), self.report_button
        column.addLayout(line(*parts, self.compare_button, stretch=4))
        column.addWidget(self.stack, 1)

    def _content(self) -> QWidget:
        content = QWidget()
        grid = QGridLayout(content)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(8)
        words = QVBoxLayout()
        words.setSpacing(2)
        words.addWidget(self.verdict)
        words.addWidget(self.notes)
        table, inside = card("Numbers by plane and lens type")
        inside.addWidget(self.table)
        grid.addLayout(words, 0, 0, 1, 2)
        grid.addWidget(self._pictures(), 1, 0, 1, 2)
        grid.addWidget(table, 2, 0)
        grid.addWidget(self._map(), 2, 1)
        grid.setColumnStretch(0, 2)
        grid.setColumnStretch(1, 1)
        grid.setRowStretch(1, 6)
        grid.setRowStretch(2, 5)
        return content

    def _pictures(self) -> QFrame:
        frame, column = card()
        self.mode = choice_box(
            COMPARED_MODES,
            "Show the images alternating to see shifts, their difference to see missing light, or side by side",
            "display of both H",
        )
        self.mode.currentIndexChanged.connect(lambda: self._show_mode())
        self.scaling = choice_box(
            [(scale, scale) for scale in SCALES],
            "Gamma and log show faint light. Both patterns have the same scale",
            "scaling",
        )
        self.scaling.currentIndexChanged.connect(lambda: self._show_scaling())
        self.worst.setMinimumWidth(190)
        self.readout = QLabel(" ")
        self.readout.setProperty("role", "hint")
        column.addLayout(line("Show", self.mode, self.scaling, "Differs most at", self.worst, self.readout, stretch=5))
        self.titles = tuple(ElidedLabel() for _ in range(3))
        self.views = Picture("value"), Picture("value at equal light"), Picture("difference")
        share_contrast(*self.views[:2])
        row = QHBoxLayout()
        self._cells = []
        for k, (title, view) in enumerate(zip(self.titles, self.views, strict=True)):
            title.setProperty("role", "heading")
            cell = QWidget()
            inside = QVBoxLayout(cell)
            inside.setContentsMargins(0, 0, 0, 0)
            inside.addWidget(title)
            inside.addWidget(view, 1)
            row.addWidget(cell, 1)
            self._cells.append(cell)
            view.hovered.connect(lambda t, s, value, k=k: self._hovered(t, s))
        link(*self.views)
        column.addLayout(row, 1)
        return frame

    def _map(self) -> QFrame:
        self.map_title = QLabel("Difference by position")
        frame, column = card(self.map_title)
        self.map = Picture("difference (%)", axes=("position x (px)", "position y (px)"), colour_map="cividis")
        self.map.setToolTip("Click a position to see both patterns. Positions crossed out were not compared")
        self.map.clicked.connect(lambda y, x: self.place_chosen.emit((self._plane, y, x)))
        column.addWidget(self.map)
        return frame

    # -- showing ---------------------------------------------------------------------------------------
    def show_message(self, words: str) -> None:
        """Show a message in place of a comparison: what to do, the progress, or why there is none."""
        self._timer.stop()
        self._both = None
        super().show_message(words)

    def show_numbers(
        self,
        names: tuple[str, str],
        words: tuple[str, str],
        rows: Sequence[tuple[str, ...]],
        numbers: Sequence[tuple[float, ...]],
        worst: Sequence[tuple[str, Place]],
    ) -> None:
        """Show the numbers of a comparison; ``words`` are its verdict and what was omitted."""
        self._names, self._both = names, None
        self._timer.stop()
        for view in (*self.views, self.map):  # empty until the new ones are read
            view.set_shot(None)
        self.map.blank.words = NOTHING
        for title in (*self.titles, self.map_title):
            title.setText(" ")
        super().show_numbers(names, words, rows, numbers, worst)

    def show_map(self, plane: int, title: str, error: NDArray[np.floating], levels: tuple[float, float]) -> None:
        """Show the differences (%) over the positions ``(ny, nx)`` of a pair of planes; NaN: not compared."""
        self._plane = plane
        self.map_title.setText(title)
        known = np.isfinite(error)
        self.map.blank.words = "" if known.any() else NOT_COMPARED
        missing = Symbols(np.argwhere(~known).astype(float), "x", MISSING, 7)
        shot = Shot(error, name="difference", levels=levels, overlays=(missing,))
        self.map.set_shot(shot if known.any() else None)

    def show_both(self, both: Both, where: str) -> None:
        """Show a position of both H."""
        self._both = both
        self.map.set_cross(*both.place[1:])
        first, second = self._names
        self._where = f"{first} {where}"
        self.titles[1].setText(second)
        self.titles[2].setText("Difference")
        self.show_worst(both.place)
        self._show_mode()

    def _show_mode(self) -> None:
        mode = self.mode.currentData()
        for cell, seen in zip(self._cells, _SEEN[mode], strict=True):
            cell.setVisible(seen)
        self._second = False
        if self._both is None:
            return
        both = self._both
        self.titles[0].setText(self._where)
        self._show_first(both, "first")
        self.views[1].set_shot(Shot(both.second, name="second", levels=both.levels))
        self.views[2].set_shot(Shot(both.difference, name="difference", levels=both.signed_levels, signed=True))
        if mode == "blink":
            self._timer.start()
        else:
            self._timer.stop()

    def _show_scaling(self) -> None:
        for view in self.views[:2]:
            view.set_display(DisplaySettings(scale=self.scaling.currentData()))
        self._show_mode()

    def _blink(self) -> None:
        """Switch between the two patterns."""
        if self._both is None:
            return
        self._second = not self._second
        self.titles[0].setText(self._names[1] if self._second else self._where)
        self._show_first(self._both, "second" if self._second else "first")

    def _show_first(self, both: Both, name: str) -> None:
        self.views[0].set_shot(Shot(getattr(both, name), name=name, levels=both.levels))

    def hideEvent(self, event: QHideEvent) -> None:
        """Stop blinking while the panel is hidden."""
        self._timer.stop()
        super().hideEvent(event)

    def _hovered(self, t: int, s: int) -> None:
        both = self._both
        if both is None or t < 0:
            self.readout.setText(" ")
            return
        a, b = float(both.first[t, s]), float(both.second[t, s])
        self.readout.setText(f"t {t}, s {s}: {a:.5g}, {b:.5g}, difference {a - b:+.4g}")

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        for view in (*self.views, self.map):
            view.apply_theme()
