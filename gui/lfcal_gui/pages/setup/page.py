"""Set up: the camera with the sources of its values and a check against a white image; the scan and its cost."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtWidgets import QFileDialog

from lfcal.base import LfcalError, Work
from lfcal.camera import CAMERA_FORMATS, PRESETS, Camera, Imported, ScanPlan, doubts, import_camera, preset
from lfcal_gui.base_page import BasePage, Deed
from lfcal_gui.context import Context
from lfcal_gui.jobs import WindowJob
from lfcal_gui.models import PageSpec, ProjectState, described, is_image, with_checked, with_described
from lfcal_gui.pages.setup import takes
from lfcal_gui.pages.setup._inspector import BUTTONS, PRESET
from lfcal_gui.pages.setup.model import (
    all_assumed,
    apply_change,
    confirmed,
    name_at,
    state_with,
    weighed,
    weighed_key,
)
from lfcal_gui.pages.setup.model_picture import expected_light, light_key
from lfcal_gui.pages.setup.model_scan import (
    SAVED,
    default_plan,
    half_of,
    iter_saved,
    moved,
    plan_files,
)
from lfcal_gui.pages.setup.model_scan import apply_change as change_plan
from lfcal_gui.pages.setup.model_target import OF_SCAN, PlannedTarget, PlanSettings, read_plan, refused_setting
from lfcal_gui.pages.setup.panel import VIEWS, PlanningPanel
from lfcal_gui.pages.setup.step import camera_step, scan_step
from lfcal_gui.saving import ask_target, write_file
from lfcal_gui.widgets import expected_apertures

if TYPE_CHECKING:
    from lfcal.simulate import AssumedEffect, ExpectedLight, ScanChoice
    from lfcal_gui.pages.setup._check_dialog import CheckDialog
    from lfcal_gui.pages.setup._sensor_dialog import SensorDialog
    from lfcal_gui.pages.setup._target_dialog import TargetDialog
    from lfcal_gui.pages.setup.model_check import Checked

LOST = "This camera cannot scan the planes of the plan, so the plan was removed. Undo restores it"
LEAVES = "the cutout leaves the sensor"
ASKS = "Which camera is it?\nA file or a preset gives most values of a camera. You can also drop a camera or plan here."
BY_HAND = "Begin with typical values, each marked as assumed, and type the values of your camera"
SAMPLE = "A small recorded session with its camera: frames, dark and white frames, assembled into H"
MATTERS = 0.01
"""Relative change of time, cutout or H above which the user is asked for an assumed value."""


@cache
def _suffixes() -> tuple[str, ...]:
    """Return the suffixes of files of cameras."""
    return tuple(sorted({suffix for form in CAMERA_FORMATS for suffix in form.suffixes}))


@cache
def _image_names() -> str:
    """Return the names of images, for a file dialog."""
    from lfcal.frames.formats import image_suffixes

    return _named("Images", sorted(image_suffixes()))


def _named(kind: str, suffixes: Iterable[str]) -> str:
    """Return the name filter of a file dialog."""
    return f"{kind} ({' '.join('*' + suffix for suffix in suffixes)});;All files (*)"


class Page(BasePage):
    """Page with camera and scan; every valid change is an undo step of the project."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self._white, self._dark, self._job = "", "", 0
        self._light: tuple[Any, ExpectedLight | str] | None = None
        self._light_asked: Any = None
        """Key of the light that is being computed."""
        self._expected_of: tuple[Any, ...] = ()
        """Camera, depths and cutout whose apertures are shown."""
        self._weighed: tuple[Any, tuple[AssumedEffect, ...]] | None = None
        self._off: ScanPlan | str = ""
        self._checked: Checked | None = None
        self.dialog: SensorDialog | None = None
        self._target: TargetDialog | None = None
        self.panel = PlanningPanel(self._check, self._check_scan, context.jobs.later)
        self._check_dialog: CheckDialog | None = None
        for button in self.panel.segments:
            self.segments.addWidget(button)
        self.tools.addWidget(self.panel.overlay)
        self.panel.views.currentChanged.connect(lambda k: self.hint.setText(VIEWS[k][1] if k else spec.hint))
        inspector = self.panel.inspector
        inspector.preset_chosen.connect(self._take_preset)
        inspector.edited.connect(self._edited)
        inspector.scan_edited.connect(self._scan_edited)
        inspector.confirmed.connect(self._confirmed)
        inspector.asked.connect(self._do)
        self.panel.dragged.connect(self.move_scan)
        self.panel.numbers.chosen.connect(self._choose)
        self.set_panel(self.panel)
        self.theme_changed.connect(self._take_theme)
        self._show(context.state)

    def _do(self, name: str) -> None:
        deeds: dict[str, Callable[[], object]] = {
            "import": self.import_file,
            "white": self.choose_white,
            "confirm": lambda: self._confirmed(self.panel.inspector.assumed),
            "sensor": self.measure_sensor,
            "dark": self.choose_dark,
            "save": self.save_file,
            "make": self.make_default,
            "default": self.make_default,
            "open": self.open_plan,
            "again": self.open_plan,
            "save_plan": self.save_plan,
            "target": lambda: self.target.show(),
            "take": self._take_measured,
            "details": lambda: self.check.show(),
        }
        deeds[name]()

    def deeds(self) -> dict[str, Callable[[], object]]:
        """Return the actions that the next step may request, by name."""
        return {
            "import": self.import_file,
            "assumed": self.panel.inspector.values.open,
            "white": self.choose_white,
            "make": self.make_default,
            "show": lambda: self.panel.inspector.scan.editor("cutout").setFocus(),
            "move": self.move_onto_sensor,
        }

    @staticmethod
    def prepare() -> None:
        """Import the dialogs, and find the supported file formats."""
        import lfcal_gui.pages.setup._check_dialog
        import lfcal_gui.pages.setup._sensor_dialog
        import lfcal_gui.pages.setup._target_dialog  # noqa: F401

        _suffixes()
        _image_names()

    @property
    def check(self) -> CheckDialog:
        """Dialog of the comparison with a white image, which is created on demand."""
        if self._check_dialog is None:
            from lfcal_gui.pages.setup._check_dialog import CheckDialog

            self._check_dialog = CheckDialog(self)
        return self._check_dialog

    @property
    def target(self) -> TargetDialog:
        """Dialog of the target, which is created on demand."""
        if self._target is None:
            from lfcal_gui.pages.setup._target_dialog import TargetDialog

            self._target = TargetDialog(self, self.context)
        return self._target

    def receive(self, payload: Any) -> None:
        """Do what another page requests, such as asking for a white image."""
        self.do(payload)

    def _take_theme(self) -> None:
        self.panel.apply_theme()
        for dialog in (self._check_dialog, self._target):
            if dialog is not None:
                dialog.apply_theme()

    def entered(self) -> None:
        """Show the scan when the page has its size."""
        self.panel.look()
        self.panel.draw_now()
        self._expect(self.context.state.plan)
        self._forecast_noise()

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Show camera and plan if they changed; discard a comparison with another camera."""
        other = old.camera != new.camera
        if other and self._checked is not None and new.camera != self._checked.check.camera:
            self._forget_check("The camera changed since it was compared with a white image.")
        if (
            other
            or old.camera.marks != new.camera.marks
            or described(old) != described(new)
            or old.plan != new.plan
            or PlanSettings.of(old) != PlanSettings.of(new)
        ):
            self._show(new)

    def let_go(self) -> None:
        """Stop planning a target for the previous project."""
        if self._target is not None:
            self._target.forget()

    def _ask_camera(self) -> None:
        """Ask which camera is used, instead of showing the values of a preset."""
        presets = {name: partial(self._take_preset, name) for name in PRESETS}
        choices: dict[str, Deed] = {
            "Import a camera file …": (BUTTONS["import"][1], self.import_file),
            "Choose a preset": (PRESET, presets),
            "Describe the camera": (BY_HAND, self._describe),
            "Open a plan …": (BUTTONS["open"][1], self.open_plan),
            "Open the sample": (SAMPLE, self.context.sample_asked.emit),
        }
        self.show_empty(ASKS, choices)

    def _show(self, state: ProjectState) -> None:
        asks = not described(state)
        if asks and self.empty is None:
            self._ask_camera()
        elif not asks:
            self.show_body()
        for part in (*self.panel.segments, self.panel.overlay):
            part.setHidden(asks)
        self._off = ""
        self.hint.setText("" if state.plan is None else self.spec.hint)
        self.panel.show_state(state, self._checked, self._light_of(state.plan))
        if self._target is not None:
            self._target.show_state(state)
        self._expect(state.plan)
        self._forecast_noise()
        self._weigh()
        self._report()

    # -- noise and assumed values ----------------------------------------------------------------------
    def _expect(self, plan: ScanPlan | None) -> None:
        """Compute the expected apertures of the planes in the background."""
        if plan is None or not self.isVisible():
            return
        if self._expected_of != (asked := (plan.camera, plan.depths_um, plan.cutout)):
            self._expected_of = asked
            self.context.jobs.compute(
                "apertures of the scan", lambda: expected_apertures(plan), self.panel.show_expected
            )

    def _light_of(self, plan: ScanPlan | None) -> ExpectedLight | str | None:
        """Return the light of a plan's patterns, or why it is unknown; None if it was not computed yet."""
        known = plan is not None and self._light is not None and self._light[0] == light_key(plan)
        return self._light[1] if known and self._light is not None else None

    def _forecast_noise(self) -> None:
        """Compute in the background the light of the plan's patterns, on which the noise of H depends."""
        plan, costs = self.context.state.plan, self.panel.costs
        if plan is None or costs is None or costs.unknown or self._light_of(plan) is not None or not self.isVisible():
            return
        if self._light_asked == (key := light_key(plan)):
            return
        self._light_asked = key

        def done(light: ExpectedLight | str) -> None:
            self._light, self._light_asked = (key, light), None
            if self._light_of(self.context.state.plan) is not None:
                self.panel.show_state(self.context.state, self._checked, light)

        def failed(message: str) -> None:
            self.context.jobs.trouble.emit(f"the noise of H could not be computed: {message}")
            done("computation failed")

        self.context.jobs.compute("light of the scan", lambda: expected_light(plan), done, failed)

    def _choose(self, choice: ScanChoice) -> None:
        state = self.context.state
        settings = replace(PlanSettings.of(state), peak=choice.peak).into(state)
        self.context.project.merge("time versus accuracy", plan=choice.plan, settings=settings)

    def _weigh(self) -> None:
        state = self.context.state
        key = weighed_key(state)
        if key is None or (self._weighed is not None and self._weighed[0] == key):
            return

        def done(found: tuple[AssumedEffect, ...]) -> None:
            self._weighed = key, found
            self._report()

        self.context.jobs.compute("assumed values", lambda: weighed(state), done, lambda _: None)

    def _report(self) -> None:
        """Report whether the plan is feasible, and the assumed values with large effects."""
        state, facts = self.context.state, dict[str, Any]()
        effects: tuple[AssumedEffect, ...] = ()
        if self._weighed is not None and self._weighed[0] == weighed_key(state):
            effects = self._weighed[1]
            facts["assumed"] = tuple(name_at(one.path) for one in effects if one.largest > MATTERS)
        if self._off:
            facts["movable"] = isinstance(self._off, ScanPlan)
            facts["wrong"] = LEAVES if facts["movable"] else self._off
        self.panel.inspector.show_effects(effects)
        self.context.report("setup", **facts)

    def _edited(self, key: str, value: Any) -> None:
        camera, _ = apply_change(self.context.state.camera, key, value)
        if camera is None:
            return
        label, project = f"change of {key.split('.')[1].replace('_', ' ')}", self.context.project
        # start from the plan before this edit, so that half-typed numbers have no effect on it
        before = project.before(label)
        changes = state_with(before, camera, same=True)
        project.merge(label, **changes)
        lost = before.plan is not None and changes["plan"] is None
        if lost and self.context.state.camera == camera:
            self.refuse(LOST)
        else:
            self.notice.clear()

    def _check(self, key: str, value: Any) -> str:
        camera, why = apply_change(self.context.state.camera, key, value)
        held = "" if camera is None else self.context.project.held(replace(self.context.state, camera=camera))
        return why or held

    def _set(self, camera: Camera, label: str) -> bool:
        before, state = self.context.state.plan, self.context.state
        if not self.context.project.update(label, **state_with(state, camera), settings=with_described(state)):
            return False
        if before is not None and self.context.state.plan is None:
            words = "The plan belonged to the previous camera and was removed. Undo restores both."
            self.context.message.emit(words)
            tip = "Restore the previous camera and its plan"
            self.notice.offer(words, "Undo", lambda: self._take_back(label), stay="Leave it", tip=tip)
        return True

    def _take_preset(self, name: str) -> None:
        self._set(preset(name), f"preset {name}")

    def _describe(self) -> None:
        self._set(all_assumed(self.context.state.camera), "description of the camera")

    def _take_back(self, label: str) -> None:
        """Restore the previous camera, unless something else was changed since."""
        if self.context.project.undo_label == label:
            self.context.project.undo()
        else:
            self.refuse("Something else was changed since then; undo step by step (Ctrl+Z)")

    def _confirmed(self, paths: tuple[str, ...]) -> None:
        label = f"confirm {paths[0]}" if len(paths) == 1 else f"confirm {len(paths)} values"
        self._set(confirmed(self.context.state.camera, paths), label)

    def measure_sensor(self) -> None:
        """Open the dialog that measures the sensor, or bring it to the front."""
        if self.dialog is None:
            from lfcal_gui.pages.setup._sensor_dialog import SensorDialog

            self.dialog = SensorDialog(self, self.context, self._set)
            self.dialog.finished.connect(self._dialog_closed)
        self.dialog.show()
        self.dialog.raise_()

    def _dialog_closed(self) -> None:
        self.dialog = None

    # -- files -----------------------------------------------------------------------------------------
    def import_file(self, path: str = "") -> None:
        """Import a camera from a file of any supported format."""
        path = path or QFileDialog.getOpenFileName(self, "Import camera", "", _named("Cameras", _suffixes()))[0]
        if not path:
            return

        def read(found: Imported) -> None:
            if self._set(found.camera, f"import of {Path(path).name}"):
                self.context.message.emit(f"camera imported from {path}")
                self._note_imported(found)

        self.load(Path(path).name, lambda: _checked(import_camera(path)), read)

    def _note_imported(self, found: Imported) -> None:
        """Report notes and doubts on an imported camera; unfold all values if some are assumed."""
        count = len(found.camera.marks.paths("assumed"))
        if count:
            self.panel.inspector.values.open()
        words = [*found.notes, *doubts(found.camera)]
        for line in words:
            self.context.message.emit(line)
        if words:
            self.notice.show_note("; ".join(words))

    def save_file(self, path: str = "") -> None:
        """Save the camera as JSON."""
        name = f"{self.context.state.camera.name}.json"
        path = path or ask_target(self, "Save camera", name, "Camera (*.json)")
        text = self.context.state.camera.to_json()
        if path and write_file(self, path, lambda part: part.write_text(text, encoding="utf-8")):
            title = f"Save camera {Path(path).name}"
            self.context.history.add(
                self.context.taken("setup", title, step=lambda: camera_step(self.context.state, path))
            )
            self.context.message.emit(f"camera saved as {path}")

    def accept_drop(self, paths: list[str]) -> bool:
        """Accept a dropped plan or camera; a white image, JSON and text files only if this page is visible."""
        if len(paths) == 1 and self.isVisible() and _is_white(paths[0]):
            if self.empty is None:
                self.check_white(paths[0])
            else:
                self.refuse("Choose the camera, then drop the white image again.")
            return True
        if len(paths) != 1 or not (takes(paths[0]) or Path(paths[0]).suffix.lower() in _suffixes()):
            return False
        if _is_plan(paths[0]):
            self.open_plan(paths[0])
        elif Path(paths[0]).suffix.lower() in (".xml", ".yaml", ".yml", ".cfg") or self.isVisible():
            self.import_file(paths[0])
        else:
            return False
        return True

    # -- white image -----------------------------------------------------------------------------------
    def choose_white(self) -> None:
        """Ask for a white image and compare the camera with it."""
        path = QFileDialog.getOpenFileName(self, "White image", self._white, _image_names())[0]
        if path:
            self.check_white(path)

    def choose_dark(self) -> None:
        """Ask for a dark frame to subtract from white images, and check the current white image again."""
        path = QFileDialog.getOpenFileName(self, "Dark frame", self._dark, _image_names())[0]
        if path:
            self._dark = path
            self.context.message.emit(f"dark frame for white images: {path}")
            if self._white:
                self.check_white(self._white)

    def check_white(self, path: str) -> None:
        """Compare the camera with the white image at ``path``, as a job."""
        self._white = path
        self.notice.clear()
        self.panel.inspector.show_verdict("", f"Fitting the lattice of {Path(path).name} …")
        self.context.jobs.cancel(self._job)
        camera, dark = self.context.state.camera, Path(self._dark) if self._dark else None
        self._job = self.context.jobs.start(
            f"Compare with {Path(path).name}",
            "setup",
            lambda: _iter_checked(camera, Path(path), dark),
            self._show_check,
            self._check_failed,
            abandon=True,
            at_once=True,
        )

    def _show_check(self, found: Checked) -> None:
        if found.camera != self.context.state.camera:
            self._forget_check("The camera changed in the meantime; compare it again.")
            return
        self._checked = found
        self.check.show_check(found)
        measured = found.check.camera is not None
        self.panel.inspector.show_verdict(found.role, found.words, found=True, measured=measured)
        self._show(self.context.state)
        if found.role == "good":
            self.context.project.note(settings=with_checked(self.context.state))

    def _forget_check(self, words: str = "") -> None:
        self._checked = None
        if self._check_dialog is not None:
            self._check_dialog.hide()
        self.panel.inspector.show_verdict("", words)

    def _check_failed(self, job: WindowJob) -> None:
        self._forget_check()
        self._show(self.context.state)
        if job.error:
            self.refuse(job.error)

    def _take_measured(self) -> None:
        if self._checked is not None and self._checked.check.camera is not None:
            if self._set(self._checked.check.camera, f"lattice measured in {self._checked.name}"):
                words = "The camera now has the measured lattice; save the camera to use it elsewhere."
                self.panel.inspector.show_verdict("good", words, found=True)

    # -- scan ------------------------------------------------------------------------------------------
    def _check_scan(self, key: str, value: Any) -> str:
        state = self.context.state
        if state.plan is None:
            return ""
        if key in OF_SCAN:
            return refused_setting(self.context.project, key, value) or (
                _refused_half(state.plan) if key == "half_cell" and value else ""
            )
        plan, why = change_plan(state.plan, key, value)
        self._off = moved(state.plan, key, value) if why else ""
        self._report()
        if plan is not None and PlanSettings.of(state).half_cell and not _refused_half(state.plan):
            why = _refused_half(plan)
        return why or self.context.project.held(replace(state, plan=plan))

    def _scan_edited(self, key: str, value: Any) -> None:
        if key in OF_SCAN:
            self.context.edit(PlanSettings.of(self.context.state), key, value)
            return
        plan = self.context.state.plan
        changed = None if plan is None else change_plan(plan, key, value)[0]
        if changed is not None:
            self.context.project.merge(f"change of {key.replace('_', ' ')}", plan=changed)
            if changed == plan:  # the value that was typed is the current one, for example by default
                self._show(self.context.state)

    def move_scan(self, rows: int, columns: int) -> None:
        """Move the scan by a number of pixels, limited to the sensor."""
        plan = self.context.state.plan
        if plan is None:
            return
        try:
            moved = replace(plan, anchor=(plan.anchor[0] + rows, plan.anchor[1] + columns))
        except LfcalError:
            return
        if not (PlanSettings.of(self.context.state).half_cell and _refused_half(moved)):
            self.context.project.merge("move of the scan", plan=moved)

    def move_onto_sensor(self) -> None:
        """Move the scan such that all cutouts of the typed size are on the sensor."""
        if isinstance(self._off, ScanPlan):
            self.context.project.update("move of the scan onto the sensor", plan=self._off)

    def make_default(self) -> None:
        """Make the plan that the camera's geometry suggests."""
        try:
            self.context.project.update("default plan", plan=default_plan(self.context.state.camera))
        except LfcalError as error:
            self.refuse(str(error))

    def open_plan(self, path: str = "") -> None:
        """Open a plan with its camera from a file."""
        path = path or QFileDialog.getOpenFileName(self, "Open plan", "", "Plans (*.json)")[0]
        if not path:
            return
        name = Path(path).name

        def refused(words: str) -> None:
            self.refuse(words if name in words else f"{name}: {words}")

        settings = PlanSettings.of(self.context.state)
        self.load(name, lambda: read_plan(path, settings), lambda found: self._opened(name, found), on_error=refused)

    def _opened(self, name: str, found: ScanPlan | PlannedTarget) -> None:
        if isinstance(found, ScanPlan):
            self.context.project.update(f"plan {name}", plan=found, camera=found.camera)
            return
        state, scan = self.context.state, found.plan.scan
        settings = PlanSettings.of_plan(found.plan).at_rates_of(PlanSettings.of(state))
        self.target.expect(scan, settings)
        self.context.project.update(f"target plan {name}", plan=scan, camera=scan.camera, settings=settings.into(state))
        self.target.show_opened(found)

    def save_plan(self, path: str = "") -> None:
        """Save the plan, or its stage positions for another program, in the format of the suffix."""
        state, plan = self.context.state, self.context.state.plan
        if plan is None:
            self.refuse("there is no plan to save; make or open one first")
            return
        try:
            half = half_of(plan) if PlanSettings.of(state).half_cell else None
        except LfcalError as error:
            self.refuse(str(error))
            return
        path = path or ask_target(self, "Save plan", "plan", SAVED, lambda to: list(plan_files(plan, half, to)))
        if path:
            jobs, files, title = self.context.jobs, plan_files(plan, half, path), f"Save plan {Path(path).name}"
            taken = self.context.taken("setup", title, path, lambda: scan_step(state, path))
            # as a job: the positions of a large scan take a while to write
            jobs.start(
                title,
                "setup",
                lambda: iter_saved(files),
                self.context.message.emit,
                lambda job: self.refuse(job.error),
                at_once=True,
                taken=taken,
            )


def _iter_checked(camera: Camera, white: Path, dark: Path | None) -> Work[Checked]:
    """Compare a camera with a white image; modules are imported in the job's thread."""
    from lfcal_gui.pages.setup.model_check import iter_check

    return (yield from iter_check(camera, white, dark))


def _checked(found: Imported) -> Imported:
    """Return ``found``; raise an error if its values are not valid for a camera."""
    doubts(found.camera)
    return found


def _refused_half(plan: ScanPlan) -> str:
    """Return why a half-cell scan is not possible; empty if it is."""
    try:
        half_of(plan)
    except LfcalError as error:
        return str(error)
    return ""


def _is_white(path: str) -> bool:
    """Return whether a file may be a white image; arrays are more often an H, and folders frames."""
    return is_image(path) and Path(path).is_file() and Path(path).suffix.lower() != ".npy"


def _is_plan(path: str) -> bool:
    """Return whether a JSON file contains the plan of a scan or of a target."""
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return ScanPlan.is_one(data) or (isinstance(data, dict) and data.get("format") == "lfcal-target-plan")
