"""Watch: check frames as a job, show the drift of each, and recalibrate H after a drift."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from PySide6.QtWidgets import QFileDialog

from lfcal.base import InputError
from lfcal.fit import MODEL
from lfcal.recalibrate import RECALIBRATED
from lfcal.tasks import Watch, Watched
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.jobs import WAITS, WindowJob
from lfcal_gui.models import PageSpec, ProjectState, said_in_window, shown_of
from lfcal_gui.pages.watch.model import WatchSettings, task_of
from lfcal_gui.pages.watch.panel import WatchPanel


class Page(BasePage):
    """Page that checks H with ordinary frames."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.panel = WatchPanel()
        self._job = 0
        self.set_panel(self.panel)
        context.let_edit(self.panel.form, lambda: self.settings, "watch:")
        self.panel.pressed.connect(self._pressed)
        self.shortcut("F5", self.start)
        self.shortcut("Escape", self.stop)
        context.jobs.changed.connect(self._job_changed)
        context.jobs.finished.connect(self._job_finished)
        self.theme_changed.connect(self.panel.apply_theme)
        self._show()

    @property
    def settings(self) -> WatchSettings:
        """The user's settings."""
        return WatchSettings.of(self.context.state)

    def let_go(self) -> None:
        """Discard the result of the previous project, and stop checking."""
        number, self._job = self._job, 0
        self.context.jobs.cancel(number)
        self.panel.show_found(None)

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Update the page if H or settings changed."""
        if old.psf != new.psf:
            self.panel.show_found(None)
        if old.psf != new.psf or WatchSettings.of(old) != WatchSettings.of(new):
            self._show()

    def _show(self) -> None:
        settings = self.settings
        if not self.context.state.psf:
            text = "The project has no H.\nOpen an H with its camera to check whether it is still valid."
            self.show_empty(text, {"Go to H": self.lead("h", "Open an H that was assembled, simulated or fitted")})
            return
        self.show_body()
        self.panel.frames.setText("; ".join(Path(path).name for path in settings.frames) or "none yet")
        self.panel.form.set_values(shown_of(Watch, {**settings.option_values, "psf": "", "frames": (), "out": None}))
        self.panel.show_go(running=bool(self._job), enabled=bool(settings.frames))

    def _pressed(self, key: str) -> None:
        actions: dict[str, Callable[[], object]] = {"check": self.start, "stop": self.stop}
        actions |= {"files": self.choose_files, "folder": self.choose_folder, "recalibrate": self.recalibrate}
        actions[key]()

    def choose_files(self) -> None:
        """Ask for images."""
        self._use(QFileDialog.getOpenFileNames(self, "Open frames", "", "All files (*)")[0])

    def choose_folder(self) -> None:
        """Ask for a folder of frames."""
        self._use([QFileDialog.getExistingDirectory(self, "Open a folder of frames")])

    def _use(self, paths: list[str]) -> None:
        if any(paths):
            self.context.edit(self.settings, "frames", paths, "watch:")

    # -- checking --------------------------------------------------------------------------------------
    def start(self) -> None:
        """Check the frames as a job."""
        self._run("")

    def recalibrate(self, folder: str = "") -> None:
        """Check the frames, recalibrate H after a drift, and write the new H to a folder (if empty, ask for one)."""
        folder = folder or QFileDialog.getExistingDirectory(self, "Folder for the recalibrated H")
        if folder:
            self._run(folder)

    def _run(self, out: str) -> None:
        if self._job:
            return
        try:
            task = task_of(self.settings, self.context.state, out)
            taken = [path for path in task.files("out") if path.exists()]
            if taken:
                raise InputError(f"{taken[0]}: exists; choose another folder")
        except InputError as error:
            self.panel.show_status(said_in_window(str(error)), bad=True)
            return
        title = f"Recalibrate {task.psf.name}" if out else f"Watch {task.psf.name}"
        done = partial(self._checked, out)
        history = self.context.taken("watch", title, out, draft=not out)
        self._job = self.context.jobs.start(title, "watch", task.work, done, kind="watch", leave=not out, taken=history)
        self.panel.show_status(WAITS if self._job in self.context.jobs.waiting() else "reading …", busy=True)
        self._show()

    def _checked(self, out: str, made: tuple[Watched, ...]) -> None:
        (watched,) = made
        fit = watched.recalibration
        if fit is None or not fit.accepted:
            self.panel.show_found(watched.found)
        else:
            self.context.project.update("recalibrated H", psf=str(Path(out) / RECALIBRATED / MODEL))
            self.context.message.emit(fit.verdict)
        if fit is not None:
            self.panel.show_status("\n".join((fit.verdict, *fit.notes)), bad=not fit.accepted)

    def _job_changed(self, job: WindowJob) -> None:
        if job.number == self._job:
            self.panel.show_progress(job)

    def _job_finished(self, job: WindowJob) -> None:
        if job.number != self._job:
            return
        self._job = 0
        self.panel.show_end(job)
        self._show()
