"""The checks of H in the inspector: list with failed ones first, and meaning and picture of the selected one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import (
    QCheckBox,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QPushButton,
    QScrollArea,
    QStackedWidget,
    QVBoxLayout,
    QWidget,
)

from lfcal_gui.models import Shot
from lfcal_gui.pages.h.model_checks import FIELDS, CheckPicture, CheckRow, QualitySettings, camera_choices
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import (
    LINES,
    ElidedLabel,
    FoldedForm,
    LinePlot,
    Picture,
    RowsTable,
    WrappedLabel,
    button,
    clear,
    column_of,
    line,
    scrolling,
    told_or_shown,
)

COLUMNS = ("", "Check", "Value", "Good", "Bad", "Merit", "Cost")
COST = "Estimated error of a reconstruction (NRMSE) caused by a fault of this size"
MARKS = {"good": "✓", "fair": "▲", "bad": "▲", "unknown": "–"}
"""Mark before each check, which means the same as its colour."""

MARK, VALUE = 24, 112
"""Widths of the columns of marks and values (px)."""

ROW, LEAST_ROWS, PICTURE, PLOT = 24, 3, 132, 80
"""Height of a row (px), smallest number of visible rows, and heights of the picture and of a plot (px)."""

LEAST_DETAILS, WORDS = 72, 150
"""Smallest height of the details of a check, and of long details (px)."""


class ChecksView(QWidget):
    """List of the checks of H, with meaning and remedy of the selected check."""

    folder_asked = Signal()
    """Request to choose the camera of a saved fit."""
    fault_asked = Signal(str, arguments=["name"])
    """Request for the section of the fault atlas about a fault."""
    every_toggled = Signal(bool, arguments=["on"])
    """The user switched between all checks and those that apply."""
    chosen = Signal(int, arguments=["row"])
    """Another check was selected: its index in the rows."""

    def __init__(self) -> None:
        super().__init__()
        self.message, self.stack = told_or_shown("", self._content())
        column = column_of(self.stack, of=self, spacing=6, stretch=0)
        column.addWidget(self._details(), 1)

    # -- building --------------------------------------------------------------------------------------
    def _content(self) -> QWidget:
        content = QWidget()
        column = QVBoxLayout(content)
        column.setContentsMargins(0, 0, 0, 0)
        self.counts, self.redo = WrappedLabel(), QPushButton()
        self.counts.setProperty("role", "hint")
        self.redo.setAccessibleName("Record bad positions again")
        self.redo.setToolTip(
            "Record the bad positions again in Record > Rig, then assemble and check H. The previous H is kept for "
            "comparison"
        )
        self.redo.hide()
        self.table = RowsTable(COLUMNS, 1, brief=(1, 2), spare=(3, 4, 5, 6))
        self.table.setAccessibleName("Checks")
        self.table.setShowGrid(False)
        top = self.table.horizontalHeader()
        top.setMinimumSectionSize(20)
        for number, width in ((0, MARK), (2, VALUE)):
            top.setSectionResizeMode(number, QHeaderView.ResizeMode.Fixed)
            top.resizeSection(number, width)
        title = self.table.horizontalHeaderItem(6)
        if title is not None:
            title.setToolTip(COST)
        self.table.verticalHeader().setDefaultSectionSize(ROW)
        self.table.setMinimumHeight(ROW * (LEAST_ROWS + 1))
        self.table.setSelectionMode(RowsTable.SelectionMode.SingleSelection)
        self.table.itemSelectionChanged.connect(self._chosen)
        for part in (self.counts, self.redo):
            column.addWidget(part)
        column.addWidget(self.table, 1)
        return content

    def _details(self) -> QScrollArea:
        """Return the details of the selected check and the settings, which scroll below the list."""
        self.words = WrappedLabel(rich=True)
        self.words.setTextInteractionFlags(Qt.TextInteractionFlag.TextBrowserInteraction)
        self.words.linkActivated.connect(lambda link: self.fault_asked.emit(link.removeprefix("fault:")))
        self.words.setAccessibleName("Meaning and remedy of the check")
        self._pictures()
        inner = QWidget()
        column = column_of(self.words, self.pictures, self._buttons(), self._settings(), self.summary, of=inner)
        column.setContentsMargins(0, 0, 4, 0)
        column.addStretch()
        self.details = scrolling(inner)
        clear(self.details)
        self._give_room()
        return self.details

    def _give_room(self) -> None:
        """Make space for the whole explanation by showing fewer rows."""
        high = self.words.heightForWidth(self.details.viewport().width() - 4) + 4
        self.details.setMinimumHeight(max(LEAST_DETAILS, min(high, WORDS)))

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Adjust the space of the explanation."""
        super().resizeEvent(event)
        self._give_room()

    def _pictures(self) -> None:
        self.curve, self.unit, self.none = LinePlot("depth z (mm)", "value"), ElidedLabel(), QLabel()
        self.curve.graphics.setMinimumHeight(PLOT)
        self.unit.setProperty("role", "hint")
        self.plotted = QWidget()
        column_of(self.unit, self.curve, of=self.plotted, spacing=0, stretch=1)
        # rows and columns of it need not be pixels of one size
        self.image = Picture("value", axes=("column", "row"), square=False, colour_map="cividis")
        self.none.setProperty("role", "hint")
        self.none.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.none.setWordWrap(True)
        self.pictures = QStackedWidget()
        self.pictures.setFixedHeight(PICTURE)
        for content in (self.none, self.plotted, self.image):
            self.pictures.addWidget(content)

    def _buttons(self) -> QHBoxLayout:
        self.measure_button, self.report_button = QPushButton("Inspect again"), QPushButton("Write report …")
        self.measure_button.setToolTip("Inspect H again, and compare it with its camera (F5)")
        self.report_button.setToolTip("Save all results as an HTML page and as PDF, and as JSON for programs")
        return line(self.measure_button, self.report_button)

    def _settings(self) -> QWidget:
        self.summary = WrappedLabel(role="hint")
        self.every = QCheckBox("List all checks")
        self.every.setToolTip("Also list checks that do not apply to this H")
        self.every.toggled.connect(self.every_toggled.emit)
        tip = "Camera, session, number of patterns and time limit of the inspection"
        self.form = FoldedForm(more=FIELDS, title="Inspection settings", tip=tip, framed=True)
        folder = button("Choose saved fit …", "Compare with the camera of a saved fit", self.folder_asked.emit)
        for part in (folder, self.every):
            self.form.fold_line(part)
        return self.form

    def _chosen(self) -> None:
        number = self.table.chosen()
        if number >= 0:
            self.chosen.emit(number)

    # -- showing ---------------------------------------------------------------------------------------
    def show_settings(self, settings: QualitySettings) -> None:
        """Show the settings."""
        self.form.set_choices("camera", camera_choices(settings))
        self.form.set_values({key: getattr(settings, key) for key in self.form.fields})

    def show_message(self, words: str) -> None:
        """Show a message in place of the checks: progress of an inspection, or why there is none."""
        self.message.setText(words)
        self.stack.setCurrentIndex(0)

    def show_checks(self, counts: str, checks: Sequence[CheckRow], chosen: int = 0) -> None:
        """Show the checks in their order, and select one."""
        colours = _colours()
        self.counts.setText(counts)
        with QSignalBlocker(self.table):
            self.table.show_rows(
                [(MARKS[one.merit], one.title, one.value, one.good, one.bad, one.rating, one.cost) for one in checks],
                colour=lambda row, column: colours[checks[row].merit] if column in (0, 5) else "",
            )
            self.table.clearSelection()
        self.stack.setCurrentIndex(1)
        self.table.choose(min(chosen, len(checks) - 1))

    def show_check(self, words: str, picture: CheckPicture) -> None:
        """Show meaning and remedy of a check as rich text, and its picture."""
        self.words.setText(words)
        self._give_room()
        if picture.values is None:
            self.none.setText(picture.title)
            self.pictures.setCurrentWidget(self.none)
        elif picture.across is not None:
            self.curve.clear()
            self.curve.set_labels(picture.axes[0], picture.unit)
            self.curve.plot.getAxis("left").showLabel(False)  # it would be cut, and is the title
            self.unit.setText(picture.unit)
            symbol = "o" if len(picture.across) < 60 else None
            self.curve.set_curve(picture.unit, picture.across, picture.values, symbol=symbol, colour=LINES[0])
            self.curve.plot.vb.autoRange()
            self.pictures.setCurrentWidget(self.plotted)
        else:
            self.image.set_axes(picture.axes[1], picture.axes[0])
            values = np.asarray(picture.values, np.float64)
            shot = Shot(values, "", picture.unit, picture.title, origin=picture.origin)
            self.image.set_shot(shot, keep_view=False)
            self.pictures.setCurrentWidget(self.image)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        for plot in (self.image, self.curve):
            plot.apply_theme()


def _colours() -> dict[str, str]:
    theme = current_theme()
    return {"good": theme.good, "fair": theme.fair, "bad": theme.bad, "unknown": theme.muted}
