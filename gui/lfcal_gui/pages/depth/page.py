"""Use > Depth: measure the depth map of a light-field frame as a job, show it, and save it as a map or points."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from PySide6.QtWidgets import QFileDialog

from lfcal.base import InputError, format_seconds, worker_count
from lfcal.camera import Camera
from lfcal.tasks import Depth, DepthForecast, MeasuredDepth
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.jobs import WAITS, WindowJob
from lfcal_gui.models import PageSpec, ProjectState, Shot, Taken, described, is_image, said_in_window, shown_of
from lfcal_gui.pages.depth import model
from lfcal_gui.pages.depth.model import DepthSettings, Looked, Shade
from lfcal_gui.pages.depth.panel import DepthPanel
from lfcal_gui.pages.depth.step import step
from lfcal_gui.saving import ask_target

IMAGES = "Light fields (*.tif *.tiff *.png *.pgm *.npy *.raw *.nef *.cr2 *.dng);;All files (*)"
EMPTY = (
    "No frame open\n"
    "Open a light-field frame to measure the depth of everything with texture in it.\n"
    "Or drop a .tif, .png or .raw file here."
)
OPEN = "Choose a frame recorded with the camera"
KINDS = {
    "map": ("Save depth map", "depth.tif", "Depth map (*.tif)"),
    "points": ("Save points", "points.ply", "PLY (*.ply)"),
}


class Page(BasePage):
    """Page that measures the depth in the project's light field."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.panel = DepthPanel(context.jobs)
        self.image: NDArray[Any] | None = None
        self.made: MeasuredDepth | None = None
        self._shades: dict[str, Shade] = {}
        self._of = context.state
        """State of the project to which the map belongs."""
        self._opened = self._problem = ""
        self._ready: tuple[str, NDArray[Any]] | None = None  # read before the project changes
        self._job = self._turn = 0
        self._seconds: float | None = None
        for segment in self.panel.segments.values():
            self.segments.addWidget(segment)
        self.set_panel(self.panel)
        context.let_edit(self.panel.form, lambda: self.settings)
        self.panel.pressed.connect(self._pressed)
        self.panel.chosen.connect(self._show_picture)
        self.panel.view.hovered.connect(self._hovered)
        self.shortcut("F5", self.start)
        self.shortcut("Escape", self.stop)
        self.shortcut("V", lambda: self.panel.show_map(self.made is not None and not self.panel.shows_map))
        context.jobs.changed.connect(self._job_changed)
        context.jobs.finished.connect(self._job_finished)
        self.theme_changed.connect(self.panel.apply_theme)
        self._show()
        self._load()

    # -- project ---------------------------------------------------------------------------------------
    @property
    def settings(self) -> DepthSettings:
        """The user's settings."""
        return DepthSettings.of(self.context.state)

    def let_go(self) -> None:
        """Discard the map of the previous project, and stop measuring."""
        number, self._job = self._job, 0
        self.context.jobs.cancel(number)
        self._show_map(None)

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Update the page if frame, camera, H or settings changed."""
        if old.light_field != new.light_field:
            self._show_map(None)
            self._show()
            self._load()
        elif (DepthSettings.of(old), old.camera, described(old), old.psf) != (
            DepthSettings.of(new),
            new.camera,
            described(new),
            new.psf,
        ):
            self._show()
            self._forecast()

    def _show(self) -> None:
        state, settings, form = self.context.state, self.settings, self.panel.form
        if not state.light_field:
            self.show_empty(EMPTY, {"Open frame …": (OPEN, self.choose_frame)})
            return
        self.show_body()
        self.panel.show_settings(settings, shown_of(Depth, {**settings.option_values, "frame": "", "out": ""}))
        form.set_enabled("use_camera", described(state), "" if described(state) else model.NO_CAMERA)
        form.set_enabled("use_h", bool(state.psf), "" if state.psf else model.NO_H)
        self._show_controls()

    def _show_controls(self) -> None:
        running, panel = bool(self._job), self.panel
        panel.show_go(running=running, enabled=self.image is not None and not self._problem)
        panel.form.setEnabled(not running)
        panel.open.setEnabled(not running)
        self.context.report(self.spec.key, depth_s=self._seconds)

    # -- frame -----------------------------------------------------------------------------------------
    def choose_frame(self) -> None:
        """Ask for a frame, and open it."""
        path = QFileDialog.getOpenFileName(self, "Open frame", "", IMAGES)[0]
        if path:
            self.open_frame(path)

    def open_frame(self, path: str) -> None:
        """Make an image the light field of the project after checking that it can be read."""

        def read(image: NDArray[Any]) -> None:
            self._ready = (path, image)
            self.context.project.update("open light field", light_field=path)
            if self._ready is not None:  # same path as before: the project did not change
                self._load()

        self.load(Path(path).name, lambda: model.frame_picture(path), read)

    def accept_drop(self, paths: list[str]) -> bool:
        """Accept a dropped image."""
        if len(paths) == 1 and is_image(paths[0]):
            self.open_frame(paths[0])
            return True
        return False

    def _load(self) -> None:
        path = self.context.state.light_field
        self.image, self._problem = None, ""
        self.panel.view.set_shot(None)
        self.panel.file.setText(Path(path).name)
        self._show_controls()
        ready, self._ready = self._ready, None
        self.context.jobs.drop("depth load")
        if ready is not None and ready[0] == path:
            self._loaded(*ready)
        elif path:
            self.panel.view.blank.wait(f"Opening {Path(path).name} …")
            self.context.jobs.load(
                "depth load",
                lambda: model.frame_picture(path),
                lambda image: self._loaded(path, image),
                self._not_loaded,
            )

    def _loaded(self, path: str, image: NDArray[Any]) -> None:
        self.image, self._opened = image, path
        self.panel.file.setText(f"{Path(path).name}, {image.shape[1]} × {image.shape[0]} px")
        self.panel.show_map(False)
        self._show_controls()
        self._forecast()

    def _not_loaded(self, words: str) -> None:
        self.panel.view.blank.wait("")
        self.panel.show_status(words, bad=True)
        self.context.message.emit(words)

    # -- forecast --------------------------------------------------------------------------------------
    def _asked(self) -> tuple[Depth, Camera | None]:
        """Return the task for the measurement; raise `InputError` if something is missing."""
        state, settings = self.context.state, self.settings
        return model.task_of(settings, state, state.light_field), model.camera_of(settings, state)

    def _forecast(self) -> None:
        self._turn += 1
        turn = self._turn
        if self.image is None or self._job:
            return
        try:
            task, camera = self._asked()
        except InputError as error:
            self._refused(str(error))
            return

        def newest(report: Callable[[Any], None], found: Any) -> None:
            if turn == self._turn:  # else the settings have been refused since
                report(found)

        self.panel.show_status("forecasting …")
        self.context.jobs.compute(
            "depth forecast",
            lambda: task.forecast(camera),
            partial(newest, self._forecasted),
            partial(newest, self._refused),
        )

    def _forecasted(self, found: DepthForecast) -> None:
        workers = worker_count()
        self._problem, self._seconds = "", found.seconds / workers
        if not self._job:
            pace = self.context.paces.seconds("depth", 1.0)
            self.panel.show_took(f"about {format_seconds(self._seconds * pace)}")
            self.panel.show_status(model.forecast_words(found, workers))
        self._show_controls()

    def _refused(self, words: str) -> None:
        """Show why the frame cannot be measured."""
        self._problem, self._seconds = said_in_window(words), None
        if not self._job:
            self.panel.show_took("")
            self.panel.show_status(self._problem, bad=True)
        self._show_controls()

    # -- measuring -------------------------------------------------------------------------------------
    def _pressed(self, key: str) -> None:
        actions = {"open": self.choose_frame, "measure": self.start, "stop": self.stop}
        actions.get(key, partial(self.save, key))()

    def start(self) -> None:
        """Measure the depth of the frame as a job."""
        if self.image is None or self._job:
            return
        try:
            task, camera = self._asked()
        except InputError as error:
            self._refused(str(error))
            return
        self._of, jobs = self.context.state, self.context.jobs
        needs = [str(path) for path in task.files("in") if path.exists()]
        title = f"Measure depth in {task.frame.name}"
        taken = self.context.taken("depth", title, draft=True)
        self._job = jobs.start(
            title,
            "depth",
            lambda: model.iter_looked(task, camera),
            self._measured,
            kind="depth",
            abandon=True,
            leave=True,
            needs=needs,
            taken=taken,
        )
        self.panel.show_took("")
        self.panel.show_status(WAITS if self._job in jobs.waiting() else "reading …", busy=True)
        self._show_controls()

    def _job_changed(self, job: WindowJob) -> None:
        if job.number == self._job:
            self.panel.show_progress(job)

    def _job_finished(self, job: WindowJob) -> None:
        if job.number != self._job:
            return
        self._job = 0
        self.panel.show_end(job)
        self._show_controls()

    def _measured(self, looked: Looked) -> None:
        if self._of.light_field == self.context.state.light_field:
            self.panel.show_took(f"done in {format_seconds(looked.made.seconds)}", "good")
            self._show_map(looked)

    # -- map -------------------------------------------------------------------------------------------
    def _show_map(self, looked: Looked | None) -> None:
        self.made, self._shades, facts = looked or (None, {}, ())
        self.panel.show_facts(facts, tuple(self._shades))
        self.panel.show_map(looked is not None)

    def _show_picture(self) -> None:
        """Show the map or the frame."""
        made, panel = self.made, self.panel
        if made is None or not panel.shows_map:
            shot = None if self.image is None else Shot(self.image, "Light-field frame", name="light_field")
            panel.view.set_shot(shot)
            return
        shade, least = self._shades[panel.quantity.currentData()], panel.least.value() / 100

        def shown(shot: Shot) -> None:
            if made is self.made and panel.shows_map:
                panel.view.set_shot(shot)

        self.context.jobs.compute("depth picture", lambda: model.shot_of(made.found, shade, least), shown)

    def _hovered(self, row: int, column: int, value: float) -> None:
        if row < 0:
            self.panel.readout.setText(" ")
        elif self.panel.shows_map and self.made is not None and self.panel.view.shot.tint is not None:
            self.panel.readout.setText(model.readout(self.made.found, self._shades, row, column))
        else:
            self.panel.readout.setText(f"row {row}, column {column}: {value:.5g} counts")

    def save(self, kind: str, path: str = "") -> None:
        """Save the map or the points; without a path, ask for one."""
        made, state = self.made, self._of
        path = path or ("" if made is None else ask_target(self, *KINDS[kind]))
        if made is None or not path:
            return
        from lfcal.lattice import save_depth, save_points

        taken = self.context.taken("depth", f"Save {Path(path).name}", path, lambda: step(state, path))

        def write() -> str:
            (save_points if kind == "points" else save_depth)(Path(path), made.found)
            return path

        self.context.jobs.compute("depth save", write, lambda path: self._saved(path, taken), self.refuse)

    def _saved(self, path: str, taken: Taken) -> None:
        self.context.history.add(taken)
        self.context.message.emit(f"saved {path}")
