"""Dialog with the measurements that determine undescribed effects, and buttons for the next steps."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDialog, QVBoxLayout, QWidget

from lfcal.simulate import EffectMeasurement, UndescribedEffects
from lfcal_gui.models import capital, minus, typeset
from lfcal_gui.pages.simulate.model_effects import determined_words
from lfcal_gui.pages.simulate.model_measure import BeadPlan
from lfcal_gui.widgets import button, column_of, heading, line, name_controls, scrolling, wrapped

MEANING = "Each measurement determines the effects below it. Percentages: possible error of the image."
USE = "Make this the plan of the project, with the chosen positions, and open Record. Undo restores the previous plan"
SAVE = "Save the plan and the list of its positions, for lfcal acquire"
WHITE = "Compare the camera with a white image in Set up, and use the lattice measured there"
VALUES = "Select the largest of these effects, to enter its value"


class MeasureDialog(QDialog):
    """Dialog with the measurements, cheapest first; the positions of bead frames are added when they are chosen.

    Parameters
    ----------
    parent, missing
        The page, and the effects with their measurements.
    act
        Called with the user's choice: ``"use"``, ``"save"``, ``"white"`` or ``"values"``.
    """

    def __init__(self, parent: QWidget, missing: UndescribedEffects, act: Callable[[str], object]) -> None:
        super().__init__(parent)
        self.setWindowTitle("Measure undescribed effects")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.resize(560, 420)
        self.beads: BeadPlan | None = None
        self.planned = wrapped("", "Choosing the positions …")
        self.use_button = button("Use for recording", USE, lambda: act("use"))
        self.save_button = button("Save plan …", SAVE, lambda: act("save"))
        self.white_button = button("White image …", WHITE, lambda: act("white"))
        self.values_button = button("Enter values", VALUES, lambda: act("values"))
        for one in (self.use_button, self.save_button):
            one.setEnabled(False)
        inner = QWidget()
        parts = [self._part(one) for one in missing.measurements]
        column_of(wrapped("", MEANING), *parts, of=inner, spacing=16).addStretch()
        outer = QVBoxLayout(self)
        outer.addWidget(scrolling(inner))
        name_controls(self)

    def _part(self, one: EffectMeasurement) -> QVBoxLayout:
        title = heading(minus(typeset(capital(one.title))))
        effects = wrapped("hint", determined_words(one))
        if one.depths_um:
            return column_of(title, effects, self.planned, line(self.use_button, self.save_button))
        return column_of(title, effects, line(self.white_button if one.frames else self.values_button))

    def show_beads(self, beads: BeadPlan | None, words: str) -> None:
        """Show the chosen positions, or why there are none."""
        self.beads = beads
        self.planned.setText(words)
        for one in (self.use_button, self.save_button):
            one.setEnabled(beads is not None)
