"""Figures of the paper: pictures with shared scales and numbers, gain curves, or a map of gains, drawn when seen."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QShowEvent
from PySide6.QtWidgets import QCheckBox, QGridLayout, QLabel, QStackedWidget, QVBoxLayout, QWidget

from lfcal.multiplex import FIGURES, GainCurves, GainMap, PaperFigure, PaperPanel, camera_chi2, gain_map, paper_figure
from lfcal_gui.context import Context
from lfcal_gui.models import Shot
from lfcal_gui.pages.multiplex.model import MultiplexSettings
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import LINES, LinePlot, Picture, card, choice_box, line, name_controls, set_role, shown_tone

MOST = 8
MAP = 0
"""In place of a figure's number: the gain of each sample of the modulator."""

TITLES = {
    MAP: "gain map of the modulator",
    3: "3: Bayer, both theorems",
    5: "5: upsampled views",
    6: "6: gain of SNR",
    7: "7: four light fields",
}


class FiguresView(QWidget):
    """Figures 3, 5, 6 and 7 of the paper, of scenes made here.

    Signals
    -------
    figure_chosen(number)
        Another figure is wanted.
    camera_chosen(own)
        The project's camera in place of the paper's.
    """

    figure_chosen = Signal(int)
    camera_chosen = Signal(bool)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.shown: PaperFigure | None = None
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 8, 0, 0)
        outer.setSpacing(6)
        tip = "A figure of Ihrke, Wetzstein and Heidrich 2010 with scenes made here"
        self.figure = choice_box([(str(n), TITLES[n]) for n in (*FIGURES, MAP)], tip)
        self.figure.setAccessibleName("figure of the paper")
        self.figure.currentIndexChanged.connect(lambda _: self.figure_chosen.emit(int(self.figure.currentData())))
        self.own = QCheckBox("project's camera")
        self.own.setToolTip("Noise of the project's camera in place of the paper's; figure 6 marks it in any case")
        self.own.toggled.connect(self.camera_chosen.emit)
        self.status = QLabel("")
        self.status.setProperty("role", "hint")
        self.status.setWordWrap(True)
        outer.addLayout(line("Figure", self.figure, self.own, self.status, stretch=3))
        self.stack = QStackedWidget()
        outer.addWidget(self.stack, 1)

    def make(self) -> None:
        """Make pictures and plots when the tab is first shown: they take as long as the rest of the page."""
        if self.stack.count() == 0:
            for part in (self._pictures(), self._plots(), self._map()):
                self.stack.addWidget(part)
            name_controls(self)

    def showEvent(self, event: QShowEvent) -> None:
        """Have something to show."""
        self.make()
        super().showEvent(event)

    def _pictures(self) -> QWidget:
        widget = QWidget()
        self.grid = QGridLayout(widget)
        self.grid.setContentsMargins(0, 0, 0, 0)
        self.grid.setSpacing(6)
        self.cards, self.heads, self.views, self.numbers = [], [], [], []
        for _ in range(MOST):
            head, words = QLabel(""), QLabel("")
            for label in (head, words):
                label.setWordWrap(True)
                label.setMinimumWidth(60)
            words.setProperty("role", "hint")
            words.setAlignment(Qt.AlignmentFlag.AlignTop)
            frame, column = card(head)
            frame.setParent(widget)
            view = Picture("intensity (1)", axes=("column (px)", "row (px)"))
            column.addWidget(view, 1)
            column.addWidget(words)
            self.cards.append(frame)
            self.heads.append(head)
            self.views.append(view)
            self.numbers.append(words)
        return widget

    def _plots(self) -> QWidget:
        widget = QWidget()
        grid = QGridLayout(widget)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(6)
        self.curves, self.curve_heads, self.legends, self.markers = [], [], [], []
        for k in range(2):
            head, legend = QLabel(""), QLabel("")
            head.setMinimumWidth(60)
            frame, column = card(head)
            plot = LinePlot("χ² = photon / additive noise variance (1)", "gain (dB)")
            plot.set_decades(x=True)
            marker = pg.InfiniteLine(angle=90)
            plot.plot.addItem(marker, ignoreBounds=True)
            legend.setWordWrap(True)
            legend.setProperty("role", "hint")
            column.addWidget(plot, 1)
            column.addWidget(legend)
            grid.addWidget(frame, 0, k)
            grid.setColumnStretch(k, 1)
            self.curves.append(plot)
            self.curve_heads.append(head)
            self.legends.append(legend)
            self.markers.append(marker)
        return widget

    def _map(self) -> QWidget:
        self.map_head, self.map_words = QLabel(""), QLabel("")
        self.map_head.setMinimumWidth(60)
        frame, column = card(self.map_head)
        self.map = Picture("gain (dB)", axes=("log₁₀ χ² (1)", "sample (1)"), square=False)
        self.map.setToolTip("Gain of each sample (band, colour, view) over the reference; pink: a loss, green: a gain")
        self.map_words.setProperty("role", "hint")
        self.map_words.setWordWrap(True)
        column.addWidget(self.map, 1)
        column.addWidget(self.map_words)
        return frame

    def show_map(self, found: GainMap) -> None:
        """Draw gains of samples over powers of ten of chi^2."""
        self.make()
        self.shown = None
        self.stack.setCurrentIndex(2)
        self.show_status(f"{found.modulator} over {found.reference}")
        self.map_head.setText(f"Gain of each sample of {found.modulator}")
        gains = np.where(np.isfinite(found.gains), found.gains, np.nan)
        first = (0.0, round(math.log10(float(found.chi2[0]))))
        self.map.set_shot(Shot(gains, name="gain map", signed=True, origin=first))
        names = [f"{k}: {name}" for k, name in enumerate(found.samples[:16])]
        more = f" and {len(found.samples) - 16} more" if len(found.samples) > 16 else ""
        self.map_words.setText(f"{', '.join(names)}{more}; what is not recovered is left blank")

    def show_choice(self, number: int, own: bool) -> None:
        """Show what is chosen, without reporting it."""
        blockers = [QSignalBlocker(self.figure), QSignalBlocker(self.own)]
        self.figure.setCurrentIndex(self.figure.findData(str(number)))
        self.own.setChecked(own)
        self.own.setEnabled(number == 7)
        for blocker in blockers:
            blocker.unblock()

    def show_status(self, words: str) -> None:
        """Say what is shown or under way."""
        set_role(self.status, "hint")
        self.status.setText(words)

    def show_refusal(self, words: str) -> None:
        """Show nothing, and why."""
        self.make()
        self.shown = None
        self.stack.setCurrentIndex(2)
        self.map.set_shot(None)
        for label in (self.map_head, self.map_words):
            label.setText("")
        set_role(self.status, "error")
        self.status.setText(words)

    def show_figure(self, found: PaperFigure) -> None:
        """Draw a figure."""
        self.make()
        self.shown = found
        self.show_status(found.title)
        self.stack.setCurrentIndex(1 if found.curves else 0)
        for k, (title, curves) in enumerate(found.curves):
            self._show_curves(k, title, curves)
        for k in range(MOST):
            self.grid.removeWidget(self.cards[k])
            self.cards[k].hide()
            self.grid.setColumnStretch(k, 1 if k < found.columns else 0)
        for k, panel in enumerate(found.panels):
            self.grid.addWidget(self.cards[k], k // found.columns, k % found.columns)
            self.grid.setRowStretch(k // found.columns, 1)
            self.heads[k].setText(panel.title)
            self.numbers[k].setText(panel.numbers)
            self._show_panel(self.views[k], panel)
            self.cards[k].show()

    def _show_panel(self, view: Picture, panel: PaperPanel) -> None:
        """Draw a picture, or a spectrum with zero frequency in the middle."""
        spectral = panel.title == "spectrum"
        first = tuple(-(n // 2) for n in panel.image.shape[:2]) if spectral else (0, 0)
        view.set_axes(*(("u (1/frame)", "v (1/frame)") if spectral else ("column (px)", "row (px)")))
        quantity = "log₁₀ magnitude (1)" if spectral else ""
        view.set_shot(Shot(panel.image, "", quantity, panel.title, panel.levels, origin=(first[0], first[1])))

    def _show_curves(self, k: int, title: str, curves: GainCurves) -> None:
        plot, named = self.curves[k], []
        plot.clear()
        self.curve_heads[k].setText(title)
        for n, (name, gains) in enumerate(zip(curves.names, curves.gains, strict=True)):
            tone, text = LINES[n % len(LINES)], name.replace("_", " ")
            plot.set_curve(text, curves.chi2, gains, colour=tone)
            named.append(f"<span style='color:{shown_tone(tone)}'>━</span>&nbsp;{text}")
        camera, chi2 = list(curves.cameras.items())[-1]
        place = min(max(chi2, float(curves.chi2[0])), float(curves.chi2[-1]))
        self.markers[k].setPos(math.log10(place))
        self.markers[k].setPen(pg.mkPen(current_theme().text, width=1.2, style=Qt.PenStyle.DashLine))
        self.legends[k].setText(f"{' &nbsp; '.join(named)}<br>┆ {camera}, χ² = {chi2:.3g}")

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        if self.stack.count() == 0:
            return
        for view in (*self.views, *self.curves, self.map):
            view.apply_theme()
        if self.shown is not None:
            for k, (title, curves) in enumerate(self.shown.curves):
                self._show_curves(k, title, curves)


MODULATORS = ("family", "cfa", "pattern", "mask", "size", "written")
MODULATORS += ("reference_cfa", "reference_mask", "reference_written")
"""Settings that change the modulator or its reference."""


class Drawing:
    """Draws the figure that is chosen, once."""

    def __init__(self, context: Context, view: FiguresView) -> None:
        self.context, self.view = context, view
        self._asked: tuple[Any, ...] = ()

    def forget(self) -> None:
        """Forget the figure, so that it is drawn again: its file may have changed."""
        self._asked = ()

    def draw(self) -> None:
        """Draw the chosen figure, unless it is there or under way."""
        settings, camera = MultiplexSettings.of(self.context.state), self.context.state.camera
        own = settings.own_camera or settings.figure == 6
        chi2 = camera_chi2(camera.sensor, gain=settings.gain) if own else None
        asked: tuple[Any, ...] = (settings.figure, chi2, camera.name if own else "")
        if settings.figure == MAP:
            asked = (MAP, *(getattr(settings, key) for key in MODULATORS))
        if asked == self._asked:
            return
        self._asked = asked
        self.view.show_status("computing …")
        if settings.figure == MAP:
            chi2s = 10.0 ** np.arange(-4, 5)
            self.context.jobs.compute(
                "multiplex figure",
                lambda: gain_map(settings.modulator(), settings.reference(), chi2s),
                lambda found: self.view.show_map(found) if asked == self._asked else None,
                self.view.show_refusal,
            )
            return
        self.context.jobs.compute(
            "multiplex figure",
            lambda: paper_figure(settings.figure, camera=camera.name, chi2=chi2),
            lambda found: self.view.show_figure(found) if asked == self._asked else None,
            self.view.show_refusal,
        )
