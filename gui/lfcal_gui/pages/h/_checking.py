"""The checks of H: inspection as a job, and display of each check."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray
from PySide6.QtWidgets import QFileDialog

from lfcal.base import format_count
from lfcal_gui.jobs import WAITS, JobState, WindowJob
from lfcal_gui.models import (
    ATLAS,
    Place,
    ProjectState,
    Stamp,
    capital,
    kept_verdict,
    stamp_of,
    stated_order,
    with_verdict,
)
from lfcal_gui.pages.h import model_checks
from lfcal_gui.pages.h.checks_view import ChecksView
from lfcal_gui.pages.h.model import PositionMap
from lfcal_gui.pages.h.model_checks import CheckRow, InspectionRequest, InspectionRun, QualitySettings
from lfcal_gui.pages.h.step_checks import step
from lfcal_gui.saving import may_replace

if TYPE_CHECKING:
    from lfcal.judge import Inspection


class Checking:
    """Inspect H when its checks are first shown and on request; the results are kept until H changes.

    Parameters
    ----------
    page
        The page H, which shows positions and planes.
    """

    title = "Checks"

    def __init__(self, page: Any) -> None:
        self._page, self.context = page, page.context
        self.view: ChecksView | None = None
        self.inspection: Inspection | None = None
        self.checks: tuple[CheckRow, ...] = ()
        self.chosen: CheckRow | None = None
        self._stamp: Stamp | None = None
        self._asked: InspectionRequest | None = None
        self._question: InspectionRequest | None = None
        self._kept = InspectionRun()
        self._job = self._report = 0
        self.context.fitted_changed.connect(self._show_state)
        self.context.jobs.changed.connect(self._job_changed)
        self.context.jobs.finished.connect(self._job_finished)
        self.follow()

    def make_view(self) -> ChecksView:
        """Return the view of the checks, which is created at the first call."""
        if self.view is None:
            view = self.view = ChecksView()
            self.context.let_edit(view.form, lambda: self.settings, "quality:")
            view.folder_asked.connect(self.choose_fit)
            view.every_toggled.connect(lambda _: self._show())
            view.redo.clicked.connect(lambda: self.redo())
            view.measure_button.clicked.connect(lambda: self.measure(force=True))
            view.report_button.clicked.connect(lambda: self.write_report())
            view.fault_asked.connect(lambda name: self.context.help_asked.emit(ATLAS, name))
            view.chosen.connect(self._look_at)
            view.show_settings(self.settings)
            view.show_message("H has not been inspected yet.")
            self._show()
        return self.view

    # -- project ---------------------------------------------------------------------------------------
    @property
    def settings(self) -> QualitySettings:
        """The user's settings."""
        return QualitySettings.of(self.context.state)

    @property
    def _order(self) -> str:
        """Order of the axes of H as stated in the project for this file."""
        return stated_order(self.context.state, self.context.state.psf)

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Show changed settings, and discard results of another H."""
        if old.psf != new.psf:
            self.follow()
        elif QualitySettings.of(old) != QualitySettings.of(new) or stated_order(old, old.psf) != self._order:
            self._show_state()
        self._take_judged()

    def follow(self) -> None:
        """Discard results of another H, or of a file that was replaced."""
        stamp = stamp_of(self.context.state.psf)
        if stamp != self._stamp:
            self._stamp = stamp
            self._release()
            self._take_judged()
        if self.view is not None:
            self.view.show_settings(self.settings)
        self._show_buttons()

    def entered(self) -> None:
        """Inspect H if this was not done yet."""
        self.follow()
        self.measure()

    def _release(self) -> None:
        """Discard the results of another H, and stop its inspection."""
        number, self._job = self._job, 0  # ignore its result
        if number:
            self.context.jobs.cancel(number)
        self.inspection, self._question, self._kept = None, None, InspectionRun()
        self.checks, self.chosen = (), None
        if self.view is not None:
            self.view.show_message("H has not been inspected yet.")

    def _take_judged(self) -> None:
        """Show the results of the background inspection of this H, unless there are others."""
        found = self.context.judged
        if found is None or self.inspection is not None or self._job or found.asked.stamp != self._stamp:
            return
        self.inspection, self._question = found.inspection, found.asked
        self._show()
        self._show_buttons()

    # -- choices ---------------------------------------------------------------------------------------
    def choose_fit(self, folder: str = "") -> None:
        """Choose the camera of a saved fit."""
        folder = folder or QFileDialog.getExistingDirectory(self._page, "Folder of a fit")
        if folder:
            settings = replace(self.settings, camera="saved", fit=folder)
            self.context.project.update("camera of a fit", settings=settings.into(self.context.state))

    # -- inspecting ------------------------------------------------------------------------------------
    def measure(self, *, force: bool = False) -> None:
        """Inspect H as a job: once per file, or again with ``force``.

        The job opens the file itself, because the window reads other planes.
        """
        if self._stamp is None or self._job or (self.inspection is not None and not force):
            return
        if stamp_of(self.context.state.psf) != self._stamp:  # written again meanwhile
            self.follow()
        if self._stamp is None:
            return
        asked = model_checks.asked_of(self._stamp, self.settings, self.context.fitted, self._order)
        self._kept, self._asked = InspectionRun(), asked
        kept = self._kept
        self._page.notice.clear()
        self._job = self.context.jobs.start(
            f"Inspect {asked.name}",
            self._page.spec.key,
            lambda: model_checks.iter_judge(asked, kept),
            kind="judge",
            abandon=True,
            leave=True,
            needs=(asked.stamp[0],),
        )
        waits = f"Inspect {asked.name}: {WAITS}"
        self._say(waits if self._job in self.context.jobs.waiting() else f"Inspecting {asked.name} …")
        self._show_buttons()

    def begin(self) -> None:
        """Inspect H again."""
        self.measure(force=True)

    def _say(self, words: str) -> None:
        if self.view is not None:
            self.view.show_message(words)

    def _job_changed(self, job: WindowJob) -> None:
        if job.number == self._job and job.progress is not None:
            record = job.progress
            self._say(f"{job.title}\n{capital(record.stage)}: {100 * record.fraction:.0f} %")

    def _job_finished(self, job: WindowJob) -> None:
        if job.number == self._report:
            self._report = 0
            self._show_buttons()
        if job.number != self._job:
            return
        self._job = 0
        why = "it was omitted" if job.state is JobState.DONE else job.error or "it was stopped"
        found = model_checks.judged(self._kept, why)
        self._kept = InspectionRun()
        if found is not None:
            self.inspection, self._question = found, self._asked
        if self.inspection is None:
            self._say(job.error or "Stopped.")
        else:
            if job.error:
                self._page.refuse(job.error if found is not None else f"{job.error}. Earlier results are shown")
            self._show()
        self._show_buttons()

    # -- showing ---------------------------------------------------------------------------------------
    @property
    def row_words(self) -> tuple[str, str]:
        """Name and state of the checks, for the inspector."""
        found, kept = self.inspection, kept_verdict(self.context.state)
        if found is None:
            failed = "not inspected" if kept is None else f"{kept.failed} failed" if kept.failed else "none failed"
            return self.title, "inspecting …" if self._job else failed
        return self.title, model_checks.count_words(found)

    def _show_buttons(self) -> None:
        self._page.show_levels()
        view, free = self.view, self._stamp is not None and not self._job
        if view is None:
            return
        redo = () if self.inspection is None else model_checks.worst_positions(self.inspection)
        view.redo.setText(f"Record {format_count(len(redo), 'position', 'positions')} again")
        view.redo.setVisible(bool(redo))
        view.report_button.setEnabled(free and not self._report)
        view.measure_button.setEnabled(free)

    def _show(self) -> None:
        found, asked = self.inspection, self._question
        if found is None or asked is None:
            return
        self.context.project.note(settings=with_verdict(self.context.state, asked.stamp, model_checks.kept_of(found)))
        self._page.show_map()
        view, before = self.view, self.chosen
        if view is None:
            return
        self.checks = model_checks.checks_of(found, every=view.every.isChecked())
        names = [check.title for check in self.checks]
        again = names.index(before.title) if before is not None and before.title in names else 0
        view.show_checks(model_checks.count_words(found), self.checks, again)
        self._show_state()

    def _show_state(self) -> None:
        """Show the settings, and whether the results were obtained with them."""
        view, found, asked = self.view, self.inspection, self._question
        if view is None:
            return
        view.show_settings(self.settings)
        if found is None or asked is None or self._stamp is None:
            return
        words = model_checks.summary_of(found, asked.source)
        now = model_checks.asked_of(self._stamp, self.settings, self.context.fitted, self._order)
        if now.choices != asked.choices:
            words += " The settings changed since this inspection; press Inspect again to use them."
        view.summary.setText(words)

    def _look_at(self, row: int) -> None:
        """Show a check: text, picture, and the plane with most of the affected positions."""
        view, found = self.view, self.inspection
        if view is None or found is None or not 0 <= row < len(self.checks):
            return
        self.chosen = check = self.checks[row]
        view.show_check(check.words, model_checks.picture_of(found, check))
        if check.plane is not None:
            self._page.set_intent(z=check.plane)
        self._page.show_map()

    def map_at(self, z: int) -> PositionMap | None:
        """Return the map of the selected check over the positions of a plane; None if there is none."""
        return (
            None
            if self.chosen is None or self.inspection is None
            else model_checks.map_of(self.inspection, self.chosen, z)
        )

    def error_at(self, z: int, worst: Iterable[Place], missing: NDArray[Any]) -> PositionMap | None:
        """Return the map of the errors of the positions of a plane (`error_map`); None if they are unknown."""
        return None if self.inspection is None else model_checks.error_map(self.inspection, z, worst, missing)

    # -- doing -----------------------------------------------------------------------------------------
    def deeds(self) -> dict[str, Callable[[], object]]:
        """Return the actions that the next step may request, by name."""
        return {"judge": lambda: self.measure(force=True), "why": self.show_worst, "worst": self.show_worst}

    def show_worst(self) -> None:
        """Show the checks, failed ones first, and select the first."""
        self.chosen = None
        self._page.look_into("checks")
        self._show()

    def redo(self) -> None:
        """Record the bad positions again in Record > Rig, which also makes and judges the new H."""
        if self.inspection is not None:
            self.context.project.update("positions to record again", redo=model_checks.worst_positions(self.inspection))
            self.context.go.emit("acquire", "redo")

    def write_report(self, folder: str = "") -> None:
        """Write the report as a job."""
        psf, asked = self.context.state.psf, not folder
        folder = folder or QFileDialog.getExistingDirectory(self._page, "Folder for the report")
        if not folder or not psf or (asked and not may_replace(self._page, model_checks.report_files(folder))):
            return
        order, asked_before = self._order, self._question
        same = stamp_of(psf) == self._stamp and asked_before is not None and asked_before.mat_order == order
        found = self.inspection if same else None
        self._report = self.context.jobs.start(
            "Report",
            self._page.spec.key,
            lambda: model_checks.iter_write_report(psf, folder, found, order),
            lambda page: self.context.message.emit(f"report written: {page}"),
            lambda job: self._page.notice.refuse(job.error),
            abandon=True,
            needs=(psf,),
            taken=self.context.taken("checks", "Report", folder, lambda: step(self.context.state, folder)),
        )
        self._show_buttons()

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        if self.view is not None:
            self.view.apply_theme()
            if not self._job:
                self._show()
