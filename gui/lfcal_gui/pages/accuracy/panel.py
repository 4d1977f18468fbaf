"""Accuracy: parts and settings on the left; chart, cost of the target error, and used point on the right."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import QComboBox, QFrame, QLabel, QListWidget, QListWidgetItem, QSizePolicy, QWidget

from lfcal.accuracy import PARTS, CostPoint, Curve
from lfcal_gui.models import axis_labels, points_of
from lfcal_gui.pages.accuracy.model import FIELDS, AccuracySettings, words_of
from lfcal_gui.widgets import CostCurve, FoldedForm, card, column_area, row_of


class AccuracyPanel(QWidget):
    """The page's widgets."""

    part_asked = Signal(str, arguments=["name"])
    """Another part was selected."""
    point_chosen = Signal(int, arguments=["number"])
    """The user chose the point with this number."""

    def __init__(self) -> None:
        super().__init__()
        row_of(
            column_area(300, self._parts_card(), self._settings_card()),
            self._chart_card(),
            of=self,
            spacing=8,
            stretch=1,
        )

    # -- building --------------------------------------------------------------------------------------
    def _parts_card(self) -> QFrame:
        frame, column = card("Where accuracy costs time")
        self.parts = QListWidget()
        self.parts.setAccessibleName("Parts of the processing")
        self.parts.setToolTip(
            "Choose a part of the processing to see its error and cost, with a point for each measured setting"
        )
        for part in PARTS:
            item = QListWidgetItem(part.title)
            item.setData(Qt.ItemDataRole.UserRole, part.name)
            item.setToolTip(f"Error: {part.error}.\nCost: {part.cost}.")
            self.parts.addItem(item)
        # as high as its rows are when they are styled
        self.parts.setSizeAdjustPolicy(QListWidget.SizeAdjustPolicy.AdjustToContents)
        self.parts.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Fixed)
        self.parts.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.parts.currentItemChanged.connect(self._part_changed)
        column.addWidget(self.parts)
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
        self.chart.chosen.connect(self.point_chosen.emit)
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
        """Show the settings; subjects that are not in ``open_to`` cannot be selected."""
        self.form.set_values({field.key: getattr(settings, field.key) for field in FIELDS})
        box = self.form.editor("subject")
        if isinstance(box, QComboBox):
            for k in range(box.count()):
                item = box.model().item(k)  # type: ignore[attr-defined]
                item.setEnabled(box.itemData(k) in open_to)
        with QSignalBlocker(self.parts):
            for k in range(self.parts.count()):
                if self.parts.item(k).data(Qt.ItemDataRole.UserRole) == settings.part:
                    self.parts.setCurrentRow(k)

    def show_measured(self, curves: Mapping[str, Curve], running: str) -> None:
        """Mark the parts that have measurements, and the part that is being measured."""
        for k in range(self.parts.count()):
            item = self.parts.item(k)
            name = item.data(Qt.ItemDataRole.UserRole)
            curve = curves.get(name)
            mark = "…" if name == running else ("✓" if curve is not None and curve.points else " ")
            item.setText(f"{mark}  {PARTS.get(name).title}")

    def show_curve(
        self, curve: Curve | None, settings: AccuracySettings, took: str, used: CostPoint | None, *, running: bool
    ) -> None:
        """Show the measured part of a curve, the duration ``took`` of its measurement, and the point in use."""
        answer, how = words_of(curve, settings.error, running=running, in_use=used)
        self.answer.setText(answer)
        self.how.setText(how)
        title = PARTS.get(settings.part).title if settings.part in PARTS else settings.part
        self.title.setText(title)
        if curve is not None:
            self.chart.set_labels(*axis_labels(curve))
        points = () if curve is None else points_of(curve, curve.cheapest(settings.error), used, (settings.error,))
        self.chart.show_points(points, math.log10(100 * settings.error), "error")
        self.chart.show_status(took, "" if running else "Measure again" if took else "Measure")

    def show_used(self, words: str) -> None:
        """Show what the use of a point changed, or nothing."""
        self.used.setText(words)
        self.used.setVisible(bool(words))

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.chart.apply_theme()

    def _part_changed(self, item: QListWidgetItem | None) -> None:
        if item is not None:
            self.part_asked.emit(item.data(Qt.ItemDataRole.UserRole))


def _label(role: str) -> QLabel:
    label = QLabel()
    label.setWordWrap(True)
    label.setTextFormat(Qt.TextFormat.PlainText)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    if role:
        label.setProperty("role", role)
    return label
