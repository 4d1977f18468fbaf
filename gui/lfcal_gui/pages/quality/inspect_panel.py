"""Quality: the verdict, faults and metrics beside it, what each means, and the pictures that show it."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import QCheckBox, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from lfcal_gui.pages.quality.evidence_view import EvidenceView
from lfcal_gui.pages.quality.model import FIELDS, FaultRow, MetricRow, QualitySettings, camera_choices
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import FittedBrowser, FoldedForm, RowsTable, card, heading, split

__all__ = ["InspectPanel"]

FAULTS = ("Fault", "What was found", "Error made (NRMSE)", "Sure")
METRICS = ("Metric", "Value", "Good", "Bad", "Merit", "Cost")
COST = "Estimate of the error of a reconstruction (NRMSE) that a fault of this size makes"
FORM = 320
"""Width of the settings (px)."""

ROW, MOST_ROWS = 26, 5
"""Height of a row of faults, and rows that are seen without scrolling."""


class InspectPanel(QWidget):
    """What is wrong with H, and what to do.

    Signals
    -------
    edited(key, value)
        A setting was changed.
    folder_asked()
        The camera of a saved fit is wanted.
    fault_asked(name)
        What the atlas tells of a fault is wanted.
    every_toggled(on)
        All metrics are to be listed, or those that apply.
    fault_chosen(row), metric_chosen(row)
        Another fault, or metric, is looked at.
    """

    edited = Signal(str, object)
    folder_asked = Signal()
    fault_asked = Signal(str)
    every_toggled = Signal(bool)
    fault_chosen = Signal(int)
    metric_chosen = Signal(int)

    def __init__(self) -> None:
        super().__init__()
        self.evidence = EvidenceView()
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 8, 0, 0)
        column.setSpacing(8)
        column.addLayout(self._head())
        column.addWidget(split(self._tables(), self.evidence, sizes=(690, 370)), 1)

    # -- building --------------------------------------------------------------------------------------
    def _head(self) -> QHBoxLayout:
        self.verdict = QLabel()
        self.verdict.setWordWrap(True)
        self.verdict.setProperty("role", "value")
        self.verdict.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.summary = QLabel()
        self.summary.setWordWrap(True)
        self.summary.setProperty("role", "hint")
        words = QVBoxLayout()
        words.setSpacing(2)
        words.addWidget(self.verdict)
        words.addWidget(self.summary)
        self.redo = QPushButton()
        self.redo.setAccessibleName("record bad positions again")
        self.redo.setToolTip(
            "Record the bad positions again, then make and judge a new H; the previous H becomes the reference"
        )
        self.redo.hide()
        words.addWidget(self.redo, 0, Qt.AlignmentFlag.AlignLeft)
        words.addStretch()
        tip = "Camera, session, number of patterns and time of the inspection"
        self.form = FoldedForm(more=FIELDS, title="What H is compared with", tip=tip, framed=True)
        self.form.edited.connect(self.edited.emit)
        self.form.setFixedWidth(FORM)
        self.folder_button = QPushButton("Fit folder …")
        self.folder_button.setToolTip("Compare with the camera of a fit that was saved")
        self.folder_button.clicked.connect(lambda: self.folder_asked.emit())
        self.form.fold_line(self.folder_button)
        row = QHBoxLayout()
        row.setSpacing(12)
        row.addLayout(words, 1)
        row.addWidget(self.form, 0, Qt.AlignmentFlag.AlignTop)
        return row

    def _tables(self) -> QWidget:
        frame, column = card()
        self.faults = RowsTable(FAULTS, 1, brief=(1,))
        self.faults.setAccessibleName("faults")
        self.no_faults = QLabel("None is known: see above what was compared.")
        self.no_faults.setProperty("role", "hint")
        self.no_faults.setWordWrap(True)
        self.table = RowsTable(METRICS, 0)
        self.table.setAccessibleName("metrics")
        title = self.table.horizontalHeaderItem(5)
        if title is not None:
            title.setToolTip(COST)
        for table, signal in ((self.faults, self.fault_chosen), (self.table, self.metric_chosen)):
            table.verticalHeader().setDefaultSectionSize(ROW)
            table.setSelectionMode(RowsTable.SelectionMode.SingleSelection)
            table.itemSelectionChanged.connect(lambda t=table, s=signal: self._chosen(t, s))
        self.words = FittedBrowser(108, 170)
        self.words.setOpenLinks(False)
        self.words.anchorClicked.connect(lambda link: self.fault_asked.emit(link.path()))
        self.words.setAccessibleName("what it means, and what to do")
        column.addWidget(heading("Faults by the camera's model"))
        column.addWidget(self.no_faults)
        column.addWidget(self.faults)
        self.counts = QLabel()
        self.counts.setProperty("role", "hint")
        self.every = QCheckBox("List all")
        self.every.setToolTip("List metrics that do not apply to this H, too")
        self.every.toggled.connect(self.every_toggled.emit)
        head = QHBoxLayout()
        head.addWidget(heading("Metrics that need no model"))
        head.addWidget(self.counts, 1)
        head.addWidget(self.every)
        column.addLayout(head)
        column.addWidget(self.table, 1)
        column.addWidget(self.words)
        return frame

    def _chosen(self, table: RowsTable, signal: Signal) -> None:
        rows = {index.row() for index in table.selectedIndexes()}
        if not rows:
            return
        other = self.table if table is self.faults else self.faults
        blocker = QSignalBlocker(other)
        other.clearSelection()
        blocker.unblock()
        signal.emit(table.number_of(rows.pop()))  # type: ignore[attr-defined]

    # -- showing ---------------------------------------------------------------------------------------
    def show_settings(self, settings: QualitySettings) -> None:
        """Show what the user chose."""
        self.form.set_choices("camera", camera_choices(settings))
        self.form.set_values({key: getattr(settings, key) for key in self.form.fields})

    def show_all(
        self, verdict: str, merit: str, summary: str, faults: Sequence[FaultRow], metrics: Sequence[MetricRow]
    ) -> None:
        """Show an inspection, and choose what matters most; ``merit`` colours the verdict."""
        colours = _colours()
        self.verdict.setText(verdict)
        self.verdict.setStyleSheet(f"color: {colours[merit]};")
        self.summary.setText(summary)
        blockers = [QSignalBlocker(table) for table in (self.faults, self.table)]
        self.faults.show_rows(
            [(f.title, f.detail, f.weight, f.sure) for f in faults],
            colour=lambda row, column: colours[faults[row].merit] if column in (0, 2) else "",
        )
        self.faults.setVisible(bool(faults))
        top = self.faults.horizontalHeader().sizeHint().height() + 4
        self.faults.setFixedHeight(top + ROW * min(len(faults), MOST_ROWS))
        self.no_faults.setVisible(not faults)
        self.table.show_rows(
            [(m.title, m.value, m.good, m.bad, m.told, m.cost) for m in metrics],
            colour=lambda row, column: colours[metrics[row].merit] if column in (1, 4) else "",
        )
        for table in (self.faults, self.table):
            table.clearSelection()
        for blocker in blockers:
            blocker.unblock()
        # what matters most is looked at first
        (self.faults if faults else self.table).selectRow(0)

    def show_words(self, words: str) -> None:
        """Show what a fault or metric means and what to do, as rich text."""
        self.words.setHtml(words)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.evidence.apply_theme()


def _colours() -> dict[str, str]:
    theme = current_theme()
    return {"good": theme.good, "fair": theme.fair, "bad": theme.bad, "unknown": theme.muted}
