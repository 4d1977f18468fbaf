"""The fit of the optics: request, progress, result and use."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtCore import QUrl
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QFileDialog

from lfcal.base import InputError, Work, format_seconds
from lfcal.fit import MODEL, REPORT, Fit, fit_outputs, iter_fit_report
from lfcal.tasks import FitMatrix
from lfcal_gui.jobs import WAITS, JobState, WindowJob
from lfcal_gui.models import FittedCamera, ProjectState, value_in
from lfcal_gui.pages.h.fit_view import FitView
from lfcal_gui.pages.h.model import PositionMap
from lfcal_gui.pages.h.model_fit import FitSettings, FitUse, Stamp, offer_of, stamp_of, use_of
from lfcal_gui.pages.h.model_fit_run import FitRun, FoundFit, Place, asked_of, chi2_map, iter_fit, iter_taken
from lfcal_gui.pages.h.step_fit import step, step_as
from lfcal_gui.saving import ask_target, may_replace


class Results:
    """Write the results of a fit as jobs.

    Parameters
    ----------
    fitting, page
        `Fitting` with the result ``found``, and the page that shows errors.
    """

    def __init__(self, fitting: Any, page: Any) -> None:
        self._fitting, self._page, self.context = fitting, page, page.context
        self.report: Path | None = None
        self._scratch: tempfile.TemporaryDirectory[str] | None = None

    def close(self) -> None:
        """Forget the report; delete its files if it was not saved."""
        self.report = None
        if self._scratch is not None:
            self._scratch.cleanup()
            self._scratch = None

    def compute(self, path: str = "") -> None:
        """Compute H of the fitted camera as a job; this H becomes the second H of the project."""
        found = self._fitting.found
        if found is None:
            return
        path = path or ask_target(self._page, "Compute H", "model_H.h5", "H file (*.h5)")
        if not path or self._refused([Path(path)]):
            return
        self.context.start_writing(
            f"H of the fit: {Path(path).name}",
            self._page.spec.key,
            path,
            lambda: found.iter_model(Path(path)),
            lambda _: self._computed(found, path),
            lambda job: self._page.refuse(job.error),
        )

    def _computed(self, found: FoundFit, path: str) -> None:
        self.context.message.emit(f"H of the fitted camera written: {path}")
        if found is self._fitting.found:  # else it belongs to another H
            self.context.project.update("H of the fit", reference=path)

    def save(self, folder: str = "") -> None:
        """Save all results of the fit in a folder as a job."""
        found, asked = self._fitting.found, not folder
        if found is None:
            return
        folder = folder or QFileDialog.getExistingDirectory(self._page, "Folder for the fit")
        if not folder or self._refused([Path(folder) / MODEL]):
            return
        if asked and not may_replace(self._page, fit_outputs(Path(folder))):
            return
        asked = found.question
        self.context.start_writing(
            f"Save fit in {Path(folder).name}",
            self._page.spec.key,
            str(Path(folder) / MODEL),
            lambda: found.iter_saved(Path(folder)),
            lambda files: self._saved(found, files),
            lambda job: self._page.refuse(job.error),
            taken=self.context.taken(
                "fit", f"Fit {asked.name}", folder, lambda: step_as(asked.settings, asked.project, asked.offer, folder)
            ),
        )

    def _saved(self, found: FoundFit, files: list[Path]) -> None:
        self.context.message.emit(f"fit written: {files[-1].parent}")
        if found is self._fitting.found:
            self.report = next(path for path in files if path.parent.name == REPORT)

    def _refused(self, files: list[Path]) -> bool:
        """Return whether a file would replace the fitted H, and report this."""
        own = Path(self.context.state.psf).resolve()
        if own in [path.resolve() for path in files]:
            self._page.refuse(f"{own.name} is the H that was fitted; choose another name")
            return True
        return False

    def open_report(self) -> None:
        """Show the report in the browser; if it was not saved, write it to a temporary folder."""
        found = self._fitting.found
        if found is None:
            return
        if self.report is not None and self.report.is_file():
            self.show_page(self.report)
            return
        self._scratch = self._scratch or tempfile.TemporaryDirectory(prefix="lfcal-fit-")
        folder = Path(self._scratch.name)
        self.context.jobs.start(
            "Report of the fit",
            self._page.spec.key,
            lambda: iter_fit_report(found.fit, found.measured, folder, found.question.name),
            lambda page: self._reported(found, page),
            lambda job: self._failed(found, job),
        )

    def _failed(self, found: FoundFit, job: WindowJob) -> None:
        if found is self._fitting.found:  # else its temporary folder was removed meanwhile
            self._page.refuse(job.error)

    def _reported(self, found: FoundFit, page: Path) -> None:
        if found is self._fitting.found:
            self.report = page
            self.show_page(page)

    def show_page(self, page: Path) -> None:
        """Open a page in the browser."""
        QDesktopServices.openUrl(QUrl.fromLocalFile(str(page)))


class Fitting:
    """Run fits, and keep the result until H changes. After a stopped or failed fit, the previous result remains.

    Parameters
    ----------
    page
        The page H, which shows the patterns of a fit.
    """

    def __init__(self, page: Any) -> None:
        self._page, self.context = page, page.context
        self.found: FoundFit | None = None
        self._kept, self._rounds = FitRun(), FitRun()
        self._stamp: Stamp | None = None
        self._job = 0
        self._said = ("", False)
        self._used: FitUse | None = None
        self.results = Results(self, page)
        self.view = view = FitView()
        view.choices.edited.connect(self._edited)
        view.choices.group_toggled.connect(self._toggled)
        view.place_asked.connect(self.show_place)
        for button, action in (
            (view.fit_button, self.begin),
            (view.use_button, self.use),
            (view.worst_button, self.show_worst),
            (view.model_button, self.results.compute),
            (view.save_button, self.results.save),
            (view.report_button, self.results.open_report),
        ):
            button.clicked.connect(lambda _=False, action=action: action())
        self.context.jobs.changed.connect(self._job_changed)
        self.context.jobs.finished.connect(self._job_finished)
        self.context.on_close(self.results.close)
        self.follow()

    # -- project ---------------------------------------------------------------------------------------
    @property
    def settings(self) -> FitSettings:
        """The user's settings."""
        return FitSettings.of(self.context.state)

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Update the view if H, settings, camera or plan changed."""
        changed = (old.psf, old.camera, old.plan) != (new.psf, new.camera, new.plan)
        if changed or FitSettings.of(old) != FitSettings.of(new):
            self.follow()

    def entered(self) -> None:
        """Discard the results if the file of H has changed."""
        self.follow()

    def _edited(self, key: str, value: Any) -> None:
        value = value if key in ("camera", "auto") else value_in(FitMatrix, key, value)
        settings = replace(self.settings, **{key: value})
        self.context.project.merge(f"fit: {key}", settings=settings.into(self.context.state))

    def _toggled(self, name: str, on: bool) -> None:
        others = tuple(one for one in self.settings.groups if one != name)
        settings = replace(self.settings, groups=(*others, name) if on else others)
        self.context.project.update("unknowns", settings=settings.into(self.context.state))

    def follow(self) -> None:
        """Show the results for the current H, and discard those of another H."""
        state, stamp = self.context.state, stamp_of(self.context.state)
        if stamp != self._stamp:
            self._stamp = stamp
            self._release()
        self._show_buttons()
        matrix = None if stamp is None else self.context.matrix(state.psf)
        choices, settings, found = self.view.choices, self.settings, self.found
        offer = None if matrix is None else offer_of(matrix)
        choices.show_source(Path(state.psf).name, offer, state)
        same = found is not None and found.question.settings == settings
        without = {} if offer is None else offer.lacking(settings, state.camera, state.plan)
        choices.show_settings(settings, found.fit if found is not None and same else None, without)
        if not self._job:
            self._show_found()

    def _release(self) -> None:
        """Discard the fit of another H, and stop a running one."""
        number, self._job = self._job, 0  # ignore its result
        if number:
            self.context.jobs.cancel(number)
        self.found, self._said, self._used = None, ("", False), None
        self._kept = self._rounds = FitRun()
        self.results.close()
        self.context.set_fitted(None)
        self.view.show_ready()
        self._page.show_fit(None)

    # -- showing ---------------------------------------------------------------------------------------
    @property
    def _recording(self) -> bool:
        return "acquire" in self.context.jobs.running_pages()

    @property
    def row_words(self) -> str:
        """State of the fit in words, for the inspector."""
        if self._job:
            return "fitting …"
        if self.found is None:
            return "failed" if self._said[1] else "not fitted"
        error = self.found.fit.held_out_error
        return ("" if self.found.fit.complete else "▲ ") + (f"error {error}" if error.known else "below the noise")

    def _show_buttons(self) -> None:
        self._page.show_levels()
        view = self.view
        there, done = self._stamp is not None, self.found is not None and not self._job
        view.fit_button.setEnabled(there and not self._job)
        for button in (view.model_button, view.save_button, view.report_button, view.worst_button):
            button.setEnabled(done)
        view.use_button.setEnabled(done and not self._recording)
        view.use_button.setToolTip(
            "Not available while a session is being recorded with the camera"
            if self._recording
            else "Use the fitted camera in this project, and the fitted effects in Record > Compute. Undo restores both"
        )
        view.choices.set_running(bool(self._job))

    def _show_found(self) -> None:
        if self.found is None:
            words, failed = self._said
            self.view.show_ready(words, failed=failed)
            return
        changed = self.found.question.settings != self.settings
        # undo may have taken it back
        used = self._used.words if self._used is not None and self._used.holds(self.context.state) else ""
        since = "The settings changed since this fit; press Fit to use them." if changed else ""
        self.view.show_found(self.found, self._rounds.rounds, "\n".join(filter(None, (used, since))))

    def map_at(self, z: int) -> PositionMap | None:
        """Return the map of χ² of a plane; None without a fit or without one of its patterns in the plane."""
        return None if self.found is None else chi2_map(self.found, z)

    def show_place(self, place: Place) -> None:
        """Show the pattern at a position (z, y, x), if the fit used this pattern."""
        if self.found is not None and place in self.found.chi2:
            self._page.set_intent(z=place[0], y=place[1], x=place[2], view="fit")

    def show_worst(self) -> None:
        """Show the pattern with the largest χ²."""
        if self.found is not None:
            self.show_place(self.found.worst())

    # -- fitting ---------------------------------------------------------------------------------------
    def begin(self) -> None:
        """Fit the recorded positions of H as a job."""
        if self._job or self._stamp is None:
            return
        self.follow()  # H may be another one by now
        try:
            asked = asked_of(self.context.state, self.settings)
        except InputError as error:
            self._page.refuse(str(error))
            return
        self._start(f"Fit {asked.name}", lambda kept: iter_fit(asked, kept))

    def take(self, fit: Fit) -> None:
        """Take over a fit that was made while the patterns of H were recorded."""
        state = self.context.state
        settings = replace(self.settings, camera="psf", positions=0, auto=True, noise=None, effects=())
        self.context.project.update("fit of the session", settings=settings.into(state))
        self.follow()
        if self._job or self._stamp is None:
            return
        asked = asked_of(self.context.state, settings)
        self._start(f"Fit of {asked.name}", lambda kept: iter_taken(asked, fit, kept))

    def _start(self, title: str, work: Callable[[FitRun], Work[None]]) -> None:
        self._page.notice.clear()
        self._page.hold_keyboard()
        self._kept = kept = FitRun()
        state = self.context.state
        taken = self.context.taken("fit", title, step=lambda: step(state), draft=True)
        self._said, self._used = ("", False), None
        jobs, needs = self.context.jobs, () if self._stamp is None else (self._stamp[0],)
        self._job = jobs.start(
            title,
            self._page.spec.key,
            lambda: work(kept),
            kind="fit",
            abandon=True,
            leave=True,
            needs=needs,
            taken=taken,
        )
        self._show_buttons()
        waits = self._job in jobs.waiting()
        self.view.show_running(WAITS if waits else "Fitting: reading H …", None, ())

    def _job_changed(self, job: WindowJob) -> None:
        if job.number == self._job and job.state is JobState.RUNNING:
            record, words = job.progress, "Fitting: reading H …"
            if record is not None:
                words = f"Fitting: {record.stage} … {format_seconds(time.monotonic() - job.started)} so far"
            self.view.show_running(words, record, self._kept.rounds)
        elif job.page == "acquire" and (not job.active or job.progress is None):
            self._show_buttons()

    def _job_finished(self, job: WindowJob) -> None:
        if job.number != self._job:
            return
        self._job, kept = 0, self._kept
        if job.state is JobState.DONE and kept.found is not None and kept.found.question.stamp == self._stamp:
            self.found, self._rounds = kept.found, kept
            self.results.close()
            self.context.set_fitted(FittedCamera(kept.found.question.stamp, kept.found.fit.ideal_places))
            self.context.message.emit(f"{kept.found.question.name}: {kept.found.fit.verdict}")
            self._page.show_fit(kept.found)
        elif self.found is None:
            self._said = (job.error or "Stopped.", bool(job.error))
        elif job.error:
            self._page.refuse(job.error)
        self._kept = FitRun()
        self.follow()

    # -- using -----------------------------------------------------------------------------------------
    def use(self) -> None:
        """Use camera and effects of the fit in the project, as one undo step."""
        if self.found is None or self._job:
            return
        if self._recording:
            self._page.refuse("The camera cannot change while a session is being recorded")
            return
        self._used = use = use_of(self.context.state, self.found.fit)
        self.context.project.update("fitted camera", **use.changes)
        self.context.message.emit(use.words)
        self.follow()

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.view.apply_theme()
