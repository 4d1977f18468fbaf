"""The fit of the optics: settings, verdict, findings, parameters, convergence and patterns."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import (
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QListWidget,
    QListWidgetItem,
    QProgressBar,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from lfcal.base import Progress
from lfcal.fit import Fit, FitProgress
from lfcal.tasks import FitMatrix
from lfcal_gui.models import DisplaySettings, ProjectState, Shot, check_of, fields_of, levels_of, shown_of, typeset
from lfcal_gui.pages.h import model_fit_run
from lfcal_gui.pages.h.model_fit import HELD, START, FitSettings, Offer, group_rows
from lfcal_gui.pages.h.model_fit_run import FoundFit, Place
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import (
    LINES,
    Contrast,
    DecadeAxis,
    Folded,
    FoldedForm,
    LinePlot,
    Picture,
    RowsTable,
    WrappedLabel,
    button,
    choice_box,
    column_of,
    line,
    line_px,
    link,
    name_controls,
    set_role,
    share_contrast,
)

NAME = Qt.ItemDataRole.UserRole
WAYS = (("auto", "automatic: those that help"), ("chosen", "as chosen below"))


class _Groups(QListWidget):
    """A list whose height fits its wrapped lines."""

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Wrap the lines for the new width."""
        super().resizeEvent(event)
        self.fit_height()

    def fit_height(self) -> None:
        """Set the height to that of all lines."""
        self.doItemsLayout()
        lines = [self.visualItemRect(self.item(k)) for k in range(self.count())]
        self.setFixedHeight(lines[-1].bottom() - lines[0].top() + 2 * self.frameWidth() + 6)


class ChoicesPanel(QWidget):
    """Folded form of the fit: its settings and groups of unknowns."""

    edited = Signal(str, object, arguments=["key", "value"])
    """The user changed a value of `FitSettings`."""
    group_toggled = Signal(str, bool, arguments=["name", "on"])
    """The user switched the fit of a group of unknowns on or off."""

    def __init__(self) -> None:
        super().__init__()
        column = column_of(self._start(), of=self, spacing=6)
        self.unknowns = self._unknowns()
        column.addWidget(self.unknowns)

    # -- building --------------------------------------------------------------------------------------
    def _start(self) -> Folded:
        frame = Folded("Patterns and start", "Positions, noise and camera with which the fit starts")
        column = frame.column
        self.source, self.use, self.start, self.noise = (_wrapped() for _ in range(4))
        some, rare = (fields_of(FitMatrix, without=HELD, more=more) for more in (False, True))
        self.form = FoldedForm(
            (START, *some), rare, tip="Initial effects of the simulation, and contents of the saved H"
        )
        self.form.check = check_of(FitMatrix)
        self.form.edited.connect(self.edited.emit)
        column.addWidget(self.source)
        column.addWidget(self.form)
        for label in (self.use, self.start, self.noise):
            column.addWidget(label)
        return frame

    def _unknowns(self) -> Folded:
        frame = Folded("Unknowns", "Groups of camera values that the fit may change")
        column = frame.column
        self.way = choice_box(
            WAYS,
            "Automatic: the fit chooses the groups that lower the error of held-out patterns",
            "choice of unknowns",
        )
        self.way.currentIndexChanged.connect(lambda _: self.edited.emit("auto", self.way.currentData() == "auto"))
        self.groups = _Groups()
        self.groups.setAccessibleName("Groups of unknowns")
        self.groups.setToolTip(
            "Groups of camera values to fit; the others are fixed. If you choose the groups yourself, tick them here"
        )
        for name, title, _ in group_rows():
            item = QListWidgetItem(title)
            item.setData(NAME, name)
            self.groups.addItem(item)
        self.groups.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.groups.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.groups.setWordWrap(True)
        self.groups.setResizeMode(QListWidget.ResizeMode.Adjust)
        self.groups.setTextElideMode(Qt.TextElideMode.ElideNone)
        self.groups.itemChanged.connect(self._toggled)
        self.legend = _wrapped()
        column.addWidget(self.way)
        column.addWidget(self.groups)
        column.addWidget(self.legend)
        return frame

    # -- showing ---------------------------------------------------------------------------------------
    def show_source(self, name: str, offer: Offer | None, project: ProjectState) -> None:
        """Show the data that the H called ``name`` offers to a fit; ``offer`` is None while H is being opened."""
        settings = FitSettings.of(project)
        if offer is None:
            self.source.setText(f"{name} is being opened …")
            for label in (self.use, self.start, self.noise):
                label.setText("")
            return
        self.source.setText(offer.source_words(name))
        self.use.setText(offer.use_words(settings.positions))
        editor = self.form.editor("noise")
        assert isinstance(editor, QLineEdit)
        editor.setPlaceholderText("required" if offer.noise is None else self.form.fields["noise"].empty)
        _say(self.start, *offer.camera_words(settings, project.camera, project.plan))
        _say(self.noise, *offer.noise_words(settings))

    def show_settings(self, settings: FitSettings, fit: Fit | None, lacking: Mapping[str, str]) -> None:
        """Show the settings and, for a ``fit`` that chose its groups automatically, these groups.

        Groups in ``lacking`` are grey, with the reason in the tooltip.
        """
        values = {**shown_of(FitMatrix, vars(settings)), "camera": settings.camera}
        self.form.set_values(values)
        blockers = [QSignalBlocker(self.way), QSignalBlocker(self.groups)]
        self.way.setCurrentIndex(0 if settings.auto else 1)
        groups = fit.groups if fit is not None and settings.auto else None
        for k, (name, title, core) in enumerate(group_rows()):
            item, needs = self.groups.item(k), lacking.get(name, "")
            flags, mark = Qt.ItemFlag.ItemIsEnabled, ""
            if needs:
                flags, mark = Qt.ItemFlag.NoItemFlags, "–  " if settings.auto else ""
            elif settings.auto:
                mark = ("✓  " if core else "?  ") if groups is None else ("✓  " if name in groups else "–  ")
            else:
                flags |= Qt.ItemFlag.ItemIsUserCheckable
            if settings.auto:
                item.setData(Qt.ItemDataRole.CheckStateRole, None)
            else:
                on = name in settings.groups and not needs
                item.setCheckState(Qt.CheckState.Checked if on else Qt.CheckState.Unchecked)
            item.setFlags(flags)
            item.setText(typeset(f"{mark}{title}" + (f"\nneeds {needs}" if needs else "")))
            always = ", always fitted if groups are chosen automatically" if core else ""
            item.setToolTip(f"{name}: {title}" + (f"; needs {needs}" if needs else always))
        self.groups.fit_height()
        self.legend.setText(_legend(settings, fitted=groups is not None))
        self.legend.setVisible(bool(self.legend.text()))
        for blocker in blockers:
            blocker.unblock()

    def set_running(self, running: bool) -> None:
        """Disable the settings while a fit is running."""
        for widget in (self.form, self.way, self.groups):
            widget.setEnabled(not running)

    def _toggled(self, item: QListWidgetItem) -> None:
        self.group_toggled.emit(item.data(NAME), item.checkState() == Qt.CheckState.Checked)


