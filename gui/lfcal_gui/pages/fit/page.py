"""Fit: the optics from a few recorded positions, and what is made of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from lfcal.base import InputError, Work, format_seconds
from lfcal.fit import Fit
from lfcal.tasks import FitMatrix
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.jobs import WAITS, JobState, WindowJob
from lfcal_gui.models import FittedCamera, PageSpec, ProjectState, value_in
from lfcal_gui.pages.fit._results import Results
from lfcal_gui.pages.fit.model import FitSettings, Stamp, offer_of, stamp_of
from lfcal_gui.pages.fit.model_run import FitRun, FoundFit, Place, asked_of, iter_fit, iter_taken
from lfcal_gui.pages.fit.model_use import FitUse, use_of
from lfcal_gui.pages.fit.panel import FitPanel
from lfcal_gui.pages.fit.patterns_view import PatternsView

__all__ = ["Page"]


class Page(BasePage):
    """Keeps what was found until H changes; a fit that is stopped or fails leaves the one before."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.found: FoundFit | None = None
        self._kept, self._rounds = FitRun(), FitRun()
        self._stamp: Stamp | None = None
        self._job = 0
        self._said = ("", False)
        self._used: FitUse | None = None
        self.results = Results(self)
        self._make_buttons()
        self.panel = FitPanel()
        self.panel.choices.edited.connect(self._edited)
        self.panel.choices.group_toggled.connect(self._toggled)
        self.panel.place_asked.connect(self.panel.show_place)
        self.set_panel(self.panel)
        self._add_shortcuts()
        self.theme_changed.connect(self._apply_theme)
        context.matrices.changed.connect(self._matrix_changed)
        context.jobs.changed.connect(self._job_changed)
        context.jobs.finished.connect(self._job_finished)
        context.on_close(self.results.close)
        context.matrices.want(context.state.psf)
        self._follow()

    def _make_buttons(self) -> None:
        self.use_button = self.tool_button("Use camera", "", self.use)
        self.model_button = self.tool_button(
            "Compute H …", "H of the fitted camera over all positions and depths, without noise", self.results.compute
        )
        self.save_button = self.tool_button(
            "Save fit …",
            "Camera, effects, H, numbers and report into a folder, as lfcal fit writes them",
            self.results.save,
        )
        self.report_button = self.tool_button("Open report", "The fit as a page for people", self.results.open_report)
        self.stop_button = self.stop_tool("Stop the fit; what was found before stays")
        self.fit_button = self.tool_button("Fit", "Fit the recorded positions of H (F5)", self.fit)

    def _add_shortcuts(self) -> None:
        see = self.panel.on_patterns
        self.shortcut("F5", self.fit)
        self.shortcut("Left", lambda: see(lambda view: view.step(-1)))
        self.shortcut("Right", lambda: see(lambda view: view.step(1)))
        self.shortcut("PgUp", lambda: see(lambda view: view.step_plane(-1)))
        self.shortcut("PgDown", lambda: see(lambda view: view.step_plane(1)))
        self.shortcut("W", lambda: see(PatternsView.show_worst))
        self.shortcut("L", lambda: see(lambda view: view.toggle_scale("log")))
        self.shortcut("G", lambda: see(lambda view: view.toggle_scale("gamma")))

    # -- project ---------------------------------------------------------------------------------------
    @property
    def settings(self) -> FitSettings:
        """What the user chose."""
        return FitSettings.of(self.context.state)

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Follow H, the choices, camera and plan."""
        if old.psf != new.psf:
            self.context.matrices.want(new.psf)
        changed = (old.psf, old.camera, old.plan) != (new.psf, new.camera, new.plan)
        if changed or FitSettings.of(old) != FitSettings.of(new):
            self._follow()

    def entered(self) -> None:
        """Look whether the file of H is still the one that was fitted."""
        self._follow()

    def _matrix_changed(self, path: str) -> None:
        if path == self.context.state.psf:
            self._follow()

    def _edited(self, key: str, value: Any) -> None:
        value = value if key in ("camera", "auto") else value_in(FitMatrix, key, value)
        settings = replace(self.settings, **{key: value})
        self.context.project.merge(f"fit: {key}", settings=settings.into(self.context.state))

    def _toggled(self, name: str, on: bool) -> None:
        others = tuple(one for one in self.settings.groups if one != name)
        settings = replace(self.settings, groups=(*others, name) if on else others)
        self.context.project.update("unknowns", settings=settings.into(self.context.state))

    def _follow(self) -> None:
        """Show what belongs to the H of now; what belongs to another is let go."""
        state, stamp = self.context.state, stamp_of(self.context.state)
        if stamp != self._stamp:
            self._stamp = stamp
            self._release()
        self._show_buttons()
        if stamp is None:
            self.show_empty(
                "Nothing to fit yet.\nA few recorded positions are enough: assemble frames, or open an H file; "
                "missing positions do not matter.",
                {
                    "Folder": self.lead("frames", "Make H of recorded frames"),
                    "PSF": self.lead("psf", "Open an H that was assembled, simulated or fitted before"),
                },
            )
            return
        matrix = self.context.matrix(state.psf)
        if matrix is None and not self._busy and self.found is None:
            self.show_no_matrix(
                state.psf, "", {"PSF": self.lead("psf", "Open an H that was assembled, simulated or fitted before")}
            )
            return
        self.show_body()
        choices, settings = self.panel.choices, self.settings
        offer = None if matrix is None else offer_of(matrix)
        choices.show_source(Path(state.psf).name, offer, state)
        found = self.found
        same = found is not None and found.question.settings == settings
        without = {} if offer is None else offer.lacking(settings, state.camera, state.plan)
        choices.show_settings(settings, found.fit if found is not None and same else None, without)
        if not self._busy:
            self._show_found()

    def _release(self) -> None:
        """Forget the fit of another H, and stop the one at work."""
        number, self._job = self._job, 0  # whose end is of no interest any more
        if number:
            self.context.jobs.cancel(number)
        self.found, self._said, self._used = None, ("", False), None
        self._kept = self._rounds = FitRun()
        self.results.close()
        self.notice.clear()
        self.context.set_fitted(None)
        self.context.attention.emit("fit", False)
        self.panel.show_ready()

    # -- showing ---------------------------------------------------------------------------------------
    @property
    def _busy(self) -> bool:
        return bool(self._job)

    @property
    def _recording(self) -> bool:
        return "acquire" in self.context.jobs.running_pages()

    def _show_buttons(self) -> None:
        there, done = self._stamp is not None, self.found is not None and not self._busy
        self.fit_button.setEnabled(there and not self._busy)
        for button in (self.model_button, self.save_button, self.report_button):
            button.setEnabled(done)
        self.use_button.setEnabled(done and not self._recording)
        self.use_button.setToolTip(
            "Not while a session is being recorded: its camera stays as it is"
            if self._recording
            else "Make the fitted camera this window's, and its effects those of Record > Compute (undo takes it back)"
        )
        self.panel.choices.set_running(self._busy)

    def _show_found(self) -> None:
        if self.found is None:
            words, failed = self._said
            self.panel.show_ready(words, failed=failed)
            return
        changed = self.found.question.settings != self.settings
        # undo may have taken it back
        used = self._used.words if self._used is not None and self._used.holds(self.context.state) else ""
        since = "Choices changed since this fit: press Fit to use them." if changed else ""
        self.panel.show_found(self.found, self._rounds.rounds, "\n".join(filter(None, (used, since))))

    def _show_running(self, job: WindowJob) -> None:
        record = job.progress
        words = "Fitting: reading H …"
        if record is not None:
            words = f"Fitting: {record.stage} …"
            words += f" {format_seconds(time.monotonic() - job.started)} so far"
        self.panel.show_running(words, record, self._kept.rounds)

    # -- fitting ---------------------------------------------------------------------------------------
    def fit(self) -> None:
        """Fit the recorded positions of H as a job."""
        if self._busy or self._stamp is None:
            return
        self._follow()  # H may be another one by now
        try:
            asked = asked_of(self.context.state, self.settings)
        except InputError as error:
            self.refuse(str(error))
            return
        self._start(f"Fit {asked.name}", lambda kept: iter_fit(asked, kept))

    def take(self, fit: Fit) -> None:
        """Take over a fit that was made while the patterns of H were recorded."""
        state = self.context.state
        settings = replace(self.settings, camera="psf", positions=0, auto=True, noise=None, effects=())
        self.context.project.update("fit of the session", settings=settings.into(state))
        self._follow()
        if self._busy or self._stamp is None:
            return
        asked = asked_of(self.context.state, settings)
        self._start(f"Fit of {asked.name}", lambda kept: iter_taken(asked, fit, kept))

    def _start(self, title: str, work: Callable[[FitRun], Work[None]]) -> None:
        self.notice.clear()
        self.hold_keyboard()
        self._kept = kept = FitRun()
        taken = self.context.taken("fit", title, draft=True)
        self._said, self._used = ("", False), None
        jobs, needs = self.context.jobs, () if self._stamp is None else (self._stamp[0],)
        self._job = jobs.start(
            title, "fit", lambda: work(kept), kind="fit", abandon=True, leave=True, needs=needs, taken=taken
        )
        self._show_buttons()
        waits = self._job in jobs.waiting()
        self.panel.show_running(WAITS if waits else "Fitting: reading H …", None, ())

    def _job_changed(self, job: WindowJob) -> None:
        if job.number == self._job and job.state is JobState.RUNNING:
            self._show_running(job)
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
            self.context.attention.emit("fit", not kept.found.fit.complete)
            self.context.message.emit(f"{kept.found.question.name}: {kept.found.fit.verdict}")
        elif self.found is None:
            self._said = (job.error or "Stopped.", bool(job.error))
        elif job.error:
            self.refuse(job.error)
        self._kept = FitRun()
        self._follow()

    # -- using -----------------------------------------------------------------------------------------
    def use(self) -> None:
        """Make camera and effects of the fit those of the whole window: one step of undo."""
        if self.found is None or self._busy:
            return
        if self._recording:
            self.refuse("The camera stays as it is while a session is being recorded")
            return
        self._used = use = use_of(self.context.state, self.found.fit)
        self.context.project.update("fitted camera", **use.changes)
        self.context.message.emit(use.words)
        self._follow()

    def receive(self, payload: Any) -> None:
        """Show a position (z, y, x), or take over a fit, that another page sent."""
        if isinstance(payload, Fit):
            self.take(payload)
        elif isinstance(payload, tuple) and len(payload) == 3:
            place: Place = payload
            self.panel.show_place(place)

    def _apply_theme(self) -> None:
        self.panel.apply_theme()
        if self.found is not None and not self._busy:
            self._show_found()
