"""Multiplexing: settings on the left; modulator, numbers and gains, or reconstructions, on the right."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from html import escape

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import (
    QAbstractItemView,
    QGridLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QListWidget,
    QListWidgetItem,
    QPushButton,
    QSizePolicy,
    QTableWidget,
    QTableWidgetItem,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from lfcal_gui.models import Shot
from lfcal_gui.pages.multiplex._pictures import MultiplexPictures
from lfcal_gui.pages.multiplex.figures_view import FiguresView
from lfcal_gui.pages.multiplex.model import BASIC, FIELDS, ModulatorPicture, MultiplexSettings, used_by, why_unused
from lfcal_gui.pages.multiplex.model_compare import ModulatorComparison, number
from lfcal_gui.pages.multiplex.search_view import SearchView
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import (
    LINES,
    ElidedLabel,
    FoldedForm,
    LinePlot,
    Picture,
    card,
    column_area,
    line,
    name_controls,
    set_role,
    shown_tone,
)

NUMBER_HEIGHT = 22
SIGMA, PI = "Spatial basis Σ", "Plenoptic basis Π"
TITLES = ("Pattern", "Spectrum", SIGMA, PI)
CURVES = "Gain of signal to noise"
TIPS = (
    "Transmission of each pixel of a super-pixel for the middle view; colours as seen",
    "Magnitude of the pattern's Fourier weights, zero frequency in the middle, mean over colours",
    "Spatial basis: the weight of each basis function σ (columns j) at each pixel of the super-pixel (rows k, counted "
    "by rows). A pixel records Σ times the light projected on Π, summed over j",
    "Plenoptic basis: the weight of each colour, view or other sample (rows n) in each basis function π (columns j). "
    "Σ Πᵀ is the weight of every sample in every pixel; the reconstruction inverts it",
)
"""Of pattern, spectrum and both bases."""
NAME = Qt.ItemDataRole.UserRole


NO_MODULATOR = "No modulator. Change the settings at the left."

GAIN = "Is the modulator worth its light? Pattern, spectrum, and gain in SNR over the reference"
PICTURES = "Test the modulator on a picture: the recorded frame, the reconstruction, and its error"
FIGURES = "Figures 3, 5, 6 and 7 of Ihrke et al. 2010, of scenes made here, with shared scales"
SEARCH = "Search for the filters or the mask with the largest gain, among those that can be made"


class MultiplexPanel(QWidget):
    """The page's widgets.

    Signals
    -------
    compared(names)
        Modulators ticked for the gain curves.
    open_asked()
        Choose an image.
    """

    compared = Signal(tuple)
    open_asked = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.pictures = MultiplexPictures()
        self.figures, self.search = FiguresView(), SearchView()
        every = {field.key: field for field in FIELDS}
        self.form = FoldedForm(
            tuple(every[key] for key in BASIC),
            tuple(field for key, field in every.items() if key not in BASIC),
            tip="Reference, noise, and method of the reconstruction",
        )
        self.forms = (self.form, self.search.form)
        for form in self.forms:
            form.set_defaults(vars(MultiplexSettings()))
        self.tabs = QTabWidget()
        tabs = (self._modulator_tab(), "Modulator and gain", GAIN), (self.pictures, "Reconstruction", PICTURES)
        tabs = (*tabs, (self.figures, "Figures of the paper", FIGURES), (self.search, "Search", SEARCH))
        for tab, title, tip in tabs:
            self.tabs.setTabToolTip(self.tabs.addTab(tab, title), tip)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(8)
        row.addWidget(column_area(286, self._settings_card(), self._compare_card()))
        row.addWidget(self.tabs, 1)

    # -- building --------------------------------------------------------------------------------------
    def _settings_card(self) -> QWidget:
        frame, column = card("Modulator and scene")
        self.open = QPushButton("Open image …")
        self.open.setToolTip(
            "RAW, TIFF, PNG, …: a grey image is a frame recorded behind this modulator, a colour "
            "image a scene; files can be dropped here as well"
        )
        self.open.clicked.connect(lambda: self.open_asked.emit())
        self.file = ElidedLabel()
        self.file.setProperty("role", "hint")
        column.addLayout(line(self.open, self.file, stretch=1))
        column.addWidget(self.form)
        return frame

    def _compare_card(self) -> QWidget:
        self.compare_card, column = card("Compare with")
        self.others = QListWidget()
        self.others.setAccessibleName("compare with")
        self.others.setToolTip(
            "Also draw the gains of the ticked modulators; those that do not exist in this size are left out"
        )
        # it has the height of its lines: what is left belongs below the card
        self.others.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.others.itemChanged.connect(lambda _: self.compared.emit(self.ticked()))
        column.addWidget(self.others)
        return self.compare_card

    @cached_property
    def views(self) -> tuple[Picture, ...]:
        """Pattern, spectrum and both bases; made when there is a modulator, or the reason why there is none."""
        views = (
            Picture("transmission (1)", axes=("column (px)", "row (px)")),
            Picture("magnitude (1)", axes=("u (1/period)", "v (1/period)")),
            Picture("weight (1)", axes=("j (index)", "pixel k (index)"), square=False),
            Picture("weight (1)", axes=("j (index)", "sample n (index)"), square=False),
        )
        for view, tip, column in zip(views, TIPS, self._columns, strict=True):
            view.setToolTip(tip)
            view.blank.words = NO_MODULATOR
            column.addWidget(view, 1)
        name_controls(self)
        return views

    def _modulator_tab(self) -> QWidget:
        widget = QWidget()
        row = QHBoxLayout(widget)
        row.setContentsMargins(0, 8, 0, 0)
        row.setSpacing(8)
        grid = QGridLayout()
        grid.setSpacing(8)
        self.titles, self._columns = [], []
        for k, (tip, title) in enumerate(zip(TIPS, TITLES, strict=True)):
            label = QLabel(title)
            label.setWordWrap(True)
            label.setMinimumWidth(60)  # names of modulators may be long: they do not widen the window
            label.setToolTip(tip)
            frame, column = card(label)
            self._columns.append(column)
            self.titles.append(label)
            grid.addWidget(frame, k // 2, k % 2)
        for k in range(2):
            grid.setColumnStretch(k, 1)
            grid.setRowStretch(k, 1)
        side = QVBoxLayout()
        side.setSpacing(8)
        side.addWidget(self._numbers_card())
        side.addWidget(self._curve_card(), 1)
        row.addLayout(grid, 7)
        row.addLayout(side, 5)
        return widget

    def _numbers_card(self) -> QWidget:
        frame, column = card("Numbers")
        self.table = QTableWidget(0, 2)
        self.table.setAccessibleName("numbers of the modulator")
        self.table.setToolTip("Transmission, gain, and how well the multiplexed samples can be separated")
        self.table.horizontalHeader().hide()
        self.table.verticalHeader().hide()
        self.table.verticalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        self.table.verticalHeader().setMinimumSectionSize(16)
        self.table.verticalHeader().setDefaultSectionSize(NUMBER_HEIGHT)
        # all rows where the window is high enough, ten at least
        self.table.setMinimumHeight(10 * NUMBER_HEIGHT + 4)
        self.table.setSizeAdjustPolicy(QTableWidget.SizeAdjustPolicy.AdjustToContents)
        self.table.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        self.table.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.table.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.table.horizontalHeader().setSectionResizeMode(0, QHeaderView.ResizeMode.ResizeToContents)
        self.table.horizontalHeader().setSectionResizeMode(1, QHeaderView.ResizeMode.Stretch)
        column.addWidget(self.table, 1)
        return frame

    def _curve_card(self) -> QWidget:
        self.curve_title = QLabel(CURVES)
        self.curve_title.setWordWrap(True)
        self.curve_title.setMinimumWidth(60)
        frame, self._curve_column = card(self.curve_title)
        self.curve_hint = QLabel("")
        self._drawn: list[tuple[str, str, bool]] = []
        self._below = ""
        self.curve_hint.setProperty("role", "hint")
        self.curve_hint.setWordWrap(True)
        self._curve_column.addWidget(self.curve_hint)
        return frame

    @cached_property
    def curve(self) -> LinePlot:
        """The gains; made with the first modulator, as `views` are."""
        made = LinePlot("χ² = photon / additive noise variance (1)", "gain (dB)")
        made.set_decades(x=True)
        made.blank.words = "The reason is given below."
        made.setToolTip("Left: read noise dominates, right: photon noise; dashed: the project's camera")
        self.marker = pg.InfiniteLine(angle=90)
        self.marker.hide()
        made.plot.addItem(self.marker, ignoreBounds=True)
        self._curve_column.insertWidget(1, made, 1)
        name_controls(self)
        return made

    def show_used(self, settings: MultiplexSettings, *, colour: bool) -> None:
        """Offer what matters with these settings; ``colour``: the opened image is in colour."""
        for form in self.forms:
            for key in form.fields:
                why = why_unused(settings, key, colour=colour)
                used = used_by(settings, key, colour=colour)
                form.set_enabled(key, used, why)
                if key in BASIC:
                    form.set_shown(key, used)

    # -- compared --------------------------------------------------------------------------------------
    def ticked(self) -> tuple[str, ...]:
        """Return the names ticked in the list."""
        items = [self.others.item(k) for k in range(self.others.count())]
        return tuple(item.data(NAME) for item in items if item.checkState() == Qt.CheckState.Checked)

    def show_choices(self, names: Sequence[str], ticked: Sequence[str]) -> None:
        """Offer the modulators to compare with."""
        self.compare_card.setVisible(bool(names))
        if tuple(name for name in names if name in ticked) == self.ticked() and len(names) == self.others.count():
            return
        blocker = QSignalBlocker(self.others)
        self.others.clear()
        for name in names:
            item = QListWidgetItem(name.replace("_", " "), self.others)
            item.setData(NAME, name)
            item.setCheckState(Qt.CheckState.Checked if name in ticked else Qt.CheckState.Unchecked)
        blocker.unblock()
        self.others.setFixedHeight(len(names) * self.others.sizeHintForRow(0) + 2 * self.others.frameWidth() + 2)

    # -- modulator -------------------------------------------------------------------------------------
    def show_computing(self) -> None:
        """Mark the picture as outdated until the new one is ready."""
        self.titles[0].setText("Computing …")
        self.table.setEnabled(False)

    def show_picture(self, picture: ModulatorPicture) -> None:
        """Draw the modulator."""
        pattern, spectral, sigma, pi = self.views
        pattern.set_shot(Shot(picture.pattern if picture.colours is None else picture.colours, name="pattern"))
        rows, columns = picture.spectrum.shape
        spectrum = Shot(picture.spectrum, name="spectrum", origin=(-(rows // 2), -(columns // 2)))
        spectral.set_shot(spectrum, keep_view=False)
        sigma.set_shot(Shot(picture.sigma, name="sigma", signed=True))
        pi.set_shot(Shot(picture.pi, name="pi", signed=True))
        kind = "" if picture.real else ", real part"
        shapes = ((SIGMA, picture.sigma), (PI, picture.pi))
        for label, (name, array) in zip(self.titles[2:], shapes, strict=True):
            label.setText(f"{name}, {array.shape[0]} × {array.shape[1]}{kind}")
        self.titles[0].setText(f"Pattern of {picture.name.replace('_', ' ')}")

    def show_refusal(self, words: str) -> None:
        """Show no modulator, and why there is none."""
        for label, title in zip(self.titles, TITLES, strict=True):
            label.setText(title)
        self.curve_title.setText(CURVES)
        for view in self.views:
            view.set_shot(None)
        self.table.setRowCount(0)
        self.curve.clear()
        self._drawn = []
        self.marker.hide()
        set_role(self.curve_hint, "error")
        self.curve_hint.setText(escape(words))

    def show_comparison(self, found: ModulatorComparison, camera: str) -> None:
        """Show numbers and curves."""
        self.table.setEnabled(True)
        self.table.setRowCount(len(found.rows))
        for k, (name, value, tip) in enumerate(found.rows):
            for column, text in enumerate((name, value)):
                item = QTableWidgetItem(text)
                item.setToolTip(f"{value}\n{tip}")
                self.table.setItem(k, column, item)
        self.table.setMaximumHeight(max(10, len(found.rows)) * NUMBER_HEIGHT + 4)
        self.table.updateGeometry()
        self.curve.clear()
        self._drawn = []
        self.marker.hide()
        set_role(self.curve_hint, "hint")
        if found.curves is None:
            self.curve_title.setText(CURVES)
            self.curve_hint.setText(f"No gains: {escape(found.reason)}")
            return
        curves = found.curves
        self.curve_title.setText(f"{CURVES} over {curves.reference.replace('_', ' ')}")
        for k, (name, gains) in enumerate(zip(curves.names, curves.gains, strict=True)):
            if name not in found.left_out:
                tone, dashed, text = LINES[k % len(LINES)], k >= len(LINES), name.replace("_", " ")
                self.curve.set_curve(text, curves.chi2, np.round(gains, 9), colour=tone, dashed=dashed)
                self._drawn.append((text, tone, dashed))
        low, high = float(curves.chi2[0]), float(curves.chi2[-1])
        self.marker.setPos(math.log10(min(max(found.chi2, low), high)))
        self.marker.setPen(pg.mkPen(current_theme().text, width=1.2, style=Qt.PenStyle.DashLine))
        self.marker.show()
        self._below = f"<br>┆ {escape(camera)}, χ² = {number(found.chi2, '.3g')} at full scale"
        if found.left_out:
            self._below += f"<br>Not drawn, as samples are lost: {', '.join(found.left_out)}"
        self._show_legend()

    def _show_legend(self) -> None:
        """Name the curves in their colours, which the theme may change."""
        named = (
            f"<span style='color:{shown_tone(tone)}'>{'╍' if dashed else '━'}</span>&nbsp;{text}"
            for text, tone, dashed in self._drawn
        )
        self.curve_hint.setText(f"{' &nbsp; '.join(named)}{self._below}")

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        if "views" in self.__dict__:
            for plot in (*self.views, self.curve):
                plot.apply_theme()
            self.marker.setPen(pg.mkPen(current_theme().text, width=1.2, style=Qt.PenStyle.DashLine))
        for view in (self.pictures, self.figures, self.search):
            view.apply_theme()
        if self._drawn:
            self._show_legend()