def _legend(settings: FitSettings, *, fitted: bool) -> str:
    if not settings.auto:
        return ""
    return "✓ fitted, – did not help" if fitted else "✓ always fitted, ? tried and kept if it helps"


def _say(label: QLabel, words: str, role: str) -> None:
    label.setText(words)
    set_role(label, role)


def _wrapped() -> QLabel:
    label = WrappedLabel(role="hint")
    return label


SIGMA_ENDS = (-5.0, 5.0)
"""Residuals at the ends of the colour scale (sigma), which is fixed, so that noise looks like noise."""


class FitPictures(QWidget):
    """Three linked pictures of a pattern: measured, model and residual; the first two share one scale."""

    def __init__(self) -> None:
        super().__init__()
        self._found: FoundFit | None = None
        self.place: Place | None = None
        """The displayed position (z, y, x)."""
        self.words = ("", "")
        """Result of `model_fit_run.place_words` for the displayed pattern; empty texts if there is none."""
        self.measured, self.model = Picture(legend=False), Picture(legend=False)
        self.residual = Picture("residual (σ of the noise)", legend=False)
        self.views = (self.measured, self.model, self.residual)
        link(*self.views)
        share_contrast(self.measured, self.model)
        self.contrast = Contrast(self.measured)
        row = QHBoxLayout()
        for view in self.views:
            view.hovered.connect(self._hovered)
            row.addWidget(view, 1)
        column_of(row, self.contrast, of=self, spacing=2, stretch=0)

    def show_fit(self, found: FoundFit | None) -> None:
        """Use the patterns of a fit (None: no fit). The pictures are empty until `show_place` is called."""
        if found is self._found:
            return
        self._found, self.place, self.words = found, None, ("", "")
        for view in self.views:
            view.set_shot(None)

    def nearest(self, place: Place) -> Place:
        """Return the position of the fit nearest to (z, y, x), if possible in the same plane."""
        places = () if self._found is None else self._found.places
        own = [one for one in places if one[0] == place[0]] or places
        return min(own, key=lambda one: math.dist(one, place), default=place)

    def show_place(self, place: Place) -> None:
        """Show the pattern of the fit nearest to a position (z, y, x)."""
        found = self._found
        if found is None:
            return
        self.place = nearest = self.nearest(place)
        self.words = model_fit_run.place_words(found, nearest)
        measured, model = found.patterns[nearest], found.model[nearest]
        levels = levels_of(np.stack([measured, model]))
        name = "z{}_y{}_x{}".format(*nearest)
        shots = (
            (self.measured, Shot(measured, "Measured", found.unit, f"measured_{name}", levels)),
            (self.model, Shot(model, "Model", found.unit, f"model_{name}", levels)),
            (self.residual, Shot(found.residual[nearest], "Residual", "", f"residual_{name}", SIGMA_ENDS, signed=True)),
        )
        for view, shot in shots:
            view.set_shot(replace(shot, pixel_um=found.fit.camera.sensor.pixel_um))

    def step(self, by: int) -> Place | None:
        """Return the position ``by`` patterns further in the displayed plane, row by row."""
        if self._found is None or self.place is None:
            return None
        own = [one for one in self._found.places if one[0] == self.place[0]]
        return own[max(0, min(len(own) - 1, own.index(self.place) + by))]

    def step_plane(self, by: int) -> Place | None:
        """Return the nearest position in the plane ``by`` fitted planes further."""
        if self._found is None or self.place is None:
            return None
        planes = sorted({one[0] for one in self._found.places})
        z = planes[max(0, min(len(planes) - 1, planes.index(self.place[0]) + by))]
        own = [one for one in self._found.places if one[0] == z]
        return min(own, key=lambda one: math.dist(one, self.place or one))

    def set_display(self, display: DisplaySettings) -> None:
        """Set scaling and colours; residuals stay linear."""
        for view in self.views[:2]:
            view.set_display(replace(display))
        self.contrast.update()

    def _hovered(self, row: int, column: int, _: float) -> None:
        found, place = self._found, self.place
        if found is None or place is None or row < 0:
            for view in self.views:
                view.set_cross(None)
            self.residual.set_note("")
            return
        for view in self.views:
            view.set_cross(row, column)
        a, b, c = (float(one[place][row, column]) for one in (found.patterns, found.model, found.residual))
        off = f"{c:+.1f} σ" if found.valid[place][row, column] else "no measurement"
        self.residual.set_note(f"t {row}, s {column}: measured {a:.5g}, model {b:.5g} {found.unit}; {off}")

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        for widget in (*self.views, self.contrast):
            widget.apply_theme()


