"""Camera: the description of optics, lenslets and sensor, where its values come from, and whether it is right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QFileDialog

from lfcal.camera import CAMERA_FORMATS, Camera, Imported, doubts, import_camera, preset
from lfcal.frames.formats import image_suffixes
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.jobs import WindowJob
from lfcal_gui.models import PageSpec, ProjectState
from lfcal_gui.pages.camera import takes
from lfcal_gui.pages.camera._panel_sensor import SensorDialog
from lfcal_gui.pages.camera.model import apply_change
from lfcal_gui.pages.camera.model_check import Checked, iter_check
from lfcal_gui.pages.camera.model_marks import confirmed, state_with
from lfcal_gui.pages.camera.panel import CameraPanel, PresetBox
from lfcal_gui.pages.camera.step import step
from lfcal_gui.saving import ask_target, write_file

__all__ = ["Page"]

SUFFIXES = sorted({suffix for form in CAMERA_FORMATS for suffix in form.suffixes})
FILES = f"Cameras ({' '.join('*' + suffix for suffix in SUFFIXES)});;All files (*)"
IMAGES = f"Images ({' '.join('*' + suffix for suffix in sorted(image_suffixes()))});;All files (*)"


class Page(BasePage):
    """Every change that passes is an undoable change of the project."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.presets = PresetBox()
        self.presets.chosen.connect(lambda name: self._set(preset(name), f"preset {name}"))
        self.tools.addWidget(self.presets)
        formats = ", ".join(form.name for form in CAMERA_FORMATS)
        self.tool_button("Import …", f"A file that describes a camera: {formats}", self.import_file)
        self.tool_button(
            "Check …", "Hold this camera against a white image, before a session is recorded with it", self.choose_white
        )
        self.tool_button("Sensor …", "Measure gain, noise and saturation from flats and darks", self.measure_sensor)
        self.tool_button(
            "Save …", "Keep this camera as JSON, for other projects and the commands (--camera)", self.save_file
        )
        self.panel = CameraPanel(self._check)
        self.panel.edited.connect(self._edited)
        self.panel.assumed.confirmed.connect(self._confirmed)
        self.panel.check.asked.connect(self.choose_white)
        self.panel.check.dark_asked.connect(self.choose_dark)
        self.panel.check.taken.connect(self._take_measured)
        self.set_panel(self.panel)
        self.theme_changed.connect(self.panel.apply_theme)
        self.panel.show_camera(context.state.camera)
        self._white, self._dark, self._job = "", "", 0
        self._checked: Checked | None = None
        self.dialog: SensorDialog | None = None

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Show the camera if it changed; a comparison with another camera is of no use."""
        if old.camera != new.camera or old.camera.marks != new.camera.marks:
            self.panel.show_camera(new.camera)
        if old.camera != new.camera and self._checked is not None and new.camera != self._checked.check.camera:
            self._checked = None
            self.panel.check.show_nothing("The camera changed since it was held against a white image.")

    def _edited(self, key: str, value: Any) -> None:
        camera, _ = apply_change(self.context.state.camera, key, value)
        if camera is None:
            return
        label, project = f"change of {key.split('.')[1].replace('_', ' ')}", self.context.project
        # of the plan before the field was touched: half a number must not have changed it
        before = project.before(label)
        changes = state_with(before, camera, same=True)
        project.merge(label, **changes)
        lost = before.plan is not None and changes["plan"] is None
        if lost and self.context.state.camera == camera:
            self.refuse("This camera cannot scan the planes of the plan, which was let go; undo brings it back")
        else:
            self.notice.clear()

    def _check(self, key: str, value: Any) -> str:
        camera, why = apply_change(self.context.state.camera, key, value)
        held = "" if camera is None else self.context.project.held(replace(self.context.state, camera=camera))
        return why or held

    def _set(self, camera: Camera, label: str) -> bool:
        """Take a camera; return False where that was refused."""
        before = self.context.state.plan
        if not self.context.project.update(label, **state_with(self.context.state, camera)):
            return False
        if before is not None and self.context.state.plan is None:
            words = "The plan was of the other camera and is gone with it. Undo brings both back."
            self.context.message.emit(words)
            self.notice.offer(words, "Undo", lambda: self._take_back(label), stay="Leave it so")
        return True

    def _take_back(self, label: str) -> None:
        """Bring back what was there before another camera was taken, unless something else was done since."""
        if self.context.project.undo_label == label:
            self.context.project.undo()
        else:
            self.refuse("Something else was changed since: undo step by step (Ctrl+Z)")

    def _confirmed(self, paths: tuple[str, ...]) -> None:
        label = f"confirm {paths[0]}" if len(paths) == 1 else f"confirm {len(paths)} values"
        self._set(confirmed(self.context.state.camera, paths), label)

    def measure_sensor(self) -> None:
        """Open the measurement of the sensor from flats and darks; one that is open comes to the front."""
        if self.dialog is None:
            self.dialog = SensorDialog(self, self.context, self._set)
            self.dialog.finished.connect(self._dialog_closed)
        self.dialog.show()
        self.dialog.raise_()

    def _dialog_closed(self) -> None:
        self.dialog = None

    # -- files -----------------------------------------------------------------------------------------
    def import_file(self, path: str = "") -> None:
        """Take a camera from a file of any known format."""
        path = path or QFileDialog.getOpenFileName(self, "Import camera", "", FILES)[0]
        if not path:
            return

        def read(found: Imported) -> None:
            if self._set(found.camera, f"import of {Path(path).name}"):
                self.context.message.emit(f"camera taken from {path}")
                self._tell(found)

        self.load(Path(path).name, lambda: _checked(import_camera(path)), read)

    def _tell(self, found: Imported) -> None:
        """Say what the file leaves open, and lead to where it is stated."""
        count = len(found.camera.marks.paths("assumed"))
        if count:
            self.panel.tabs.setCurrentWidget(self.panel.assumed)
        words = [*found.notes, *doubts(found.camera)]
        for line in words:
            self.context.message.emit(line)
        if words:
            self.notice.tell("; ".join(words))

    def save_file(self, path: str = "") -> None:
        """Write the camera as JSON."""
        name = f"{self.context.state.camera.name}.json"
        path = path or ask_target(self, "Save camera", name, "Camera (*.json)")
        text = self.context.state.camera.to_json()
        if path and write_file(self, path, lambda part: part.write_text(text, encoding="utf-8")):
            title = f"Save camera {Path(path).name}"
            self.context.history.add(self.context.taken("camera", title, step=lambda: step(self.context.state, path)))
            self.context.message.emit(f"camera saved as {path}")

    def accept_drop(self, paths: list[str]) -> bool:
        """Take a dropped description; JSON and text files only where this page is looked at."""
        if len(paths) != 1:
            return False
        if takes(paths[0]) or (Path(paths[0]).suffix.lower() in SUFFIXES and self.isVisible()):
            self.import_file(paths[0])
            return True
        return False

    # -- white image -----------------------------------------------------------------------------------
    def choose_white(self) -> None:
        """Ask for a white image and hold the camera against it."""
        path = QFileDialog.getOpenFileName(self, "White image", self._white, IMAGES)[0]
        if path:
            self.check_white(path)

    def choose_dark(self) -> None:
        """Ask for a dark frame, which is subtracted from then on."""
        path = QFileDialog.getOpenFileName(self, "Dark frame", self._dark, IMAGES)[0]
        if path:
            self._dark = path
            self.context.message.emit(f"dark frame for white images: {path}")
            if self._white:
                self.check_white(self._white)

    def check_white(self, path: str) -> None:
        """Hold the camera against the white image at ``path``, as a job."""
        self._white = path
        self.notice.clear()
        self.panel.show_check()
        self.panel.check.show_waiting(Path(path).name)
        self.context.jobs.cancel(self._job)
        camera, dark = self.context.state.camera, Path(self._dark) if self._dark else None
        self._job = self.context.jobs.start(
            f"Check against {Path(path).name}",
            "camera",
            lambda: iter_check(camera, Path(path), dark),
            self._show_check,
            self._check_failed,
            abandon=True,
            at_once=True,
        )

    def _show_check(self, found: Checked) -> None:
        if found.camera == self.context.state.camera:
            self._checked = found
            self.panel.check.show_check(found)
        else:
            self.panel.check.show_nothing("The camera changed meanwhile; check it again.")

    def _check_failed(self, job: WindowJob) -> None:
        self._checked = None
        self.panel.check.show_nothing()
        if job.error:
            self.refuse(job.error)

    def _take_measured(self) -> None:
        if self._checked is not None and self._checked.check.camera is not None:
            if self._set(self._checked.check.camera, f"lattice measured in {self._checked.name}"):
                self.panel.check.show_taken()


def _checked(found: Imported) -> Imported:
    """Return ``found``; raise where its values are no camera's."""
    doubts(found.camera)
    return found
