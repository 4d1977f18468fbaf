"""Quality: is the PSF good, what is wrong if not, and what to record again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import Qt
from PySide6.QtGui import QColor
from PySide6.QtWidgets import (
    QAbstractItemView,
    QFileDialog,
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QPushButton,
    QSlider,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
)

from gui.base_page import StagePage
from gui.context import Context
from gui.models.page import Stage
from gui.models.project import SessionState
from gui.pages.quality.model import map_of, rows_of, words_of, worst_positions
from gui.theme import current_theme
from gui.widgets.image_view import ImageView
from gui.widgets.plots import LinePlot
from lfcal.errors import LfcalError

if TYPE_CHECKING:
    from lfcal.psf.quality import Metric, QualityReport

__all__ = ["Page"]

COLUMNS = ("Metric", "Value", "Thresholds", "Merit", "Cost (NRMSE)")


class Page(StagePage):
    """The table on the left; on the right the map of the chosen metric, its curve over planes, and advice."""

    def __init__(self, stage: Stage, context: Context) -> None:
        super().__init__(stage, context)
        self.report: QualityReport | None = None
        self._measured = ""
        self._running = ""
        self._z = 0
        self.tool_button("Measure again", "Inspect H anew", lambda: self.measure(force=True))
        self.redo_button = self.tool_button(
            "Send to Acquire", "Positions that should be recorded again become a list for Acquire", self.send
        )
        self.report_button = self.tool_button(
            "Write report …",
            "A page with all figures, for the browser and the printer",
            self.write_report,
            primary=True,
        )
        self._build()
        context.theme_changed.connect(self._apply_theme)
        self._follow()

    # -- building --------------------------------------------------------------------------------------
    def _build(self) -> None:
        self.verdict = QLabel()
        self.verdict.setWordWrap(True)
        self.verdict.setProperty("role", "value")
        self.table = QTableWidget(0, len(COLUMNS))
        self.table.setHorizontalHeaderLabels(COLUMNS)
        self.table.verticalHeader().hide()
        self.table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.table.setWordWrap(False)
        header = self.table.horizontalHeader()
        for column in range(len(COLUMNS)):
            mode = QHeaderView.ResizeMode.Stretch if column == 2 else QHeaderView.ResizeMode.ResizeToContents
            header.setSectionResizeMode(column, mode)
        self.table.itemSelectionChanged.connect(self._chosen)
        self.words = QLabel()
        self.words.setWordWrap(True)
        self.words.setTextFormat(Qt.TextFormat.RichText)
        self.words.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.map = ImageView(xlabel="position x", ylabel="position y", value_label="value")
        self.map.setToolTip("Click a position to see its frame")
        self.map.clicked.connect(self._clicked)
        self.map.hovered.connect(self._hovered)
        self.readout = QLabel(" ")
        self.readout.setProperty("role", "hint")
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.valueChanged.connect(self._plane)
        self.curve = LinePlot("depth z (mm)", "value")
        grid = QGridLayout(self.body)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(10)
        left, column = _card("")
        column.addWidget(self.verdict)
        column.addWidget(self.table, 1)
        column.addWidget(self.words)
        grid.addWidget(left, 0, 0, 2, 1)
        right, column = _card("Over the positions of a plane")
        column.addWidget(self.map, 1)
        row = QHBoxLayout()
        self.plane_label = QLabel("Plane 0")
        row.addWidget(self.plane_label)
        row.addWidget(self.slider, 1)
        show = QPushButton("Show in PSF")
        show.setToolTip("Go to this plane in the PSF page")
        show.clicked.connect(lambda: self.context.go.emit("psf", (self._z, 0, 0)))
        row.addWidget(show)
        column.addLayout(row)
        column.addWidget(self.readout)
        grid.addWidget(right, 0, 1)
        below, column = _card("Over depth")
        column.addWidget(self.curve)
        grid.addWidget(below, 1, 1)
        grid.setColumnStretch(0, 3)
        grid.setColumnStretch(1, 2)
        grid.setRowStretch(0, 3)
        grid.setRowStretch(1, 2)

    # -- session ---------------------------------------------------------------------------------------
    def state_changed(self, old: SessionState, new: SessionState) -> None:
        """Forget the report of another H."""
        if old.psf != new.psf:
            self._follow()

    def entered(self) -> None:
        """Measure when the page is first looked at."""
        self.measure()

    def _follow(self) -> None:
        psf = self.context.state.psf
        self.redo_button.setEnabled(False)
        self.report_button.setEnabled(bool(psf))
        if not psf or not Path(psf).exists():
            self.report = None
            self.show_empty(
                "No PSF to judge yet.\nAssemble frames, or open an H file on the PSF page.",
                {
                    "Frames": lambda: self.context.go.emit("frames", None),
                    "PSF": lambda: self.context.go.emit("psf", None),
                },
            )
        elif psf != self._measured:
            self.report = None
            self.show_empty("H is not measured yet.", {"Measure": self.measure})
            if self.isVisible():
                self.measure()

    def measure(self, *, force: bool = False) -> None:
        """Inspect H as a job, once per H."""
        from lfcal.psf import open_psf
        from lfcal.psf.quality import iter_inspect

        psf = self.context.state.psf
        if not psf or not Path(psf).exists() or self._running == psf or (psf == self._measured and not force):
            return
        try:
            matrix = open_psf(psf)  # its own: planes are read while the PSF page shows others
        except LfcalError as error:
            self.context.message.emit(str(error))
            return
        self._running = psf
        self.show_empty("measuring …")

        def done(report: QualityReport) -> None:
            matrix.close()
            self._running = ""
            if psf == self.context.state.psf:
                self._measured = psf
                self._show(report)

        def failed(job: Any) -> None:
            matrix.close()
            self._running = ""
            self.show_empty(job.error, {"Try again": lambda: self.measure(force=True)})

        title = f"Inspect {Path(psf).name}"
        self.context.jobs.start(title, "quality", lambda: iter_inspect(matrix), done, failed)

    # -- showing ---------------------------------------------------------------------------------------
    def _show(self, report: QualityReport) -> None:
        self.report = report
        self.show_body()
        theme = current_theme()
        colours = {"good": theme.good, "fair": theme.fair, "bad": theme.bad, "unknown": theme.muted}
        self.verdict.setText(report.verdict)
        rows = rows_of(report)
        self.table.setRowCount(len(rows))
        for k, row in enumerate(rows):
            for column, text in enumerate((row.title, row.value, row.limits, row.merit, row.cost)):
                item = QTableWidgetItem(text)
                item.setToolTip(text)
                if column in (1, 3):
                    item.setForeground(QColor(colours[row.merit]))
                self.table.setItem(k, column, item)
        redo = worst_positions(report)
        self.redo_button.setEnabled(bool(redo))
        self.redo_button.setText(f"Send {len(redo)} to Acquire" if redo else "Send to Acquire")
        self.context.attention.emit("quality", report.merit == "bad")
        planes = max((len(m.map) for m in report.metrics if m.map is not None), default=1)
        self.slider.setRange(0, planes - 1)
        self.slider.setEnabled(planes > 1)
        self.table.selectRow(0)

    def _metric(self) -> Metric | None:
        row = self.table.currentRow()
        if self.report is None or not 0 <= row < len(self.report.metrics):
            return None
        return self.report.metrics[row]

    def _chosen(self) -> None:
        metric = self._metric()
        if metric is None:
            return
        self.words.setText(words_of(metric))
        unit = f" ({metric.spec.unit})" if metric.spec.unit else ""
        self.map.set_value_label(f"{metric.spec.title}{unit}")
        self._show_map(metric)
        self.curve.clear()
        matrix = self.context.matrix(self.context.state.psf)
        if metric.per_plane.size > 1 and matrix is not None and metric.per_plane.size == len(matrix):
            self.curve.set_labels("depth z (mm)", f"{metric.spec.title}{unit}")
            self.curve.set_curve("value", matrix.depths / 1e3, metric.per_plane, symbol="o")

    def _show_map(self, metric: Metric) -> None:
        image = map_of(metric, self._z)
        self.plane_label.setText(f"Plane {self._z}")
        self.map.set_image(image, name=metric.key)
        self.readout.setText(
            " " if image is not None else "This metric has one value for a plane, not one per position."
        )

    def _plane(self, z: int) -> None:
        self._z = z
        metric = self._metric()
        if metric is not None:
            self._show_map(metric)

    def _hovered(self, y: int, x: int, value: float) -> None:
        if y >= 0:
            self.readout.setText(f"position y {y}, x {x}: {value:.4g}; click to see its frame")

    def _clicked(self, y: int, x: int) -> None:
        self.context.go.emit("frames" if self.context.state.frames.folder else "psf", (self._z, y, x))

    # -- doing -----------------------------------------------------------------------------------------
    def send(self) -> None:
        """Hand the positions to be recorded again to Acquire."""
        if self.report is not None:
            redo = worst_positions(self.report)
            self.context.session.update("positions to record again", redo=redo)
            self.context.message.emit(f"{len(redo)} positions to be recorded again")
            self.context.go.emit("acquire", None)

    def write_report(self, folder: str = "") -> None:
        """Write the report as a job."""
        from lfcal.psf import open_psf
        from lfcal.psf.report import iter_report

        psf = self.context.state.psf
        folder = folder or QFileDialog.getExistingDirectory(self, "Folder for the report")
        if not folder or not psf:
            return
        matrix = open_psf(psf)

        measured = self.report if psf == self._measured else None

        def done(page: Path) -> None:
            matrix.close()
            self.context.message.emit(f"report written: {page}")

        self.context.jobs.start(
            "Report",
            "quality",
            lambda: iter_report(matrix, Path(folder), quality=measured),
            done,
            lambda job: matrix.close(),
        )

    def _apply_theme(self) -> None:
        self.map.apply_theme()
        self.curve.apply_theme()
        if self.report is not None:
            self._show(self.report)


def _card(title: str) -> tuple[QFrame, QVBoxLayout]:
    frame = QFrame()
    frame.setProperty("role", "card")
    column = QVBoxLayout(frame)
    column.setContentsMargins(12, 8, 12, 10)
    if title:
        heading = QLabel(title)
        heading.setProperty("role", "heading")
        column.addWidget(heading)
    return frame, column