FLOOR = 1e-6
"""Smallest value that is drawn on the logarithmic axis."""

LEFT = 64
"""Fixed width of the vertical axes (px), which aligns both plots."""

MANY = 12
"""Number of rounds above which only every fifth is labelled."""

HEIGHT = 130
"""Height of a plot (px)."""


class DecadePlot(LinePlot):
    """Plot of positive values on a logarithmic axis over whole numbers; values that are only limits are hollow."""

    def __init__(self, label: str, colour: str) -> None:
        super().__init__("", label)
        self._y, self._colour = label, colour
        self._values: list[float] = []
        self.plot.set_axes(DecadeAxis("left"))
        self.plot.getAxis("left").setWidth(LEFT)
        self.blank.show_blank(False)
        self.blank.show_blank(True)
        self.line, self.dots = pg.PlotDataItem(pen=pg.mkPen(colour, width=line_px(1.8))), pg.ScatterPlotItem(size=8)
        for item in (self.line, self.dots):
            self.plot.addItem(item)
        self.set_labels("round of derivatives", label)

    def show_values(self, values: Sequence[float], limits: Sequence[bool]) -> None:
        """Show values from round 0 (the start); values in ``limits`` are hollow, and NaN are omitted."""
        self._values = list(values)
        self.blank.show_blank(not self._values)
        theme = current_theme()
        points = [(k, math.log10(max(v, FLOOR)), limits[k]) for k, v in enumerate(values) if not math.isnan(v)]
        self.line.setData([x for x, _, _ in points], [y for _, y, _ in points])
        pen = pg.mkPen(self._colour, width=line_px(1.6))
        fill = {True: pg.mkBrush(theme.panel), False: pg.mkBrush(self._colour)}
        self.dots.setData([{"pos": (x, y), "pen": pen, "brush": fill[limit]} for x, y, limit in points])
        self.plot.getAxis("bottom").setTickSpacing(5 if len(values) > MANY else 1, 1)
        if points:
            low, high = min(y for _, y, _ in points), max(y for _, y, _ in points)
            # a decade at least, or noise fills the plot
            middle, half = (low + high) / 2, max(0.5, (high - low) / 2)
            self.plot.vb.setYRange(middle - 1.1 * half, middle + 1.1 * half, padding=0)
            self.plot.vb.setXRange(-0.3, max(4, len(values) - 1) + 0.3, padding=0)

    def table_lines(self, between: str) -> Iterator[str]:
        """Yield the values as table lines of round and value."""
        yield f"# round, {self._y}\n"
        yield from (f"{k}{between}{value:.9g}\n" for k, value in enumerate(self._values))


