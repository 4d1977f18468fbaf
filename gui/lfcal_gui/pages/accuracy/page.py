"""Accuracy: error against cost in each step. The chart fills during the measurement; a click applies a setting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lfcal.accuracy import PARTS, Curve
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.jobs import JobState, WindowJob
from lfcal_gui.models import PageSpec, ProjectState, iter_measure, subject_of
from lfcal_gui.pages.accuracy.model import AccuracySettings, in_use, subjects, use_of
from lfcal_gui.pages.accuracy.panel import AccuracyPanel


class Page(BasePage):
    """Page that measures accuracy against cost for the plan or H.

    It keeps all measured curves, including those of a stopped measurement.
    """

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.kept = context.curves
        self._key: object = None
        self._job = 0
        self._used: tuple[str, str] = ("", "")
        self._shown: Curve | None = None
        self.all_button = self.tool_button(
            "Measure all",
            "Measure all parts of the processing, one after the other",
            lambda: self.measure(PARTS.names()),
        )
        self.stop_button = self.stop_tool("Stop measuring, and keep what was measured")
        self.panel = AccuracyPanel()
        context.let_edit(self.panel.form, lambda: self.settings, "accuracy:")
        self.panel.part_asked.connect(lambda name: context.edit(self.settings, "part", name, "accuracy:"))
        self.panel.point_chosen.connect(self.use)
        self.panel.chart.moved.connect(lambda error: context.edit(self.settings, "error", error, "accuracy:"))
        self.panel.chart.measure_asked.connect(self.measure)
        self.measure_button = self.panel.chart.measure_button
        self.set_panel(self.panel)
        self.shortcut("F5", self.measure)
        self.theme_changed.connect(self._apply_theme)
        context.jobs.changed.connect(self._job_changed)
        context.jobs.finished.connect(self._job_finished)
        self._show(context.state)

    @staticmethod
    def prepare() -> None:
        """Find the installed parts."""
        PARTS.names()

    # -- project ---------------------------------------------------------------------------------------
    @property
    def settings(self) -> AccuracySettings:
        """The user's settings; a subject that the project lacks is replaced by one that it has."""
        settings, there = AccuracySettings.of(self.context.state), subjects(self.context.state)
        return settings if settings.subject in there or not there else replace(settings, subject=there[0])

    @property
    def curve(self) -> Curve | None:
        """The measured curve of the selected part; None if there is none."""
        return self.kept.of(self._key).get(self.settings.part)

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Update the page if settings, plan or H changed."""
        changed = (old.plan, old.psf) != (new.plan, new.psf)
        if changed or AccuracySettings.of(old) != AccuracySettings.of(new):
            self._show(new)

    # -- showing ---------------------------------------------------------------------------------------
    def _show(self, state: ProjectState) -> None:
        there = subjects(state)
        self.all_button.setEnabled(bool(there) and not self._job)
        if not there:
            self.show_empty(
                "Nothing to measure yet\n"
                "Accuracy is measured for a scan plan, or for H. Make a plan first, or open an H file.",
                {
                    "Go to Set up": self.lead("setup", "Choose the source positions and depth planes of the scan"),
                    "Go to H": self.lead("h", "Open an H that was assembled, simulated or fitted earlier"),
                },
            )
            return
        self.show_body()
        settings = self.settings
        key = subject_of(state, settings.subject)
        if key != self._key:  # curves of another plan or H say nothing of this one
            self.stop()
            self._key = key
        self.panel.show_settings(settings, there)
        self._show_curve()

    def _show_curve(self) -> None:
        settings = self.settings
        running = self._running()
        # points are numbered in the curve that is on screen, not in the one that has grown meanwhile
        self._shown = self.curve
        self.panel.show_measured(self.kept.of(self._key), running)
        took = self.kept.took(self._key, settings.part)
        used = None if self._shown is None else in_use(self.context.state, self._shown)
        self.panel.show_curve(self._shown, settings, took, used, running=running == settings.part)
        part, words = self._used
        self.panel.show_used(words if part == settings.part else "")

    def _running(self) -> str:
        """Return the part that is being measured: the one started last."""
        begun = list(self.kept.of(self._key))
        return (begun[-1] if begun else self.settings.part) if self._job else ""

    # -- measuring -------------------------------------------------------------------------------------
    def measure(self, parts: Sequence[str] = ()) -> None:
        """Measure parts as a job; by default the selected part."""
        state, settings = self.context.state, self.settings
        chosen = tuple(parts) or (settings.part,)
        if self._job or not subjects(state) or settings.part not in PARTS:
            return
        kept = self.kept
        kept.forget(self._key, chosen)
        self._used = ("", "")
        title = PARTS.get(chosen[0]).title if len(chosen) == 1 else "What accuracy costs"
        self._job = self.context.jobs.start(
            title,
            "accuracy",
            lambda: iter_measure(state, settings.subject, settings.seconds, chosen, kept),
            None,
            self._failed,
            abandon=settings.subject == "psf",
        )
        self._show(state)

    def _failed(self, job: WindowJob) -> None:
        self.refuse(job.error)

    def _job_changed(self, job: WindowJob) -> None:
        if job.number == self._job and job.state is JobState.RUNNING:
            self._show_curve()

    def _job_finished(self, job: WindowJob) -> None:
        if job.number == self._job:
            self._job = 0
            self._show(self.context.state)

    # -- using -----------------------------------------------------------------------------------------
    def use(self, number: int) -> None:
        """Apply a measured setting to the page that has it, or report why this is not possible."""
        curve = self._shown
        if curve is None or not 0 <= number < len(curve.points):
            return
        point = curve.points[number]
        use = use_of(self.context.state, curve, point)
        if use.changes is not None:
            key = self._key
            seconds = self.kept.curves[key, curve.part][1]
            if not self.context.project.update(use.label, **use.changes):
                return
            if self._key != key and curve.part in ("planes", "averaging", "recording"):
                # the plan is the point's now: the curve that it was chosen from stays
                self.kept.put(self._key, curve, seconds)
        self._used = (curve.part, f"{point.label}. {use.words}")
        self.context.message.emit(self._used[1])
        self._show(self.context.state)

    def _apply_theme(self) -> None:
        self.panel.apply_theme()
        self._show_curve()
