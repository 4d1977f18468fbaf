"""Use: the volume, light field and slice at the left; export and reconstruction in the inspector."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

from PySide6.QtCore import QPoint, Qt, Signal
from PySide6.QtGui import QCursor, QResizeEvent
from PySide6.QtWidgets import (
    QLabel,
    QMenu,
    QProgressBar,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from lfcal.reconstruct import PHANTOMS, SOLVERS
from lfcal_gui.base_page import EmptyState
from lfcal_gui.models import cutout_of, unbroken
from lfcal_gui.pages.reconstruct._exporting import ExportCard
from lfcal_gui.pages.reconstruct._volume_view import VolumeView
from lfcal_gui.pages.reconstruct.model import BASIC, DEVICE, FIELDS, NO_DEVICE, ReconstructSettings, used_by
from lfcal_gui.widgets import (
    INSPECTOR,
    LINES,
    CostCurve,
    ElidedLabel,
    Folded,
    FoldedForm,
    LinePlot,
    WrappedLabel,
    button,
    card,
    choice_box,
    clear,
    heading,
    inspector_width,
    line,
    name_controls,
    row_of,
    scrolling,
    set_role,
    shown_tone,
)

NOT_BY_ITSELF = "This solver cannot hold out pixels, so it ends after the number of iterations."

NO_LIGHT_FIELD = (
    "No light field open\nOpen an image taken through these optics, or make one from a known "
    "specimen to test this H.\nYou can also drop a light field or a volume here."
)

NO_CURVE = "Press Reconstruct. Each iteration adds a point."

OPEN = "An image recorded with the same optics: TIFF, PNG, RAW and others. You can also drop a file here"
SAVE = "Write the volume as TIFF (opens in ImageJ), OME-TIFF, OME-Zarr, HDF5 or NumPy file"
MAKE = (
    "Project a phantom with this H, add photon noise, and save the result as a light field whose true volume is known"
)

PARTS = (("solvers", "Solver and iterations"), ("projection", "Projector"))
"""Parts of a reconstruction in the chart of error against cost."""

GO = {
    "start": "Reconstruct with these settings, as a job",
    "more": "Continue with the same number of iterations",
    "stop": "Stop after the current iteration. The volume is kept, and you can continue",
}
"""Actions of the main button, with their tooltips."""

PLOT, CURVE = 117, 240
"""Heights of charts in the inspector (px)."""

MISFIT, TRUTH = "misfit", "error relative to the truth"
"""Names of the curves of a reconstruction."""


class ReconstructPanel(QWidget):
    """The page's widgets."""

    pressed = Signal(str, arguments=["key"])
    """A button was pressed: ``"open"``, ``"save"``, ``"bars"``, ``"again"``, or one of `GO`."""
    volume_asked = Signal(bool, arguments=["folder"])
    """Request to open a stored volume: a file, or a folder."""
    make_asked = Signal(str, arguments=["phantom"])
    """Request to make a light field from a phantom."""

    def __init__(self, view: VolumeView) -> None:
        super().__init__()
        basic, more = (tuple(field for field in FIELDS if (field.key in BASIC) is seen) for seen in (True, False))
        self.form = FoldedForm(basic)
        tip = "Stopping, noise, projector, margin, region, memory; costs, forecast and likelihood"
        self.more = FoldedForm((), more, f"{len(more)} more settings", tip)
        for form in (self.form, self.more):
            form.set_defaults(vars(ReconstructSettings()))
        self.no_device = NO_DEVICE
        self.view = view
        self.view.light_field.blank.words = "Open a light field, or make one."
        self.phantoms = QMenu(self)
        for name in PHANTOMS:
            self.phantoms.addAction(name).triggered.connect(lambda _=False, name=name: self.make_asked.emit(name))
        self.open_volume = button("Open volume", "Open a volume that was reconstructed earlier or by another program")
        kinds = QMenu(self)
        for name, folder in (("File …", False), ("OME-Zarr folder …", True)):
            kinds.addAction(name).triggered.connect(lambda _=False, folder=folder: self.volume_asked.emit(folder))
        self.open_volume.setMenu(kinds)
        empty = {
            "Open light field …": (OPEN, lambda: self.pressed.emit("open")),
            "Simulate …": (MAKE, self._show_phantoms),
        }
        self.view.set_empty(EmptyState(NO_LIGHT_FIELD, empty))
        self.export = ExportCard()
        self.area = scrolling(self._inspector())
        self.area.setProperty(INSPECTOR, True)
        clear(self.area)
        row_of(self.view, self.area, of=self, spacing=8, stretch=0)
        self.view.show_none(light_field=False)

    def _show_phantoms(self) -> None:
        self.phantoms.popup(QCursor.pos() if self.isActiveWindow() else self.mapToGlobal(QPoint(0, 0)))

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Widen the inspector in a large window."""
        super().resizeEvent(event)
        self.area.setFixedWidth(inspector_width(self.width()))

    # -- building --------------------------------------------------------------------------------------
    def _inspector(self) -> QWidget:
        inner = QWidget()
        inner.setProperty("dense", True)
        column = QVBoxLayout(inner)
        column.setContentsMargins(0, 0, 6, 0)
        column.setSpacing(6)
        for part in (self.export, self._reconstruction()):
            column.addWidget(part)
        column.addStretch()
        return inner

    def _button(self, key: str, words: str, tip: str) -> QPushButton:
        return button(words, tip, lambda: self.pressed.emit(key))

    def _reconstruction(self) -> QWidget:
        frame, column = card()
        self.took = ElidedLabel()
        self.took.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        column.addLayout(line(heading("Reconstruct"), self.took, stretch=1))
        self.open = self._button("open", "Open light field …", OPEN)
        self.make = button("Simulate …", MAKE)
        self.make.setMenu(self.phantoms)
        column.addLayout(line(self.open, self.make, stretch=0))
        self.file = WrappedLabel("none yet", role="hint")
        column.addWidget(self.file)
        column.addWidget(self.form)
        tip = (
            "Weighted rms of image minus model, divided by that of the image. If the truth is known, "
            "the error of the volume is also drawn"
        )
        self.misfit = _plot("misfit (%)", tip)
        column.addWidget(self.misfit)
        self.key = WrappedLabel(rich=True, role="hint")
        self.key.setProperty("size", "caption")
        self.key.hide()
        column.addWidget(self.key)
        self._fill_more()
        column.addWidget(self.more)
        self.go = QPushButton("Reconstruct")
        self.go.clicked.connect(lambda: self.pressed.emit(self._go))
        self.save = self._button("save", "Save volume …", SAVE)
        held = self.save.sizePolicy()
        held.setRetainSizeWhenHidden(True)  # nothing moves when there is a volume to save
        self.save.setSizePolicy(held)
        column.addLayout(line(self.go, self.save, stretch=0))
        self.bar = QProgressBar(textVisible=False)
        self.status = QLabel(wordWrap=True)
        for part in (self.bar, self.status):
            column.addWidget(part)
        self.show_go("start")
        self.show_status("", None)
        return frame

    def _fill_more(self) -> None:
        """Add the description of the solver and the chart of error against cost to the folded settings."""
        self.solver_words = WrappedLabel(role="hint")
        self.again = self._button("again", "Start again", "Reconstruct from the first iteration with these settings")
        self.part = choice_box(
            PARTS, "What the chart compares: solvers and iterations, or ways to apply H", "what the chart compares"
        )
        costs = QWidget()
        self._costs_column = column = QVBoxLayout(costs)
        column.setContentsMargins(0, 0, 0, 0)
        for part in (heading("What accuracy costs"), self.part):
            column.addWidget(part)
        self.more.fold_line(self.solver_words, above=True)
        self.more.fold_line(costs)
        self.more.fold_line(self._forecast())
        self.bars = self._button(
            "bars",
            "Error bars …",
            "Reconstruct the volume again with the uncertainty of every voxel and of sums over regions, and save it. "
            "Draw regions (menu Overlay) or choose a file of Labels. The settings Fit and Replicates apply",
        )
        self.more.fold_line(self.again, self.bars)

    @cached_property
    def curve(self) -> CostCurve:
        """Chart of error against cost, which is created when the settings are first unfolded."""
        made = CostCurve()
        made.setFixedHeight(CURVE)
        self._costs_column.addWidget(made)
        name_controls(self)
        return made

    def _forecast(self) -> QWidget:
        self.folded = folded = Folded(
            "Time, memory and likelihood", "Forecast of time and memory, and likelihood of the image"
        )
        self.forecast = QLabel("Open a light field to see the forecast")
        self.forecast.setTextFormat(Qt.TextFormat.RichText)
        self.forecast.setWordWrap(True)
        self.forecast.setToolTip("Time and memory that a cost model calibrated on this machine predicts")
        folded.column.addWidget(self.forecast)
        folded.head.toggled.connect(lambda _: self.likelihood.show())
        return folded

    @cached_property
    def likelihood(self) -> LinePlot:
        """Plot of the log-likelihood, which is created when it is first shown."""
        tip = (
            "Log-likelihood of the image minus its largest possible value, per pixel: 0 is a perfect "
            "fit. It may decrease for an iteration with accelerated solvers"
        )
        made = _plot("log-lik. / px", tip)
        self.folded.column.addWidget(made)
        name_controls(self)
        return made

    @property
    def _plots(self) -> tuple[LinePlot, ...]:
        """The plots that were created."""
        return self.misfit, *((self.likelihood,) if "likelihood" in self.__dict__ else ())

    # -- showing ---------------------------------------------------------------------------------------
    def show_go(self, key: str, more: int = 0, *, enabled: bool = True) -> None:
        """Set the action of the main button, one of `GO`; ``more`` is the number of iterations that it adds."""
        self._go = key
        words = {"start": "Reconstruct", "more": f"Run {more} more", "stop": "Stop"}
        self.go.setText(words[key])
        self.go.setToolTip(GO[key])
        self.go.setEnabled(enabled)

    def show_solver(self, settings: ReconstructSettings) -> None:
        """Show a description of the solver, and enable the settings that it and its stopping rule use."""
        name, by_itself = settings.solver, settings.ends_by_itself
        words = SOLVERS.get(name).title
        self.solver_words.setText(f"{words}. {NOT_BY_ITSELF}" if settings.stop and not by_itself else words)
        for key in ("background", "read_noise", "saturation", "strength", "subsets", "margin", "tolerance"):
            self.more.set_enabled(key, used_by(name, key))
        for key in ("strength", "subsets"):  # rows that only other solvers use
            self.more.set_shown(key, used_by(name, key))
        self.form.set_enabled("iterations", not by_itself)
        self.more.set_shown("gain", settings.stop == "discrepancy")
        self.more.set_shown("goal", settings.stop == "left-out")

    def show_device(self, chosen: str) -> None:
        """Disable the choice of a device without an accelerator, unless one is chosen, so that it can be deselected."""
        self.more.set_enabled("device", not self.no_device or chosen == "cuda")
        editor = self.more.editor("device")
        editor.setToolTip("\n".join(filter(None, (DEVICE.tip, self.no_device))))
        editor.setAccessibleDescription(self.no_device)

    def show_region(self, region: tuple[int, int, int, int] | None) -> None:
        """Draw the border of the used region (rows, then columns: first, last plus one). None: no light field."""
        if region is None:
            self.view.light_field.set_overlays()
            return
        top, bottom, left, right = region
        self.view.light_field.set_overlays(*cutout_of(top, left, (bottom - top, right - left)))

    def show_forecast(self, words: str) -> None:
        """Show the forecast of a reconstruction as rich text, or why it is unknown."""
        self.forecast.setText(unbroken(words))

    def show_no_volume(self) -> None:
        """Clear volume, convergence and status."""
        self.view.set_volume(None)
        for plot in self._plots:
            plot.clear()
        self.key.hide()
        self.show_status("", None)
        self.show_took("")

    def show_history(self, history: Sequence[Any], pixels: int, errors: Sequence[float] = ()) -> None:
        """Show the convergence: `SolverProgress` records, number of pixels of the image, and errors of the volume."""
        at = [record.iteration for record in history]
        symbol = "o" if len(at) < 3 else None
        for plot in self._plots:
            plot.clear()
        self.misfit.set_curve(MISFIT, at, [100 * record.residual for record in history], symbol=symbol)
        if errors:
            known = [100 * error for error in errors]
            self.misfit.set_curve(TRUTH, at[-len(known) :], known, symbol=symbol, dashed=True)
        self._name_curves()
        self.key.setVisible(bool(errors))
        self.misfit.set_labels("iteration", "error (%)" if errors else "misfit (%)")
        values = [record.likelihood / max(1, pixels) for record in history]
        self.likelihood.set_curve("likelihood", at, values, symbol=symbol)

    def show_took(self, words: str, role: str = "hint") -> None:
        """Show next to the title the forecast or measured duration."""
        self.took.setText(words)
        set_role(self.took, role)

    def show_status(self, words: str, fraction: float | None, *, bad: bool = False, busy: bool = False) -> None:
        """Show a text and, while ``busy``, the completed fraction (None: unknown)."""
        set_role(self.status, "error" if bad else "hint")
        self.status.setText(words)
        self.status.setVisible(bool(words))
        self.bar.setVisible(busy)
        self.bar.setRange(0, 0 if fraction is None else 1000)
        if fraction is not None:
            self.bar.setValue(round(1000 * fraction))

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        curve = self.__dict__.get("curve")
        for widget in (self.view, *self._plots, *(() if curve is None else (curve,))):
            widget.apply_theme()
        self._name_curves()

    def _name_curves(self) -> None:
        marks = (("━", LINES[0], MISFIT), ("┅", LINES[1], TRUTH))
        words = [f"<span style='color:{shown_tone(tone)}'>{mark}</span>&nbsp;{name}" for mark, tone, name in marks]
        self.key.setText(" &nbsp; ".join(words))


def _plot(label: str, tip: str) -> LinePlot:
    plot = LinePlot("iteration", label, counted=True)
    plot.setToolTip(tip)
    plot.setFixedHeight(PLOT)
    plot.graphics.setMinimumSize(120, 60)
    plot.blank.words = NO_CURVE
    return plot