class RoundsView(QWidget):
    """Convergence of a fit: two plots, one below the other."""

    def __init__(self) -> None:
        super().__init__()
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 6, 0, 0)
        self.error = DecadePlot("error of held-out patterns (%)", LINES[0])
        self.chi2 = DecadePlot("χ² of fitted patterns", LINES[1])
        self._rounds: tuple[FitProgress, ...] = ()
        for plot in (self.error, self.chi2):
            plot.setFixedHeight(HEIGHT)
            column.addWidget(plot)
        self.words = QLabel(wordWrap=True)
        self.words.setProperty("role", "hint")
        column.addWidget(self.words)

    def show_rounds(self, rounds: Sequence[FitProgress], none: str = "The start is being computed …") -> None:
        """Show the start and the completed rounds; ``none`` is the message if there are none."""
        self._rounds = tuple(rounds)
        self.error.show_values([100 * one.held_out for one in rounds], [one.below_noise for one in rounds])
        self.chi2.show_values([one.chi2 for one in rounds], [False] * len(rounds))
        if not rounds:
            self.words.setText(none)
            for plot in (self.error, self.chi2):
                plot.blank.words = none
            return
        parts = [f"{rounds[-1].stage}: {rounds[-1].note}."]
        if any(one.below_noise for one in rounds):
            parts.append("Hollow symbols: the error is below the noise, and the noise limit is drawn.")
        parts.append("χ² includes the numerical error as noise; it may rise when the fit continues at finer sampling.")
        self.words.setText(" ".join(parts))

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.error.apply_theme()
        self.chi2.apply_theme()
        self.show_rounds(self._rounds)


READY = "The fit estimates gap, focal lengths, iris and aberrations from the recorded positions of H."
LEGEND = "Crossed out in the map: left out as an outlier. In a square: held out to test the fit."
NO_ROUNDS = "This fit was made during the recording, so its rounds were not kept."


