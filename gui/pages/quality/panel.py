"""Quality: the table of metrics; beside it the map of the chosen metric, its curve over depth, and advice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QColor
from PySide6.QtWidgets import (
    QAbstractItemView,
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QPushButton,
    QSlider,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from gui.pages.quality.model import MetricRow
from gui.theme import current_theme
from gui.widgets.cards import card
from gui.widgets.image_view import ImageView
from gui.widgets.plots import LinePlot

__all__ = ["QualityPanel"]

COLUMNS = ("Metric", "Value", "Thresholds", "Merit", "Cost (NRMSE)")
COLOURED = (1, 3)
NO_MAP = "This metric has one value for a plane, not one per position."


class QualityPanel(QWidget):
    """The page's widgets.

    Signals
    -------
    metric_chosen(row)
        Another metric is looked at.
    plane_chosen(z)
        Another plane is looked at.
    plane_asked()
        Show this plane on the PSF page.
    position_clicked(y, x)
        Show the frame of a position.
    """

    metric_chosen = Signal(int)
    plane_chosen = Signal(int)
    plane_asked = Signal()
    position_clicked = Signal(int, int)

    def __init__(self) -> None:
        super().__init__()
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(10)
        grid.addWidget(self._table_card(), 0, 0, 2, 1)
        grid.addWidget(self._map_card(), 0, 1)
        below, column = card("Over depth")
        self.curve = LinePlot("depth z (mm)", "value")
        column.addWidget(self.curve)
        grid.addWidget(below, 1, 1)
        grid.setColumnStretch(0, 3)
        grid.setColumnStretch(1, 2)
        grid.setRowStretch(0, 3)
        grid.setRowStretch(1, 2)

    # -- building --------------------------------------------------------------------------------------
    def _table_card(self) -> QFrame:
        frame, column = card()
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
        for k in range(len(COLUMNS)):
            mode = QHeaderView.ResizeMode.Stretch if k == 2 else QHeaderView.ResizeMode.ResizeToContents
            header.setSectionResizeMode(k, mode)
        self.table.itemSelectionChanged.connect(lambda: self.metric_chosen.emit(self.table.currentRow()))
        self.words = QLabel()
        self.words.setWordWrap(True)
        self.words.setTextFormat(Qt.TextFormat.RichText)
        self.words.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        column.addWidget(self.verdict)
        column.addWidget(self.table, 1)
        column.addWidget(self.words)
        return frame

    def _map_card(self) -> QFrame:
        frame, column = card("Over the positions of a plane")
        self.map = ImageView(xlabel="position x", ylabel="position y", value_label="value")
        self.map.setToolTip("Click a position to see its frame")
        self.map.clicked.connect(self.position_clicked.emit)
        self.map.hovered.connect(self._hovered)
        self.plane_label = QLabel("Plane 0")
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.valueChanged.connect(self.plane_chosen.emit)
        show = QPushButton("Show in PSF")
        show.setToolTip("Go to this plane in the PSF page")
        show.clicked.connect(lambda: self.plane_asked.emit())
        row = QHBoxLayout()
        row.addWidget(self.plane_label)
        row.addWidget(self.slider, 1)
        row.addWidget(show)
        self.readout = QLabel(" ")
        self.readout.setProperty("role", "hint")
        column.addWidget(self.map, 1)
        column.addLayout(row)
        column.addWidget(self.readout)
        return frame

    # -- showing ---------------------------------------------------------------------------------------
    def show_rows(self, verdict: str, rows: tuple[MetricRow, ...], planes: int) -> None:
        """Show all metrics of a report over so many planes, and choose the first."""
        theme = current_theme()
        colours = {"good": theme.good, "fair": theme.fair, "bad": theme.bad, "unknown": theme.muted}
        self.verdict.setText(verdict)
        blocker = QSignalBlocker(self.table)
        self.table.setRowCount(len(rows))
        for k, row in enumerate(rows):
            for column, text in enumerate((row.title, row.value, row.limits, row.merit, row.cost)):
                item = QTableWidgetItem(text)
                item.setToolTip(text)
                if column in COLOURED:
                    item.setForeground(QColor(colours[row.merit]))
                self.table.setItem(k, column, item)
        self.slider.setRange(0, planes - 1)
        self.slider.setEnabled(planes > 1)
        self.table.selectRow(0)
        blocker.unblock()
        # a selection that stays the same row is not reported, though the row shows another report now
        self.metric_chosen.emit(0)

    def show_metric(self, title: str, words: str) -> None:
        """Show what a metric means and what to do; ``title`` is for the axes, with the unit."""
        self.words.setText(words)
        self.map.set_value_label(title)
        self.curve.clear()

    def show_curve(self, title: str, depths_um: NDArray[np.float64], values: NDArray[np.floating]) -> None:
        """Show a metric over depth."""
        self.curve.set_labels("depth z (mm)", title)
        self.curve.set_curve("value", depths_um / 1e3, values, symbol="o")

    def show_map(self, z: int, image: NDArray[np.float32] | None, name: str) -> None:
        """Show a metric over the positions ``(ny, nx)`` of plane ``z``; None: it has no value per position."""
        self.plane_label.setText(f"Plane {z}")
        self.map.set_image(image, name=name)
        self.readout.setText(NO_MAP if image is None else " ")

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.map.apply_theme()
        self.curve.apply_theme()

    def _hovered(self, y: int, x: int, value: float) -> None:
        if y >= 0:
            self.readout.setText(f"position y {y}, x {x}: {value:.4g}; click to see its frame")
