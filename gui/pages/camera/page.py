"""Camera: the description of optics, lenslets and sensor, with a drawing to scale."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QFileDialog

from gui.base_page import BasePage
from gui.context import Context
from gui.models.page import PageSpec
from gui.models.project import ProjectState
from gui.pages.camera.model import apply_change, read_camera
from gui.pages.camera.panel import CameraPanel, PresetBox
from gui.saving import ask_target, write_file
from lfcal.camera import Camera, preset

__all__ = ["Page"]


class Page(BasePage):
    """Every change that passes is an undoable change of the project."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.presets = PresetBox()
        self.presets.chosen.connect(lambda name: self._set(preset(name), f"preset {name}"))
        self.tools.addWidget(self.presets)
        self.tool_button("Import …", "Raytrix calibration (.xml) or a saved camera (.json)", self.import_file)
        self.tool_button("Save …", "Write this camera as JSON", self.save_file)
        self.panel = CameraPanel(lambda key, value: apply_change(self.context.state.camera, key, value)[1])
        self.panel.edited.connect(self._edited)
        self.set_panel(self.panel)
        context.theme_changed.connect(self.panel.apply_theme)
        self.panel.show_camera(context.state.camera)

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Show the camera if it changed."""
        if old.camera != new.camera:
            self.panel.show_camera(new.camera)

    def _edited(self, key: str, value: Any) -> None:
        camera, _ = apply_change(self.context.state.camera, key, value)
        if camera is not None:
            self._set(camera, f"change of {key.split('.')[1].replace('_', ' ')}")

    def _set(self, camera: Camera, label: str) -> None:
        # a plan holds the camera it was made for: planes, cutout and anchor follow from its geometry
        self.context.project.update(label, camera=camera, plan=None)

    def import_file(self, path: str = "") -> None:
        """Take a camera from a Raytrix XML or JSON file."""
        path = path or QFileDialog.getOpenFileName(self, "Import camera", "", "Cameras (*.xml *.json)")[0]
        if not path:
            return

        def read(camera: Camera) -> None:
            self._set(camera, f"import of {Path(path).name}")
            self.context.message.emit(f"camera taken from {path}")

        self.load(Path(path).name, lambda: read_camera(Path(path)), read)

    def save_file(self, path: str = "") -> None:
        """Write the camera as JSON."""
        name = f"{self.context.state.camera.name}.json"
        path = path or ask_target(self, "Save camera", name, "Camera (*.json)")
        text = self.context.state.camera.to_json()
        if path and write_file(self, path, lambda part: part.write_text(text, encoding="utf-8")):
            self.context.message.emit(f"camera saved as {path}")

    def accept_drop(self, paths: list[str]) -> bool:
        """Take a dropped calibration."""
        if len(paths) == 1 and paths[0].lower().endswith(".xml"):
            self.import_file(paths[0])
            return True
        return False
