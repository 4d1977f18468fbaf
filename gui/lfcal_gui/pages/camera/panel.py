"""Camera: three forms, the optics to scale, and what follows from them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import (
    QComboBox,
    QFrame,
    QHBoxLayout,
    QLabel,
    QScrollArea,
    QSplitter,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from lfcal.camera import PRESETS, Camera
from lfcal_gui.models import Field
from lfcal_gui.pages.camera._optics_view import OpticsView
from lfcal_gui.pages.camera._panel_assumed import AssumedList
from lfcal_gui.pages.camera._panel_check import CheckPanel
from lfcal_gui.pages.camera.model import facts, values_of
from lfcal_gui.pages.camera.model_fields import LATTICE, LIGHT, MAIN_LENS, MICROSCOPE, SENSOR
from lfcal_gui.pages.camera.model_marks import TIPS, assumed_values, mark_of
from lfcal_gui.widgets import Form, card, clear, heading

__all__ = ["CameraPanel", "PresetBox"]

LEAST_BELOW = 260
"""Height left for what follows from the description (px), before the forms have all they need."""


TAB_TIPS = (
    "The optics drawn to scale, and what the description means: magnification, steps, depths in focus",
    "Values that nobody stated: look here before figures are trusted",
    "Is the lattice where the description says? A white image tells, and gives the measured one",
)


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
        self.setAccessibleName("preset")
        self.setToolTip(
            "Start with a camera that comes with lfcal, and change what is different; undo brings yours back"
        )
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
            "light": self._form(LIGHT),
        }
        self.view = OpticsView()
        self.facts = QLabel()
        self.facts.setTextFormat(Qt.TextFormat.RichText)
        self.facts.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.assumed, self.check = AssumedList(), CheckPanel()
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        self.tabs.tabBar().setDrawBase(False)
        titles = ((self._overview(), "What follows"), (self.assumed, "Assumed"), (self.check, "White image"))
        for (content, title), tip in zip(titles, TAB_TIPS, strict=True):
            self.tabs.setTabToolTip(self.tabs.addTab(content, title), tip)
        below, column = card()
        column.setContentsMargins(10, 0, 10, 0)
        column.addWidget(self.tabs)
        self.split = both = QSplitter(Qt.Orientation.Vertical)
        both.setChildrenCollapsible(False)
        both.setHandleWidth(6)
        both.setStyleSheet("QSplitter::handle { background: transparent; }")
        self.area = self._form_area()
        both.addWidget(self.area)
        both.addWidget(below)
        both.splitterMoved.connect(lambda *_: self._keep())
        self._kept = False
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(both)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Give the forms the height they need, as long as the user has not chosen another and much is left."""
        super().resizeEvent(event)
        inner = self.area.widget()
        if not self._kept and inner is not None:
            height = self.height() - self.split.handleWidth()
            above = min(inner.sizeHint().height() + 2, height - min(LEAST_BELOW, height // 2))
            self.split.setSizes([above, height - above])

    def _keep(self) -> None:
        """Leave the parts as the user has them."""
        self._kept = True

    def show_check(self) -> None:
        """Look at the white image."""
        self.tabs.setCurrentWidget(self.check)

    def _overview(self) -> QWidget:
        """Return the drawing, and beside it what follows from the description."""
        self.facts.setWordWrap(True)
        self.facts.setAlignment(Qt.AlignmentFlag.AlignTop)
        scroll = QScrollArea()
        scroll.setWidgetResizable(True)
        scroll.setWidget(self.facts)
        clear(scroll)
        inner = QWidget()
        row = QHBoxLayout(inner)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self.view, 3)
        row.addWidget(scroll, 2)
        return inner

    def _form(self, fields: tuple[Field, ...]) -> Form:
        form = Form(fields, marked=True, dense=True)
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
        row.setSpacing(8)
        first, below = _titled("Main optics", optics), self.forms["light"]
        inner = first.layout()
        assert isinstance(inner, QVBoxLayout)
        for k, part in enumerate((heading("Light"), below)):
            inner.insertWidget(2 + k, part)
        row.addWidget(first, 1)
        for title, content in (("Lenslet array", self.forms["lattice"]), ("Sensor", self.forms["sensor"])):
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
        for form in (self.forms[kind], self.forms["lattice"], self.forms["sensor"], self.forms["light"]):
            form.set_values({key: values[key] for key in form.fields})
            marks = {key: mark_of(camera, key) for key in form.fields}
            form.set_marks({key: (mark, TIPS[mark or "stated"]) for key, mark in marks.items()})
        assumed = assumed_values(camera)
        self.assumed.show_values(assumed)
        self.tabs.setTabText(self.tabs.indexOf(self.assumed), f"Assumed ({len(assumed)})" if assumed else "Assumed")
        self.view.set_camera(camera)
        self.facts.setText(facts(camera))

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.view.apply_theme()
        self.check.apply_theme()


def _titled(title: str, content: QWidget) -> QFrame:
    frame, column = card(title)
    column.setContentsMargins(10, 2, 10, 2)
    column.addWidget(content)
    column.addStretch()
    return frame
