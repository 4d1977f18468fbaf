"""Reconstruct: what goes in on the left, the volume in the middle, the light field and the convergence right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QComboBox,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QStackedWidget,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from lfcal.reconstruct import PHANTOMS, SOLVERS
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import cutout_of, unbroken
from lfcal_gui.pages.reconstruct._volume_view import VolumeView
from lfcal_gui.pages.reconstruct.model import FIELDS, RARE, ReconstructSettings, used_by
from lfcal_gui.pages.reconstruct.model_device import DEVICE, NO_DEVICE
from lfcal_gui.widgets import (
    ElidedLabel,
    FoldedForm,
    LinePlot,
    Picture,
    WrappedLabel,
    card,
    column_area,
    line,
    set_role,
    split,
)

__all__ = ["BUTTONS", "ReconstructPanel"]

BUTTONS = (
    ("start", "Reconstruct", "Start again with these settings, as a job"),
    ("stop", "Stop", "Stop after the current iteration; the volume is kept and can be continued"),
    ("more", "Continue", "As many iterations again, from where it stopped"),
    ("save", "Save …", "Write the volume: .tif (opens in ImageJ), .h5 or .npy"),
)
"""Key, title and meaning of each button."""

NOT_BY_ITSELF = "It cannot leave out pixels, and ends after the iterations."

FORECAST = "What it will take in time and memory, and how: before it is begun"
CONVERGENCE = "Does it still get better? Image less model, iteration by iteration"


class ReconstructPanel(QWidget):
    """The page's widgets.

    Signals
    -------
    pressed(key)
        One of `BUTTONS`.
    open_asked(), make_asked(phantom)
        Choose a light field; make one from a phantom.
    """

    pressed = Signal(str)
    open_asked = Signal()
    make_asked = Signal(str)

    def __init__(self, jobs: Jobs | None = None, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        some, rare = (tuple(field for field in FIELDS if (field.key in RARE) is rare) for rare in (False, True))
        tip = "End by tolerance, place of H, margin of the volume, memory, precision"
        self.form = FoldedForm(some, rare, tip=tip)
        self.form.set_defaults(vars(ReconstructSettings()))
        self.no_device = NO_DEVICE
        self.volume = VolumeView(jobs)
        self.light_field = Picture(legend=False)
        self.light_field.blank.words = "Open a light field, or make one."
        self.light_field.setToolTip("The light field; the frame shows the region that is used")
        self.residual = LinePlot("iteration", "residual (%)", counted=True)
        self.residual.setToolTip("Weighted rms of image minus model, over that of the image")
        self.likelihood = LinePlot("iteration", "log-lik. / px", counted=True)
        self.likelihood.setToolTip(
            "Log-likelihood of the image less its largest possible value, per pixel: 0 is a perfect fit. "
            "Accelerated solvers may fall back for an iteration, and do not stay there"
        )
        for view in (self.light_field, self.residual, self.likelihood):
            # what they would like to have takes no height from each other
            view.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Ignored)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(8)
        row.addWidget(column_area(284, self._input_card(), self._run_card(), self._settings_card()))
        self.split = split(self._volume_card(), self._side(), sizes=(3, 2))
        row.addWidget(self.split, 1)

    # -- building --------------------------------------------------------------------------------------
    def _input_card(self) -> QWidget:
        frame, column = card("Light field")
        self.file = WrappedLabel("none yet")
        self.file.setProperty("role", "hint")
        self.open = QPushButton("Open …")
        self.open.setToolTip("An image behind the same optics: TIFF, PNG, RAW, …; files can be dropped here as well")
        self.open.clicked.connect(lambda: self.open_asked.emit())
        self.phantom = QComboBox()
        for name in PHANTOMS:
            self.phantom.addItem(name, name)
        self.phantom.setAccessibleName("phantom")
        self.phantom.setToolTip("What the light field shows; the true volume is known, so the error is measured")
        self.make = QPushButton("Make one …")
        self.make.setToolTip("Project a phantom through this H, add photon noise, and save it as a light field")
        self.make.clicked.connect(lambda: self.make_asked.emit(self.phantom.currentData()))
        column.addLayout(line(self.file, self.open, stretch=0))
        column.addLayout(line(self.make, self.phantom, stretch=1))
        return frame

    def _run_card(self) -> QWidget:
        frame, column = card("Reconstruction")
        grid = QGridLayout()
        grid.setSpacing(5)
        self.buttons: dict[str, QPushButton] = {}
        for k, (key, title, tip) in enumerate(BUTTONS):
            button = QPushButton(title)
            button.setToolTip(tip)
            button.setMinimumWidth(60)
            button.clicked.connect(lambda _=False, key=key: self.pressed.emit(key))
            self.buttons[key] = button
            grid.addWidget(button, k // 2, k % 2)
        column.addLayout(grid)
        return frame

    def _forecast(self) -> QWidget:
        frame = QWidget()
        column = QVBoxLayout(frame)
        column.setContentsMargins(0, 4, 0, 0)
        self.forecast = QLabel("Told when there is a light field.")
        self.forecast.setTextFormat(Qt.TextFormat.RichText)
        self.forecast.setWordWrap(True)
        self.forecast.setToolTip("From a cost model calibrated on this machine")
        column.addWidget(self.forecast)
        column.addStretch()
        return frame

    def _settings_card(self) -> QWidget:
        frame, column = card("How")
        self.solver_words = QLabel("")
        self.solver_words.setProperty("role", "hint")
        self.solver_words.setWordWrap(True)
        column.addWidget(self.solver_words)
        column.addWidget(self.form)
        return frame

    def _volume_card(self) -> QWidget:
        frame, column = card()
        self.title = ElidedLabel("Volume")
        self.title.setProperty("role", "heading")
        column.addWidget(self.title)
        self.hint = QLabel("")
        self.hint.setProperty("role", "hint")
        self.hint.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.hint.setWordWrap(True)
        self.stack = QStackedWidget()
        self.stack.addWidget(self.hint)
        self.stack.addWidget(self.volume)
        column.addWidget(self.stack, 1)
        return frame

    def _side(self) -> QVBoxLayout:
        column = QVBoxLayout()
        column.setSpacing(8)
        self.pixel = QLabel("Light field")
        top, inner = card(self.pixel)
        self.light_field.hovered.connect(self._hovered)
        self.light_field.graphics.setMinimumSize(150, 110)
        inner.addWidget(self.light_field, 1)
        column.addWidget(top, 5)
        below, inner = card()
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        self.status = QLabel("")
        self.status.setWordWrap(True)
        inner.addWidget(self.bar)
        inner.addWidget(self.status)
        self.costs = QTabWidget()
        self.costs.setDocumentMode(True)
        self.costs.tabBar().setDrawBase(False)
        tabs = (self._forecast(), "Forecast", FORECAST), (self._convergence(), "Convergence", CONVERGENCE)
        for tab, title, tip in tabs:
            self.costs.setTabToolTip(self.costs.addTab(tab, title), tip)
        inner.addWidget(self.costs, 1)
        column.addWidget(below, 6)
        return column

    def _convergence(self) -> QWidget:
        frame = QWidget()
        column = QVBoxLayout(frame)
        column.setContentsMargins(0, 4, 0, 0)
        for plot in (self.residual, self.likelihood):
            plot.graphics.setMinimumSize(150, 80)
            column.addWidget(plot, 1)
        return frame

    def show_running(self) -> None:
        """Look at how it goes, no longer at what it will cost."""
        self.costs.setCurrentIndex(1)

    # -- showing ---------------------------------------------------------------------------------------
    def show_solver(self, settings: ReconstructSettings) -> None:
        """Say what the solver does, and enable what it uses; one that ends by itself takes what it needs."""
        name, by_itself = settings.solver, settings.ends_by_itself
        words = SOLVERS.get(name).title
        self.solver_words.setText(f"{words}. {NOT_BY_ITSELF}" if settings.stop and not by_itself else words)
        for key in ("background", "read_noise", "saturation", "strength", "subsets", "margin", "tolerance"):
            self.form.set_enabled(key, used_by(name, key))
        for key in ("strength", "subsets"):  # the form has no room for rows that only other solvers use
            self.form.set_shown(key, used_by(name, key))
        self.form.set_enabled("iterations", not by_itself)
        # one in place of the other: the form has no room for a row that says nothing
        noise = settings.stop == "discrepancy"
        self.form.set_shown("gain", noise)
        self.form.set_shown("iterations", not noise)
        self.form.set_shown("goal", settings.stop == "left-out")

    def show_device(self, chosen: str) -> None:
        """Grey out the choice of a device where there is none; one that was chosen elsewhere can be taken back."""
        self.form.set_enabled("device", not self.no_device or chosen == "cuda")
        editor = self.form.editor("device")
        editor.setToolTip("\n".join(filter(None, (DEVICE.tip, self.no_device))))
        editor.setAccessibleDescription(self.no_device)

    def show_region(self, region: tuple[int, int, int, int] | None) -> None:
        """Frame the region that is used: first row, row behind the last, and so for columns; None: no light field."""
        if region is None:
            self.light_field.set_overlays()
            return
        top, bottom, left, right = region
        self.light_field.set_overlays(*cutout_of(top, left, (bottom - top, right - left)))

    def show_forecast(self, words: str) -> None:
        """Show what a reconstruction will cost, as rich text, or why that is not known."""
        self.forecast.setText(unbroken(words))

    def show_hint(self, text: str) -> None:
        """Say what to do next in place of a volume."""
        self.hint.setText(text)
        self.stack.setCurrentWidget(self.hint)

    def show_no_volume(self) -> None:
        """Show none, and nothing of how one came to be."""
        self.stack.setCurrentWidget(self.hint)
        self.title.setText("Volume")
        self.volume.set_volume(None)
        self.residual.clear()
        self.likelihood.clear()
        self.show_status("", 0.0)

    def show_volume(
        self,
        volume: NDArray[Any],
        title: str,
        depths_um: NDArray[np.float64] | None = None,
        voxel_um: tuple[float, float] | None = None,
        truth: NDArray[Any] | None = None,
    ) -> None:
        """Show a volume ``(Z, Y, X)``, and the true one where it is known."""
        self.stack.setCurrentWidget(self.volume)
        self.title.setText(title)
        self.volume.set_volume(volume, depths_um, voxel_um, truth)

    def show_history(self, history: Sequence[Any], pixels: int) -> None:
        """Show the convergence: `SolverProgress` records of an image of so many pixels."""
        at = [record.iteration for record in history]
        symbol = "o" if len(at) < 3 else None
        self.residual.clear()
        self.likelihood.clear()
        self.residual.set_curve("residual", at, [100 * record.residual for record in history], symbol=symbol)
        values = [record.likelihood / max(1, pixels) for record in history]
        self.likelihood.set_curve("likelihood", at, values, symbol=symbol)

    def show_status(self, words: str, fraction: float | None, *, bad: bool = False) -> None:
        """Show how far it is; None: not known."""
        set_role(self.status, "error" if bad else "")
        self.status.setText(words)
        self.bar.setRange(0, 0 if fraction is None else 1000)
        if fraction is not None:
            self.bar.setValue(round(1000 * fraction))

    def _hovered(self, row: int, column: int, value: float) -> None:
        self.pixel.setText("Light field" if row < 0 else f"row {row}, column {column}: {value:.4g} counts")

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for widget in (self.volume, self.light_field, self.residual, self.likelihood):
            widget.apply_theme()
