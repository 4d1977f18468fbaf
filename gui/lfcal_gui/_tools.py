"""Dialogs that belong to no page: welcome, sample session, verify, doctor, preferences."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject
from PySide6.QtWidgets import QDialog

from lfcal_gui._help import DoctorDialog
from lfcal_gui._verify_dialog import VerifyDialog
from lfcal_gui._welcome import Welcome
from lfcal_gui.models import ProjectState
from lfcal_gui.preferences import Preferences, welcome_wanted


class Tools(QObject):
    """Dialogs of a `lfcal_gui.window.MainWindow`; ``dialog`` is the one opened last."""

    def __init__(self, window: Any, folder: Path) -> None:
        super().__init__(window)
        self._window, self._folder = window, folder
        self.dialog: QDialog | None = None
        self._verify: VerifyDialog | None = None
        self._doctor: DoctorDialog | None = None

    def _open(self, dialog: Any) -> Any:
        self.dialog = dialog
        dialog.show()
        return dialog

    def verify(self) -> VerifyDialog:
        """Open the dialog that checks a session or an H file."""
        if self._verify is None:
            self._verify = VerifyDialog(self._window.context, self._window)
        self._verify.offer()
        self._open(self._verify)
        return self._verify

    def doctor(self) -> DoctorDialog:
        """Show the report of ``lfcal doctor`` on this machine."""
        if self._doctor is None:
            self._doctor = DoctorDialog(self._window.jobs, self._window)
        self._doctor.look()
        self._open(self._doctor)
        return self._doctor

    def preferences(self) -> Preferences:
        """Open the preferences."""
        dialog = Preferences(self._window.settings, self._window)
        dialog.theme_asked.connect(self._window.set_theme)
        dialog.layout_reset.connect(self._window.reset_layout)
        self._open(dialog)
        return dialog

    # -- beginning -------------------------------------------------------------------------------------
    def begin(self) -> None:
        """Show the welcome dialog at the first start, or if the preferences say so."""
        if welcome_wanted(self._window.settings):
            self.welcome()

    def welcome(self) -> Welcome:
        """Show the welcome dialog."""
        window = self._window
        dialog = Welcome(window.files.recent.paths(), welcome_wanted(window.settings), window)
        dialog.chosen.connect(self._chosen)
        dialog.project_chosen.connect(lambda path: window.files.open(Path(path)))
        dialog.kept.connect(lambda on: window.settings.setValue("welcome", on))
        self._open(dialog)
        return dialog

    def _chosen(self, key: str) -> None:
        actions = {"sample": self.sample, "new": lambda: self._window.go("setup"), "open": self._window.files.open}
        actions[key]()

    def sample(self) -> None:
        """Open the sample session, after asking about unsaved work; its H is assembled as a job the first time."""
        from lfcal_gui._welcome import iter_demo

        window = self._window
        if any(job.page == "sample" and job.active for job in window.jobs.jobs()) or not window.files.may_leave():
            return
        folder = self._folder / "demo"
        window.jobs.start("Open the sample session", "sample", lambda: iter_demo(folder), self._opened, kind="sample")

    def _opened(self, state: ProjectState) -> None:
        # the user may have changed the project meanwhile
        if self._window.files.may_leave():
            self._window.files.start_with(state)
            self._window.go("h")