class FitView(QWidget):
    """View of a fit and its settings."""

    place_asked = Signal(tuple, arguments=["place"])
    """Request to show the pattern of a position (z, y, x)."""

    def __init__(self) -> None:
        super().__init__()
        self._found: FoundFit | None = None
        self.choices = ChoicesPanel()
        column = column_of(of=self, spacing=6)
        self._make_buttons()
        self.verdict, self.detail, self.sums = QLabel(), QLabel(), QLabel()
        for label, role in ((self.verdict, "value"), (self.detail, "hint"), (self.sums, "hint")):
            label.setWordWrap(True)
            label.setTextFormat(Qt.TextFormat.PlainText)
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            label.setProperty("role", role)
        self.bar = QProgressBar(textVisible=False)
        column.addLayout(line(self.fit_button, self.worst_button, self.use_button))
        for part in (self.verdict, self.bar, self.detail):
            column.addWidget(part)
        column.addWidget(self._results())
        column.addWidget(self.choices)
        self._rounds_at = column
        column.addStretch()

    def _make_buttons(self) -> None:
        self.fit_button, self.use_button = QPushButton("Fit"), QPushButton("Use camera")
        self.fit_button.setToolTip("Fit the recorded positions of H (F5)")
        self.worst_button = button("Worst pattern", "Show the pattern with the largest χ² (W)")
        self.model_button, self.save_button = QPushButton("Compute H …"), QPushButton("Save fit …")
        self.model_button.setToolTip("Compute H of the fitted camera at all positions and depths, without noise")
        self.save_button.setToolTip(
            "Write camera, effects, H, results and report into a folder, as the command lfcal fit does"
        )
        self.report_button = button("Report", "Open the HTML report of the fit")
        for one in (self.model_button, self.save_button, self.report_button):
            one.setProperty("role", "tight")

    def _results(self) -> QWidget:
        self.results = QWidget()
        column = QVBoxLayout(self.results)
        column.setContentsMargins(0, 0, 0, 0)
        self.findings = RowsTable(("Findings",), 0, brief=(0,), whole=True)
        self.findings.setAccessibleName("Findings")
        self.findings.setWordWrap(True)
        self.findings.itemSelectionChanged.connect(self._finding_chosen)
        self.findings.cellClicked.connect(lambda *_: self._finding_chosen())  # also where it is selected already
        self.parameters = RowsTable(
            model_fit_run.COLUMNS, 0, model_fit_run.NUMBERS, spare=model_fit_run.SPARE, whole=True
        )
        self.parameters.setAccessibleName("Parameters")
        legend = QLabel(LEGEND, wordWrap=True)
        legend.setProperty("role", "hint")
        column.addLayout(line(self.model_button, self.save_button, self.report_button))
        for table in (self.findings, self.parameters):
            column.addWidget(table)
        column.addWidget(self.sums)
        column.addWidget(legend)
        return self.results

    @cached_property
    def rounds(self) -> RoundsView:
        """View of the convergence, which is created with the first fit."""
        folded = Folded("Convergence", "Error after each round: whether the fit converged, and which unknowns helped")
        made = RoundsView()
        folded.column.addWidget(made)
        self._rounds_at.insertWidget(self._rounds_at.count() - 2, folded)
        name_controls(folded)
        return made

    # -- states ----------------------------------------------------------------------------------------
    def show_ready(self, words: str = "", *, failed: bool = False) -> None:
        """Show that there is no fit yet, with the reason ``words``, as an error if a fit ``failed``."""
        self._found = None
        self.parameters.show_rows([])
        self.findings.show_rows([])
        self.results.hide()
        self._say(words or READY, "", "bad" if failed else "")

    def show_running(self, words: str, record: Progress | None, rounds: Sequence[FitProgress]) -> None:
        """Show the progress of a fit."""
        self._say(words, "", "")
        self.bar.show()
        total = 0 if record is None else record.total
        self.bar.setRange(0, total)
        if record is not None and total:
            self.bar.setValue(record.done)
        self.rounds.show_rounds(rounds)

    def show_found(self, found: FoundFit, rounds: Sequence[FitProgress], note: str = "") -> None:
        """Show the result of a fit; ``note`` states whether the fit is in use, and what changed since."""
        if found is not self._found:
            self._found = found
            self.sums.setText(model_fit_run.chi2_words(found))
            self._show_rows(found)
        self.rounds.show_rounds(rounds, NO_ROUNDS)
        self._say(
            model_fit_run.verdict_of(found.fit),
            "\n".join(filter(None, (model_fit_run.detail_of(found), note))),
            model_fit_run.merit_of(found.fit),
        )
        self.results.show()

    def _say(self, words: str, detail: str, merit: str) -> None:
        self.verdict.setText(words)
        set_role(self.verdict, merit or "value")
        self.detail.setText(detail)
        self.detail.setVisible(bool(detail))
        self.bar.hide()

    def _show_rows(self, found: FoundFit) -> None:
        rows = model_fit_run.parameter_rows(found.fit)
        theme = current_theme()
        self.parameters.show_rows(
            [row.texts for row in rows],
            [row.numbers for row in rows],
            lambda k, column: theme.accent if column == 5 and rows[k].far else "",
        )
        self.findings.show_rows([(f"{one.kind}: {one.text}",) for one in model_fit_run.findings_of(found.fit)])

    def _finding_chosen(self) -> None:
        found, row = self._found, self.findings.chosen()
        if found is not None and row >= 0:
            place = model_fit_run.findings_of(found.fit)[row].place
            if place is not None:
                self.place_asked.emit(place)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        if "rounds" in self.__dict__:
            self.rounds.apply_theme()
        if self._found is not None:
            self._show_rows(self._found)
