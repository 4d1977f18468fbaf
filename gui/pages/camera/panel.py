"""Camera: three forms, the optics to scale, and what follows from them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QComboBox, QFrame, QGridLayout, QHBoxLayout, QLabel, QScrollArea, QVBoxLayout, QWidget

from gui.models.form import Field
from gui.pages.camera.model import LATTICE, MAIN_LENS, MICROSCOPE, SENSOR, facts, values_of
from gui.pages.camera.optics_view import OpticsView
from gui.widgets.cards import card
from gui.widgets.form import Form
from lfcal.camera import PRESETS, Camera

__all__ = ["CameraPanel", "PresetBox"]


class PresetBox(QComboBox):
    """The cameras that come with lfcal.

    Signals
    -------
    chosen(name)
        One was picked.
    """

    chosen = Signal(str)

    def __init__(self) -> None:
        super().__init__()
        self.addItem("Preset …", "")
        for name in PRESETS:
            self.addItem(name, name)
        self.setToolTip("Start with a camera that comes with lfcal")
        self.activated.connect(self._activated)

    def _activated(self, index: int) -> None:
        name = self.itemData(index)
        self.setCurrentIndex(0)  # a preset is a start, not a state: the camera may be changed afterwards
        if name:
            self.chosen.emit(name)


class CameraPanel(QWidget):
    """The page's widgets.

    Parameters
    ----------
    check
        Returns why a field cannot take a value, or an empty string.

    Signals
    -------
    edited(key, value)
        The user changed a field, and it passes.
    """

    edited = Signal(str, object)

    def __init__(self, check: Callable[[str, Any], str]) -> None:
        super().__init__()
        self._check = check
        self.forms = {
            "MainLens": self._form(MAIN_LENS),
            "Microscope": self._form(MICROSCOPE),
            "lattice": self._form(LATTICE),
            "sensor": self._form(SENSOR),
        }
        self.view = OpticsView()
        self.facts = QLabel()
        self.facts.setTextFormat(Qt.TextFormat.RichText)
        self.facts.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(10)
        grid.addWidget(self._form_area(), 0, 0, 1, 2)
        grid.addWidget(_titled("Optics, to scale", self.view), 1, 0)
        grid.addWidget(_titled("Derived quantities", self.facts), 1, 1)
        grid.setRowStretch(0, 3)
        grid.setRowStretch(1, 2)
        grid.setColumnStretch(0, 3)
        grid.setColumnStretch(1, 1)

    def _form(self, fields: tuple[Field, ...]) -> Form:
        form = Form(fields)
        form.check = self._check
        form.edited.connect(self.edited.emit)
        return form

    def _form_area(self) -> QScrollArea:
        optics = QWidget()
        column = QVBoxLayout(optics)
        column.setContentsMargins(0, 0, 0, 0)
        column.addWidget(self.forms["MainLens"])
        column.addWidget(self.forms["Microscope"])
        forms = QWidget()
        row = QHBoxLayout(forms)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(10)
        for title, content in (
            ("Main optics", optics),
            ("Lenslet array", self.forms["lattice"]),
            ("Sensor and light", self.forms["sensor"]),
        ):
            row.addWidget(_titled(title, content), 1)
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setWidget(forms)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAsNeeded)
        return area

    def show_camera(self, camera: Camera) -> None:
        """Show a camera: its values, its drawing, what follows from it."""
        values = values_of(camera)
        kind = values["optics.kind"]
        for name in ("MainLens", "Microscope"):
            self.forms[name].setVisible(name == kind)
        for form in (self.forms[kind], self.forms["lattice"], self.forms["sensor"]):
            form.set_values({key: values[key] for key in form.fields})
        self.view.set_camera(camera)
        self.facts.setText(facts(camera))

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.view.apply_theme()


def _titled(title: str, content: QWidget) -> QFrame:
    frame, column = card(title)
    column.addWidget(content)
    column.addStretch()
    return frame
