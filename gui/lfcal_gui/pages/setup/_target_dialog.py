"""A dialog for a target of many points: planned as a job, and saved."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QDialog, QVBoxLayout, QWidget

from lfcal.base import LfcalError
from lfcal.camera import ScanPlan
from lfcal_gui.context import Context
from lfcal_gui.jobs import WindowJob
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.setup._target_panel import TargetPanel
from lfcal_gui.pages.setup.model_target import PlannedTarget, PlanSettings, iter_target
from lfcal_gui.pages.setup.step import target_step
from lfcal_gui.saving import ask_target, write_file
from lfcal_gui.widgets import name_controls

__all__ = ["TargetDialog", "change_settings", "refused_setting"]


def refused_setting(context: Context, key: str, value: Any) -> str:
    """Return why a setting of the plan cannot have a value; empty: it can."""
    state = context.state
    try:
        settings = PlanSettings.of(state).changed(key, value).into(state)
    except LfcalError as error:
        return str(error)
    return context.project.held(replace(state, settings=settings))


def change_settings(context: Context, key: str, value: Any) -> None:
    """Change a setting of the plan."""
    state = context.state
    settings = PlanSettings.of(state).changed(key, value).into(state)
    context.project.merge(f"change of {key.replace('_', ' ')}", settings=settings)


class TargetDialog(QDialog):
    """What is asked for of a target, and its plan; of other values than those of now it shows none."""

    def __init__(self, parent: QWidget, context: Context) -> None:
        super().__init__(parent)
        self.setWindowTitle("Target of many points")
        self.resize(980, 560)
        self.context = context
        self.panel = TargetPanel()
        self._job = 0
        self._asked: tuple[ScanPlan, PlanSettings] | None = None
        QVBoxLayout(self).addWidget(self.panel)
        name_controls(self)
        self.panel.follow(
            lambda *given: refused_setting(context, *given), lambda *given: change_settings(context, *given)
        )
        self.panel.plan_asked.connect(self.plan_target)
        self.panel.stop_asked.connect(lambda: context.jobs.cancel(self._job))
        self.panel.save_asked.connect(self.save_target)
        context.jobs.finished.connect(self._job_finished)
        self.show_state(context.state)

    def show_state(self, state: ProjectState) -> None:
        """Show what is asked for, and no plan that was made for other values."""
        if self._asked != (state.plan, PlanSettings.of(state)):
            self.forget()
        self._show()

    def _show(self) -> None:
        self.panel.show_settings(PlanSettings.of(self.context.state), busy=bool(self._job))

    def forget(self) -> None:
        """Show no plan, and stop looking for one."""
        job, self._job, self._asked = self._job, 0, None
        self.context.jobs.cancel(job)
        self.panel.show_planned(None)

    def plan_target(self) -> None:
        """Look for the frames as a job."""
        plan, settings = self.context.state.plan, PlanSettings.of(self.context.state)
        if plan is None or not settings.many:
            self.panel.show_refusal("there is no target to plan; make a plan, and type a source such as array")
            return
        self.forget()
        # else the value before it would be planned with
        if refused := self.panel.form.error:
            self.panel.show_refusal(refused)
            return
        self._asked = asked = (plan, settings)

        def done(found: PlannedTarget) -> None:
            if self._asked is asked:
                self.panel.show_planned(found)

        self._job = self.context.jobs.start(
            f"Plan {settings.source}", "setup", lambda: iter_target(plan, settings), done, leave=True, at_once=True
        )
        self._show()

    def _job_finished(self, job: WindowJob) -> None:
        if job.number != self._job:
            return
        self._job = 0
        self._show()
        if job.error:
            self.panel.show_refusal(job.error)

    def expect(self, scan: ScanPlan, settings: PlanSettings) -> None:
        """Keep what is shown next as the plan of these values."""
        self.forget()
        self._asked = (scan, settings)

    def show_opened(self, found: PlannedTarget) -> None:
        """Show a plan from a file."""
        self.panel.show_planned(found)
        self._show()
        self.show()

    def save_target(self, path: str = "") -> None:
        """Write the plan of the target as JSON."""
        found, state = self.panel.found, self.context.state
        if found is None:
            self.panel.show_refusal("there is no target plan to save; press Plan target first")
            return
        path = path or ask_target(self, "Save target plan", "target_plan.json", "Plans (*.json)")
        text = found.plan.to_json()
        if path and write_file(self, path, lambda part: part.write_text(text, encoding="utf-8")):
            title = f"Save target plan {Path(path).name}"
            self.context.history.add(self.context.taken("setup", title, step=lambda: target_step(state, path)))
            self.context.message.emit(f"target plan saved as {path}: record it in Record > Rig, by Target …")
