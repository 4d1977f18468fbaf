"""The sensor measured: folders of flats and darks, the figures, the photon-transfer curve, and taking them over."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import (
    QDialog,
    QFileDialog,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QProgressBar,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from lfcal.base import InputError, Work
from lfcal.camera import Camera
from lfcal.frames.photon_transfer import (
    SensorMeasurement,
    figures_of,
    find_frames,
    iter_measure_sensor,
    sensor_differences,
)
from lfcal_gui.context import Context
from lfcal_gui.jobs import WindowJob
from lfcal_gui.widgets import LINES, LinePlot


@dataclass(frozen=True)
class Curves:
    """Noise over signal (counts), arrays of x and y each: points fitted, other points, and the fit."""

    fitted: tuple[NDArray[np.float64], NDArray[np.float64]]
    others: tuple[NDArray[np.float64], NDArray[np.float64]]
    fit: tuple[NDArray[np.float64], NDArray[np.float64]]


def iter_sensor(camera: Camera, flats: Path, darks: Path) -> Work[SensorMeasurement]:
    """Yield progress and return the sensor's figures; the colour filter is that of the files, else the camera's."""
    (lit, facts), (dark, _) = find_frames(flats), find_frames(darks)
    found: SensorMeasurement = yield from iter_measure_sensor(lit, dark, cfa=str(facts.get("cfa") or camera.sensor.cfa))
    return found


def rows_of(found: SensorMeasurement, camera: Camera) -> list[tuple[str, str]]:
    """Return name and value of every figure, and of the full well that ``camera`` would take."""
    return figures_of(found, camera.sensor)


def words_of(found: SensorMeasurement, camera: Camera) -> str:
    """Return the remarks on the figures, one line each: doubts, differences from ``camera``, notes."""
    doubts = [f"Not the sensor's own: {doubt}." for doubt in found.doubts]
    notes = (*sensor_differences(found, camera.sensor), *found.notes)
    return "\n".join([*doubts, *(f"{note[:1].upper()}{note[1:]}." for note in notes)])


def taken(found: SensorMeasurement, camera: Camera) -> tuple[Camera | None, str]:
    """Return ``camera`` with the measured sensor, or None and why it cannot be taken."""
    try:
        return found.camera(camera), ""
    except InputError as error:
        return None, str(error)


def curves_of(found: SensorMeasurement) -> Curves:
    """Return the photon-transfer curve to be drawn on logarithmic axes."""
    curve = found.curve
    lit = (curve.points.x > 0) & (curve.points.y > 0)
    x, y = curve.points.x, np.sqrt(np.maximum(curve.points.y, 0))
    empty = np.zeros(0)
    fit = (empty, empty)
    if curve.slope is not None and lit.any():
        over = np.geomspace(max(float(x[lit].min()) / 3, 1e-2), curve.limit, 100)
        fit = (over, np.sqrt(curve.variance(over)))
    used = curve.used
    return Curves((x[lit & used], y[lit & used]), (x[lit & ~used], y[lit & ~used]), fit)


HINT = (
    "Flats: two or more frames at each level of light; white images through the lenslets are suitable. Darks: two or "
    "more with the cap on. The files must be unprocessed: no gamma, no noise reduction, no JPEG."
)

AXES = ("signal above black (counts)", "noise, rms (counts)")


class SensorDialog(QDialog):
    """Measure the sensor of the project's camera, and take the figures over.

    Parameters
    ----------
    parent, context
        The page, and what it may use of the window.
    take
        Called with the camera as measured, and a label for undoing it; returns whether it was taken.
    """

    def __init__(self, parent: QWidget, context: Context, take: Callable[[Camera, str], bool]) -> None:
        super().__init__(parent)
        self.setWindowTitle("Measure the sensor")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.resize(940, 560)
        self.context, self._take_over = context, take
        self.flats, self.darks = "", ""
        self.found: SensorMeasurement | None = None
        self._job = 0
        self.words = QLabel(HINT)
        self.words.setWordWrap(True)
        self.words.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.bar = QProgressBar()
        self.bar.setVisible(False)
        self._make_results()
        layout = QVBoxLayout(self)
        layout.addLayout(self._folders())
        layout.addWidget(self.words)
        layout.addWidget(self.bar)
        layout.addWidget(self.results, 1)
        layout.addLayout(self._buttons())
        context.theme_changed.connect(self.apply_theme)
        context.jobs.changed.connect(self._job_changed)
        context.state_changed.connect(self._show_figures)

    def _folders(self) -> QHBoxLayout:
        self.flats_button, self.darks_button = QPushButton("Flats …"), QPushButton("Darks …")
        self.flats_button.setToolTip(
            "A folder of evenly lit frames, two or more at each of several exposures: gain and linearity"
        )
        self.darks_button.setToolTip(
            "A folder of frames without light, at several exposures: read noise, dark current, offsets"
        )
        self.flats_button.clicked.connect(lambda: self.choose("flats"))
        self.darks_button.clicked.connect(lambda: self.choose("darks"))
        self.chosen = QLabel("no folders chosen")
        row = QHBoxLayout()
        row.addWidget(self.flats_button)
        row.addWidget(self.darks_button)
        row.addWidget(self.chosen, 1)
        return row

    def _make_results(self) -> None:
        self.table = QTableWidget(0, 2)
        self.table.setHorizontalHeaderLabels(["Figure", "Value"])
        self.table.verticalHeader().hide()
        self.table.verticalHeader().setDefaultSectionSize(22)
        self.table.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
        self.table.setSelectionMode(QTableWidget.SelectionMode.NoSelection)
        self.table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.table.horizontalHeader().setStretchLastSection(True)
        self.plot = LinePlot(*AXES, legend=True)
        self.plot.set_decades(x=True, y=True)
        self.plot.plot.legend.setOffset((8, 8))  # the curve rises to the right
        self.results = QWidget()
        row = QHBoxLayout(self.results)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self.table, 1)
        row.addWidget(self.plot, 1)

    def _buttons(self) -> QHBoxLayout:
        self.take_button = QPushButton("Take measured sensor")
        self.take_button.setProperty("role", "primary")
        self.take_button.setEnabled(False)
        self.take_button.clicked.connect(lambda: self.take())
        close = QPushButton("Close")
        close.setToolTip("Close without changing the camera; a running measurement is stopped")
        close.clicked.connect(lambda: self.close())
        row = QHBoxLayout()
        row.addStretch()
        row.addWidget(self.take_button)
        row.addWidget(close)
        return row

    def choose(self, which: str) -> None:
        """Ask for the folder of ``"flats"`` or ``"darks"``."""
        path = QFileDialog.getExistingDirectory(self, f"Folder of {which}", getattr(self, which))
        if path:
            self.set_folder(which, path)

    def set_folder(self, which: str, path: str) -> None:
        """Take a folder of ``"flats"`` or ``"darks"``; with both the measurement begins."""
        setattr(self, which, path)
        known = {"flats": self.flats, "darks": self.darks}
        self.chosen.setText(", ".join(f"{name}: {Path(at).name}" for name, at in known.items() if at))
        self.chosen.setToolTip("\n".join(at for at in known.values() if at))
        if self.flats and self.darks:
            self._start()

    def _start(self) -> None:
        self.context.jobs.cancel(self._job)
        self._show_none()
        camera, flats, darks = self.context.state.camera, Path(self.flats), Path(self.darks)
        self.words.setText("Measuring …")
        self.bar.setVisible(True)
        self._job = self.context.jobs.start(
            "Measure the sensor",
            "setup",
            lambda: iter_sensor(camera, flats, darks),
            self.show_found,
            self._failed,
            abandon=True,
            at_once=True,
        )

    def _job_changed(self, job: WindowJob) -> None:
        if job.number == self._job and job.progress is not None:
            self.bar.setMaximum(job.progress.total)
            self.bar.setValue(job.progress.done)

    def _failed(self, job: WindowJob) -> None:
        self.bar.setVisible(False)
        self.words.setText(job.error or HINT)

    def _show_none(self) -> None:
        """Show no figures, until those of the folders chosen are there."""
        self.found = None
        self.table.setRowCount(0)
        self.plot.clear()
        self.take_button.setEnabled(False)
        self.take_button.setToolTip("")

    def show_found(self, found: SensorMeasurement) -> None:
        """Show the figures, the curve, and the remarks on them."""
        self.found = found
        self.bar.setVisible(False)
        curves = curves_of(found)
        for name, points, tone in (("fitted", curves.fitted, LINES[0]), ("not fitted", curves.others, LINES[5])):
            if points[0].size:
                self.plot.set_curve(name, *points, symbol="o", colour=tone, line=False)
        if curves.fit[0].size:
            self.plot.set_curve("fit", *curves.fit, colour=LINES[1])
        self.plot.plot.vb.autoRange()
        self._show_figures()

    def _show_figures(self) -> None:
        """Show the figures next to those of the project's camera, and whether they can be transferred to it."""
        if self.found is None:
            return
        found, camera = self.found, self.context.state.camera
        self.words.setText(words_of(found, camera) or "Every figure was measured.")
        rows = rows_of(found, camera)
        self.table.setRowCount(len(rows))
        for row, texts in enumerate(rows):
            for column, text in enumerate(texts):
                self.table.setItem(row, column, QTableWidgetItem(text))
        changed, why = taken(found, camera)
        self.take_button.setEnabled(changed is not None and changed != camera)
        self.take_button.setToolTip(why)

    def take(self) -> None:
        """Make the measured sensor that of the project's camera as it is now."""
        if self.found is None:
            return
        camera, why = taken(self.found, self.context.state.camera)
        if camera is None:
            self.words.setText(why)
            return
        if not self._take_over(camera, "measured sensor"):
            self.words.setText("The camera cannot change while a session is being recorded; take it over afterwards.")
            return
        self.words.setText("The camera now has the measured sensor; save the camera to use it elsewhere.")

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.plot.apply_theme()

    def closeEvent(self, event: QCloseEvent) -> None:
        """Stop what is still measured."""
        self.context.jobs.cancel(self._job)
        self.context.jobs.changed.disconnect(self._job_changed)
        self.context.theme_changed.disconnect(self.apply_theme)
        self.context.state_changed.disconnect(self._show_figures)
        super().closeEvent(event)
