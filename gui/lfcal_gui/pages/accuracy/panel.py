"""Accuracy: places and settings on the left; the chart, what an error would cost, and the rung used on the right."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import QComboBox, QFrame, QHBoxLayout, QLabel, QListWidget, QListWidgetItem, QSizePolicy, QWidget

from lfcal.accuracy import PLACES, Curve
from lfcal_gui.models import axis_labels, points_of
from lfcal_gui.pages.accuracy.model import FIELDS, AccuracySettings, words_of
from lfcal_gui.widgets import CostCurve, FoldedForm, card, column_area


class AccuracyPanel(QWidget):
    """The page's widgets.

    Signals
    -------
    place_asked(name)
        Another place is looked at.
    rung_chosen(number)
        Use the rung of this number.
    """

    place_asked = Signal(str)
    rung_chosen = Signal(int)

    def __init__(self) -> None:
        super().__init__()
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(8)
        row.addWidget(column_area(300, self._places_card(), self._settings_card()))
        row.addWidget(self._chart_card(), 1)

    # -- building --------------------------------------------------------------------------------------
    def _places_card(self) -> QFrame:
        frame, column = card("Where accuracy costs time")
        self.places = QListWidget()
        self.places.setAccessibleName("places where accuracy costs time")
        self.places.setToolTip("Choose a place to see its error and cost, with a point for each measured setting")
        for place in PLACES:
            item = QListWidgetItem(place.title)
            item.setData(Qt.ItemDataRole.UserRole, place.name)
            item.setToolTip(f"Error: {place.error}.\nCost: {place.cost}.")
            self.places.addItem(item)
        # as high as its rows are when they are styled
        self.places.setSizeAdjustPolicy(QListWidget.SizeAdjustPolicy.AdjustToContents)
        self.places.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Fixed)
        self.places.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.places.currentItemChanged.connect(self._place_changed)
        column.addWidget(self.places)
        frame.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Maximum)
        return frame

    def _settings_card(self) -> QFrame:
        frame, column = card("Measurement")
        self.form = FoldedForm(FIELDS)
        self.form.set_defaults(vars(AccuracySettings()))
        column.addWidget(self.form)
        return frame

    def _chart_card(self) -> QFrame:
        self.title = QLabel("Error versus cost")
        frame, column = card(self.title)
        self.chart = CostCurve()
        self.chart.chosen.connect(self.rung_chosen.emit)
        self.answer = _label("value")
        self.used = _label("")
        self.how = _label("hint")
        column.addWidget(self.answer)
        column.addWidget(self.chart, 1)
        for label in (self.used, self.how):
            column.addWidget(label)
        return frame

    # -- showing ---------------------------------------------------------------------------------------
    def show_settings(self, settings: AccuracySettings, open_to: Collection[str]) -> None:
        """Show what the user chose; subjects that are not in ``open_to`` cannot be."""
        self.form.set_values({field.key: getattr(settings, field.key) for field in FIELDS})
        box = self.form.editor("subject")
        if isinstance(box, QComboBox):
            for k in range(box.count()):
                item = box.model().item(k)  # type: ignore[attr-defined]
                item.setEnabled(box.itemData(k) in open_to)
        blocker = QSignalBlocker(self.places)
        for k in range(self.places.count()):
            if self.places.item(k).data(Qt.ItemDataRole.UserRole) == settings.place:
                self.places.setCurrentRow(k)
        blocker.unblock()

    def show_measured(self, curves: Mapping[str, Curve], running: str) -> None:
        """Mark the places that have measurements, and the place that is being measured."""
        for k in range(self.places.count()):
            item = self.places.item(k)
            name = item.data(Qt.ItemDataRole.UserRole)
            curve = curves.get(name)
            mark = "…" if name == running else ("✓" if curve is not None and curve.rungs else " ")
            item.setText(f"{mark}  {PLACES.get(name).title}")

    def show_curve(self, curve: Curve | None, settings: AccuracySettings, took: str, *, running: bool) -> None:
        """Show a curve as far as it is measured, or that there is none yet; ``took``: how long that was."""
        answer, how = words_of(curve, settings.error, running=running)
        self.answer.setText(answer)
        self.how.setText(how)
        title = PLACES.get(settings.place).title if settings.place in PLACES else settings.place
        self.title.setText(title)
        if curve is not None:
            self.chart.set_labels(*axis_labels(curve))
        points = () if curve is None else points_of(curve, curve.cheapest(settings.error))
        self.chart.show_points(points, math.log10(100 * settings.error), "error")
        self.chart.show_status(took, "" if running else "Measure again" if took else "Measure")

    def show_used(self, words: str) -> None:
        """Show what a rung changed, or nothing."""
        self.used.setText(words)
        self.used.setVisible(bool(words))

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.chart.apply_theme()

    def _place_changed(self, item: QListWidgetItem | None) -> None:
        if item is not None:
            self.place_asked.emit(item.data(Qt.ItemDataRole.UserRole))


def _label(role: str) -> QLabel:
    label = QLabel()
    label.setWordWrap(True)
    label.setTextFormat(Qt.TextFormat.PlainText)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    if role:
        label.setProperty("role", role)
    return label
