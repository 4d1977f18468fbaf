"""Camera: the description of optics, lenslets and sensor, with a drawing to scale."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QComboBox,
    QFileDialog,
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from gui.base_page import StagePage
from gui.context import Context
from gui.models.page import Stage
from gui.models.project import SessionState
from gui.pages.camera import model as camera_form
from gui.pages.camera.optics_view import OpticsView
from gui.widgets.form import Field, Form
from lfcal.camera import PRESETS, Camera, MainLens, preset
from lfcal.errors import LfcalError
from lfcal.files import replace_whole, storage_errors
from lfcal.units import format_length

__all__ = ["Page"]


def card(title: str, content: QWidget) -> QFrame:
    """Return ``content`` in a titled frame."""
    frame = QFrame()
    frame.setProperty("role", "card")
    layout = QVBoxLayout(frame)
    layout.setContentsMargins(14, 10, 14, 12)
    heading = QLabel(title)
    heading.setProperty("role", "heading")
    layout.addWidget(heading)
    layout.addWidget(content)
    layout.addStretch()
    return frame


class Page(StagePage):
    """Three forms and a drawing; every change that passes is an undoable change of the session."""

    def __init__(self, stage: Stage, context: Context) -> None:
        super().__init__(stage, context)
        self.presets = QComboBox()
        self.presets.addItem("Preset …", "")
        for name in PRESETS:
            self.presets.addItem(name, name)
        self.presets.setToolTip("Begin with a camera that comes with lfcal")
        self.presets.activated.connect(self._choose_preset)
        self.tools.addWidget(self.presets)
        self.tool_button("Import …", "Raytrix calibration (.xml) or a saved camera (.json)", self.import_file)
        self.tool_button("Save …", "Write this camera as JSON", self.save_file)
        self.forms = {
            "MainLens": self._form(camera_form.MAIN_LENS),
            "Microscope": self._form(camera_form.MICROSCOPE),
            "lattice": self._form(camera_form.LATTICE),
            "sensor": self._form(camera_form.SENSOR),
        }
        optics = QWidget()
        column = QVBoxLayout(optics)
        column.setContentsMargins(0, 0, 0, 0)
        column.addWidget(self.forms["MainLens"])
        column.addWidget(self.forms["Microscope"])
        self.view = OpticsView()
        self.facts = QLabel()
        self.facts.setTextFormat(Qt.TextFormat.RichText)
        self.facts.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._lay_out(optics)
        context.theme_changed.connect(self.view.apply_theme)
        self._show(context.state.camera)

    def _form(self, specs: tuple[camera_form.FieldSpec, ...]) -> Form:
        form = Form(tuple(Field(**asdict(spec)) for spec in specs))
        form.check = lambda key, value: camera_form.apply_change(self.context.state.camera, key, value)[1]
        form.edited.connect(self._edited)
        return form

    def _lay_out(self, optics: QWidget) -> None:
        forms = QWidget()
        row = QHBoxLayout(forms)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(10)
        for title, content in (
            ("Main optics", optics),
            ("Lenslet array", self.forms["lattice"]),
            ("Sensor and light", self.forms["sensor"]),
        ):
            row.addWidget(card(title, content), 1)
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setWidget(forms)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAsNeeded)
        grid = QGridLayout(self.body)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(10)
        grid.addWidget(area, 0, 0, 1, 2)
        grid.addWidget(card("Optics, to scale", self.view), 1, 0)
        grid.addWidget(card("What follows", self.facts), 1, 1)
        grid.setRowStretch(0, 3)
        grid.setRowStretch(1, 2)
        grid.setColumnStretch(0, 3)
        grid.setColumnStretch(1, 1)

    # -- session -> widgets ------------------------------------------------------------------------------
    def state_changed(self, old: SessionState, new: SessionState) -> None:
        """Show the camera if it changed."""
        if old.camera != new.camera:
            self._show(new.camera)

    def _show(self, camera: Camera) -> None:
        values = camera_form.values_of(camera)
        kind = values["optics.kind"]
        for name in ("MainLens", "Microscope"):
            self.forms[name].setVisible(name == kind)
        for form in (self.forms[kind], self.forms["lattice"], self.forms["sensor"]):
            form.set_values({key: values[key] for key in form.fields})
        self.view.set_camera(camera)
        self.facts.setText(facts(camera))

    # -- widgets -> session ------------------------------------------------------------------------------
    def _edited(self, key: str, value: Any) -> None:
        camera, _ = camera_form.apply_change(self.context.state.camera, key, value)
        if camera is not None:
            self._set(camera, f"change of {key.split('.')[1].replace('_', ' ')}")

    def _set(self, camera: Camera, label: str) -> None:
        self.context.session.update(label, camera=camera, plan=None)

    def _choose_preset(self, index: int) -> None:
        name = self.presets.itemData(index)
        self.presets.setCurrentIndex(0)
        if name:
            self._set(preset(name), f"preset {name}")

    def import_file(self, path: str = "") -> None:
        """Take a camera from a Raytrix XML or JSON file."""
        path = path or QFileDialog.getOpenFileName(self, "Import camera", "", "Cameras (*.xml *.json)")[0]
        if not path:
            return
        try:
            self._set(read_camera(Path(path)), f"import of {Path(path).name}")
            self.context.message.emit(f"camera taken from {path}")
        except LfcalError as error:
            self.context.message.emit(str(error))

    def save_file(self, path: str = "") -> None:
        """Write the camera as JSON."""
        name = f"{self.context.state.camera.name}.json"
        path = path or QFileDialog.getSaveFileName(self, "Save camera", name, "Camera (*.json)")[0]
        if not path:
            return
        try:
            with replace_whole(path) as part:
                part.write_text(self.context.state.camera.to_json(), encoding="utf-8")
            self.context.message.emit(f"camera saved as {path}")
        except LfcalError as error:
            self.context.message.emit(str(error))

    def accept_drop(self, paths: list[str]) -> bool:
        """Take a dropped calibration."""
        if len(paths) == 1 and paths[0].lower().endswith(".xml"):
            self.import_file(paths[0])
            return True
        return False


def read_camera(path: Path) -> Camera:
    """Return the camera of a JSON or Raytrix XML file."""
    from lfcal.camera import read_raytrix_xml

    if path.suffix.lower() == ".xml":
        return read_raytrix_xml(path)
    with storage_errors(path):
        return Camera.from_json(path.read_text(encoding="utf-8", errors="replace"))


def facts(camera: Camera) -> str:
    """Return what follows from the description, as rich text."""
    y, x = camera.period_px
    rows = [
        ("Working f-number", f"{camera.optics.working_f_number:.3g}"),
        ("Lenslet f-number", f"{camera.lattice.gap_um / camera.lattice.pitch_um:.3g}"),
        ("Magnification |M|", f"{camera.magnification:.4g}"),
        ("Micro-image pitch", f"{camera.pitch_px:.3f} px"),
        ("Period of the array", f"{x:.2f} × {y:.2f} px"),
        ("Positions in a period", f"{max(1, round(x))} × {max(1, round(y))}"),
        ("Object step for 1 px", format_length(camera.step_um())),
    ]
    if isinstance(camera.optics, MainLens):
        rows.insert(2, ("Image distance", format_length(camera.optics.image_distance_um)))
    cells = "".join(
        f"<tr><td style='padding-right:14px'>{name}</td><td><b>{value}</b></td></tr>" for name, value in rows
    )
    return f"<table cellspacing='2'>{cells}</table>"
