"""Measurement of the sensor from folders of flat and dark frames: results, and use in the camera."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QDialog, QFileDialog, QLabel, QProgressBar, QWidget

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
from lfcal_gui.widgets import LINES, LinePlot, RowsTable, button, column_of, line, wrapped

Points = tuple[NDArray[np.float64], NDArray[np.float64]]

HINT = (
    "Flats: two or more frames at each light level; white images through the lenslets are "
    "suitable. Darks: two or more frames with the cap on. The files must be unprocessed: no "
    "gamma, no noise reduction, no JPEG."
)
FOLDERS = {
    "flats": "Folder of uniformly lit frames, two or more at each of several exposures, for gain and linearity",
    "darks": "Folder of frames without light at several exposures, for read noise, dark current and offsets",
}
TAKE = "Use the measured sensor in the camera of the project"
CLOSE = "Close without changing the camera. A running measurement is stopped"
AXES = ("signal above black (counts)", "noise, rms (counts)")


def iter_sensor(camera: Camera, flats: Path, darks: Path) -> Work[SensorMeasurement]:
    """Measure the sensor, and return the results; the colour filter is that of the files, else that of the camera."""
    (lit, facts), (dark, _) = find_frames(flats), find_frames(darks)
    found: SensorMeasurement = yield from iter_measure_sensor(lit, dark, cfa=str(facts.get("cfa") or camera.sensor.cfa))
    return found


def remarks_on(found: SensorMeasurement, camera: Camera) -> str:
    """Return remarks on the results, one line each: doubts, differences from ``camera``, notes."""
    doubts = [f"Doubtful: {doubt}." for doubt in found.doubts]
    notes = (*sensor_differences(found, camera.sensor), *found.notes)
    return "\n".join([*doubts, *(f"{note[:1].upper()}{note[1:]}." for note in notes)])


def curves_of(found: SensorMeasurement) -> tuple[Points, Points, Points]:
    """Return noise over signal (counts) for logarithmic axes: points fitted, other points, and the fit."""
    curve = found.curve
    lit = (curve.points.x > 0) & (curve.points.y > 0)
    x, y = curve.points.x, np.sqrt(np.maximum(curve.points.y, 0))
    fit: Points = (np.zeros(0), np.zeros(0))
    if curve.slope is not None and lit.any():
        over = np.geomspace(max(float(x[lit].min()) / 3, 1e-2), curve.limit, 100)
        fit = (over, np.sqrt(curve.variance(over)))
    return (x[lit & curve.used], y[lit & curve.used]), (x[lit & ~curve.used], y[lit & ~curve.used]), fit


class SensorDialog(QDialog):
    """Dialog that measures the sensor of the project's camera, and uses the results in the camera.

    Parameters
    ----------
    parent, context
        The page and its context.
    take
        Called with the camera as measured, and the label of the undo step; returns whether the camera changed.
    """

    def __init__(self, parent: QWidget, context: Context, take: Callable[[Camera, str], bool]) -> None:
        super().__init__(parent)
        self.setWindowTitle("Measure the sensor")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.resize(940, 560)
        self.context, self._take_over = context, take
        self.folders = dict.fromkeys(FOLDERS, "")
        self.found: SensorMeasurement | None = None
        self._job = 0
        self.words = wrapped("", HINT)
        self.words.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.bar = QProgressBar()
        self.bar.hide()
        self.chosen = QLabel("no folders chosen")
        asking = [
            button(f"{name.capitalize()} …", tip, lambda name=name: self.choose(name)) for name, tip in FOLDERS.items()
        ]
        self.table = RowsTable(("Quantity", "Value"), 1)
        self.plot = LinePlot(*AXES, legend=True)
        self.plot.set_decades(x=True, y=True)
        self.plot.plot.legend.setOffset((8, 8))  # the curve rises to the right
        results = line(self.table, self.plot)
        for k in range(2):
            results.setStretch(k, 1)
        self.take_button = button("Use measured sensor", TAKE, self.take)
        self.take_button.setProperty("role", "primary")
        self.take_button.setEnabled(False)
        end = line("", self.take_button, button("Close", CLOSE, self.close), stretch=0)
        column_of(line(*asking, self.chosen, stretch=2), self.words, self.bar, results, end, of=self, stretch=3)
        self.layout().setContentsMargins(11, 11, 11, 11)
        context.theme_changed.connect(self.plot.apply_theme)
        context.jobs.changed.connect(self._job_changed)
        context.state_changed.connect(self._show_figures)

    def choose(self, which: str) -> None:
        """Ask for the folder of ``"flats"`` or ``"darks"``."""
        path = QFileDialog.getExistingDirectory(self, f"Folder of {which}", self.folders[which])
        if path:
            self.set_folder(which, path)

    def set_folder(self, which: str, path: str) -> None:
        """Set the folder of ``"flats"`` or ``"darks"``; with both, the measurement starts."""
        self.folders[which] = path
        known = {name: at for name, at in self.folders.items() if at}
        self.chosen.setText(", ".join(f"{name}: {Path(at).name}" for name, at in known.items()))
        self.chosen.setToolTip("\n".join(known.values()))
        if len(known) == len(FOLDERS):
            self._start()

    def _start(self) -> None:
        self.context.jobs.cancel(self._job)
        self.found = None
        self.table.setRowCount(0)
        self.plot.clear()
        self.take_button.setEnabled(False)
        self.take_button.setToolTip("")
        camera, flats, darks = self.context.state.camera, *map(Path, self.folders.values())
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

    def show_found(self, found: SensorMeasurement) -> None:
        """Show the results, the photon-transfer curve, and remarks."""
        self.found = found
        self.bar.setVisible(False)
        fitted, others, fit = curves_of(found)
        for name, points, tone in (("fitted", fitted, LINES[0]), ("not fitted", others, LINES[5])):
            if points[0].size:
                self.plot.set_curve(name, *points, symbol="o", colour=tone, line=False)
        if fit[0].size:
            self.plot.set_curve("fit", *fit, colour=LINES[1])
        self.plot.plot.vb.autoRange()
        self._show_figures()

    def _taken(self) -> tuple[Camera | None, str]:
        """Return the project's camera with the measured sensor, or None and the reason if it cannot be used."""
        try:
            return None if self.found is None else self.found.camera(self.context.state.camera), ""
        except InputError as error:
            return None, str(error)

    def _show_figures(self) -> None:
        """Show the results next to the values of the project's camera, and whether they can be used in it."""
        if self.found is None:
            return
        camera = self.context.state.camera
        self.words.setText(remarks_on(self.found, camera) or "All quantities were measured.")
        self.table.show_rows(figures_of(self.found, camera.sensor))
        changed, why = self._taken()
        self.take_button.setEnabled(changed is not None and changed != camera)
        self.take_button.setToolTip(why or TAKE)

    def take(self) -> None:
        """Use the measured sensor in the current camera of the project."""
        camera, why = self._taken()
        if camera is None:
            self.words.setText(why or self.words.text())
        elif not self._take_over(camera, "measured sensor"):
            self.words.setText(
                "The camera cannot change while a session is being recorded; apply the measured sensor afterwards."
            )
        else:
            self.words.setText("The camera now has the measured sensor; save the camera to use it elsewhere.")

    def closeEvent(self, event: QCloseEvent) -> None:
        """Stop a running measurement."""
        self.context.jobs.cancel(self._job)
        self.context.jobs.changed.disconnect(self._job_changed)
        self.context.theme_changed.disconnect(self.plot.apply_theme)
        self.context.state_changed.disconnect(self._show_figures)
        super().closeEvent(event)
