"""Quality: is the PSF good, what is wrong if not, and what to record again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from PySide6.QtWidgets import QFileDialog

from lfcal.base import InputError, format_count
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.jobs import WAITS, JobState, WindowJob
from lfcal_gui.models import PageSpec, ProjectState, Stamp, capital, stamp_of, stated_order, with_verdict
from lfcal_gui.pages.quality._comparing import ProjectComparing
from lfcal_gui.pages.quality._showing import Showing
from lfcal_gui.pages.quality.model import (
    QualitySettings,
    count_words,
    fault_rows,
    kept_of,
    metric_rows,
    summary_of,
    worst_positions,
)
from lfcal_gui.pages.quality.model_run import (
    InspectionRequest,
    InspectionRun,
    asked_of,
    iter_judge,
    iter_write_report,
    judged,
    report_files,
)
from lfcal_gui.pages.quality.panel import QualityPanel
from lfcal_gui.saving import may_replace

if TYPE_CHECKING:
    from lfcal.judge import Inspection

__all__ = ["Page"]


INSPECT = "Measure H again, and compare it with its camera (F5)"


class Page(BasePage):
    """Judges H once when the page is looked at, and whenever it is asked to; keeps what it found until H changes."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.inspection: Inspection | None = None
        self._stamp: Stamp | None = None
        self._asked: InspectionRequest | None = None
        self._question: InspectionRequest | None = None
        self._kept = InspectionRun()
        self._job = self._report = 0
        self._make_buttons()
        self.panel = QualityPanel()
        inspect = self.panel.inspect
        self.showing = Showing(inspect, context)
        self.comparing = ProjectComparing(self.panel.compare, context)
        inspect.form.check = self._check
        inspect.edited.connect(self._edited)
        inspect.folder_asked.connect(self.choose_fit)
        inspect.every_toggled.connect(lambda on: self._show())
        inspect.redo.clicked.connect(lambda: self.redo())
        self.set_panel(self.panel)
        self.shortcut("F5", self.begin)
        self.theme_changed.connect(self._apply_theme)
        context.fitted_changed.connect(self._show_state)
        context.jobs.changed.connect(self._job_changed)
        context.jobs.finished.connect(self._job_finished)
        self._follow()

    def _make_buttons(self) -> None:
        self.report_button = self.tool_button(
            "Write report …",
            "Keep what was found: an HTML page with all figures, and JSON for programs",
            self.write_report,
        )
        self.stop_button = self.stop_tool("Stop; what was found so far stays")
        self.measure_button = self.tool_button("Inspect", INSPECT, lambda: self.measure(force=True))

    # -- project ---------------------------------------------------------------------------------------
    @property
    def settings(self) -> QualitySettings:
        """What the user chose."""
        return QualitySettings.of(self.context.state)

    def deeds(self) -> dict[str, Callable[[], object]]:
        """Return what the next step may ask for."""
        return {"judge": lambda: self.measure(force=True), "why": self._show_worst, "worst": self._show_worst}

    def _show_worst(self) -> None:
        """Show what is wrong with H, the worst first."""
        self.panel.setCurrentWidget(self.panel.inspect)
        self._show()

    def let_go(self) -> None:
        """Forget what was compared in another project."""
        self.comparing.let_go()

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Let go of what belongs to another H."""
        orders = [[stated_order(state, path) for path in (new.psf, new.reference)] for state in (old, new)]
        if (old.psf, old.reference) != (new.psf, new.reference) or orders[0] != orders[1]:
            self.comparing.follow()
        if old.psf != new.psf:
            self._follow()
        elif QualitySettings.of(old) != QualitySettings.of(new) or stated_order(old, old.psf) != self._order:
            self._show_state()
        self._take_judged()

    def _take_judged(self) -> None:
        """Show what was found of this H in the background, if nothing else is known of it."""
        found = self.context.judged
        if found is None or self.inspection is not None or self._job or found.asked.stamp != self._stamp:
            return
        self.inspection, self._question = found.inspection, found.asked
        self._show()
        self._show_buttons()

    def entered(self) -> None:
        """Look whether the file of H is still the one that was judged, and judge it when it never was."""
        self._follow()
        self.comparing.follow()
        self.measure()

    def _check(self, key: str, value: Any) -> str:
        try:
            self._with(key, value)
        except InputError as error:
            return str(error)
        return ""

    def _with(self, key: str, value: Any) -> QualitySettings:
        changed: dict[str, Any] = {key: "" if value is None else value}
        return replace(self.settings, **changed)

    def _edited(self, key: str, value: Any) -> None:
        settings = self._with(key, value)
        self.context.project.merge(f"quality: {key}", settings=settings.into(self.context.state))

    def choose_fit(self, folder: str = "") -> None:
        """Take the camera of a saved fit."""
        folder = folder or QFileDialog.getExistingDirectory(self, "Folder of a fit")
        if folder:
            settings = replace(self.settings, camera="saved", fit=folder)
            self.context.project.update("camera of a fit", settings=settings.into(self.context.state))

    def _follow(self) -> None:
        """Show what belongs to the H of now; what belongs to another, or to another file of its name, is let go."""
        stamp = stamp_of(self.context.state.psf)
        if stamp != self._stamp:
            self._stamp = stamp
            self._release()
            self._take_judged()
        self.panel.inspect.show_settings(self.settings)
        self._show_buttons()
        if stamp is None:
            self.show_empty(
                "No PSF to judge yet.\nAssemble frames, or open an H file on the PSF page.",
                {
                    "Folder": self.lead("frames", "Make H of recorded frames"),
                    "PSF": self.lead("psf", "Open an H that was assembled, simulated or fitted before"),
                },
            )
        elif self.inspection is None and not self._job:
            self.show_empty("H has not been inspected yet.", {"Inspect": (INSPECT, self.measure)})
            if self.isVisible():
                self.measure()

    def _release(self) -> None:
        """Forget what was found of another H, and stop what is at work on it."""
        number, self._job = self._job, 0  # whose end is of no interest any more
        if number:
            self.context.jobs.cancel(number)
        self.inspection, self._question, self._kept = None, None, InspectionRun()
        self.showing.release()
        self.notice.clear()
        self.context.attention.emit("quality", False)

    @property
    def _order(self) -> str:
        """The order of the axes of H that the project states for its file."""
        return stated_order(self.context.state, self.context.state.psf)

    # -- inspecting ------------------------------------------------------------------------------------
    def measure(self, *, force: bool = False) -> None:
        """Inspect H as a job, once per file; the job opens it for itself, as other pages read other planes."""
        if self._stamp is None or self._job or (self.inspection is not None and not force):
            return
        if stamp_of(self.context.state.psf) != self._stamp:  # written anew meanwhile
            self._follow()
            return
        asked = asked_of(self._stamp, self.settings, self.context.fitted, self._order)
        self._kept, self._asked = InspectionRun(), asked
        kept = self._kept
        self.hold_keyboard()
        self.notice.clear()
        self.show_empty(
            f"Inspecting {asked.name} …", {"Stop (Esc)": ("Inspect no further; what was known before stays", self.stop)}
        )
        self._job = self.context.jobs.start(
            f"Inspect {asked.name}",
            "quality",
            lambda: iter_judge(asked, kept),
            kind="judge",
            abandon=True,
            leave=True,
            needs=(asked.stamp[0],),
        )
        if self._job in self.context.jobs.waiting() and self.empty is not None:
            self.empty.label.setText(f"Inspect {asked.name}: {WAITS}")
        self._show_buttons()

    def begin(self) -> None:
        """Inspect H again, or compare it with another, whichever is looked at."""
        if self.panel.currentWidget() is self.panel.compare:
            self.comparing.compare()
        else:
            self.measure(force=True)

    def _job_changed(self, job: WindowJob) -> None:
        if job.number == self._job and job.progress is not None and self.empty is not None:
            record = job.progress
            self.empty.label.setText(f"{job.title}\n{capital(record.stage)}: {100 * record.fraction:.0f} %")

    def _job_finished(self, job: WindowJob) -> None:
        if job.number == self._report:
            self._report = 0
            self._show_buttons()
        if job.number != self._job:
            return
        self._job = 0
        why = "it was left out" if job.state is JobState.DONE else job.error or "it was stopped"
        found = judged(self._kept, why)
        self._kept = InspectionRun()
        if found is not None:
            self.inspection, self._question = found, self._asked
        if self.inspection is None:
            self.show_empty(job.error or "Stopped.", {"Try again": (INSPECT, lambda: self.measure(force=True))})
        else:
            if job.error:
                self.refuse(job.error if found is not None else f"{job.error}. Shown is what was found before")
            self._show()
        self._show_buttons()

    # -- showing ---------------------------------------------------------------------------------------
    def _show_buttons(self) -> None:
        redo = () if self.inspection is None else worst_positions(self.inspection)
        button = self.panel.inspect.redo
        button.setText(f"Record {format_count(len(redo), 'position', 'positions')} again")
        button.setVisible(bool(redo))
        self.report_button.setEnabled(self._stamp is not None and not self._job and not self._report)
        self.measure_button.setEnabled(self._stamp is not None and not self._job)

    def _show(self) -> None:
        found, asked = self.inspection, self._question
        if found is None or asked is None:
            return
        self.show_body()
        verdict = kept_of(found)
        self.context.attention.emit("quality", not verdict.usable)
        self.context.project.note(settings=with_verdict(self.context.state, asked.stamp, verdict))
        inspect = self.panel.inspect
        every = inspect.every.isChecked()
        self.showing.start(found, every=every)
        inspect.counts.setText(count_words(found))
        words = self._summary(found, asked)
        inspect.show_all(found.verdict, found.merit, words, fault_rows(found), metric_rows(found, every=every))

    def _summary(self, found: Inspection, asked: InspectionRequest) -> str:
        words = summary_of(found, asked.source)
        if self._stamp is not None:
            now = asked_of(self._stamp, self.settings, self.context.fitted, self._order)
            if now.choices != asked.choices:
                words += " Choices changed since: press Inspect to use them."
        return words

    def _show_state(self) -> None:
        """Show the choices, and whether what is shown was found with them."""
        inspect = self.panel.inspect
        inspect.show_settings(self.settings)
        if self.inspection is not None and self._question is not None:
            inspect.summary.setText(self._summary(self.inspection, self._question))

    # -- doing -----------------------------------------------------------------------------------------
    def redo(self) -> None:
        """Record the bad positions again in Record > Rig, which also makes and judges the new H."""
        if self.inspection is not None:
            self.context.project.update("positions to record again", redo=worst_positions(self.inspection))
            self.context.go.emit("acquire", "redo")

    def write_report(self, folder: str = "") -> None:
        """Write the report as a job."""
        psf, asked = self.context.state.psf, not folder
        folder = folder or QFileDialog.getExistingDirectory(self, "Folder for the report")
        if not folder or not psf or (asked and not may_replace(self, report_files(folder))):
            return
        order, asked_before = self._order, self._question
        same = stamp_of(psf) == self._stamp and asked_before is not None and asked_before.mat_order == order
        found = self.inspection if same else None
        self._report = self.context.jobs.start(
            "Report",
            "quality",
            lambda: iter_write_report(psf, folder, found, order),
            lambda page: self.context.message.emit(f"report written: {page}"),
            lambda job: self.notice.refuse(job.error),
            abandon=True,
            needs=(psf,),
            taken=self.context.taken("quality", "Report", folder),
        )
        self._show_buttons()

    def _apply_theme(self) -> None:
        inspect = self.panel.inspect
        tables = (inspect.faults, inspect.table)
        chosen = [table.chosen() for table in tables]
        self.panel.apply_theme()
        if not self._job:
            self._show()
        for table, number in zip(tables, chosen, strict=True):
            table.choose(number)  # drawn anew they begin with the first row
