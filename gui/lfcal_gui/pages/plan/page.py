"""Plan: planes, cutout and order; the region on the lattice with the scan path; what it costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QFileDialog

from lfcal.base import LfcalError
from lfcal.camera import ScanPlan
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.jobs import WindowJob
from lfcal_gui.models import PageSpec, ProjectState
from lfcal_gui.pages.plan import takes
from lfcal_gui.pages.plan.model import apply_change, default_plan, half_of, list_beside, list_text
from lfcal_gui.pages.plan.model_target import OF_SCAN, PlannedTarget, PlanSettings, iter_target, read_plan
from lfcal_gui.pages.plan.panel import PlanPanel
from lfcal_gui.pages.plan.step import scan_step, target_step
from lfcal_gui.saving import ask_target, write_file

__all__ = ["Page"]


OPEN = "Go on with a plan that was saved before (.json): of a scan, or of a target"
SAVE = "Write this plan as JSON: to be opened here again, and for lfcal acquire and lfcal assemble"
DEFAULT = "Planes, cutout and anchor as the camera's geometry suggests: a start, to be changed"


class Page(BasePage):
    """Every change that passes is an undoable change of the project."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.tool_button("Open …", OPEN, self.open_file)
        self.tool_button("Save …", SAVE, self.save_file)
        self.tool_button("Default", DEFAULT, self.make_default)
        self.panel = PlanPanel(self._check)
        self.panel.edited.connect(self._edited)
        self._job = 0
        self._asked: tuple[ScanPlan, PlanSettings] | None = None
        target = self.panel.target
        target.follow(self._check_target, self._target_edited)
        target.plan_asked.connect(self.plan_target)
        target.stop_asked.connect(lambda: context.jobs.cancel(self._job))
        target.save_asked.connect(self.save_target)
        context.jobs.finished.connect(self._job_finished)
        self.set_panel(self.panel)
        self.theme_changed.connect(self.panel.apply_theme)
        self._show(context.state)

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Show the plan if it changed."""
        if old.plan != new.plan or old.camera != new.camera or PlanSettings.of(old) != PlanSettings.of(new):
            self._show(new)

    def let_go(self) -> None:
        """Plan no target for the project before."""
        self._forget_target()

    def _show(self, state: ProjectState) -> None:
        if state.plan is None:
            self._forget_target()
            self.show_empty(
                "No plan yet for this camera.\nThe plan says where the point source goes and what it costs.",
                {"Make a plan": (DEFAULT, self.make_default), "Open a plan …": (OPEN, self.open_file)},
            )
            return
        self.show_body()
        self.panel.show_plan(state.plan, PlanSettings.of(state))
        if self._asked != (state.plan, PlanSettings.of(state)):
            self._forget_target()
        self._show_target()

    def _check(self, key: str, value: Any) -> str:
        state = self.context.state
        if state.plan is None:
            return ""
        if key in OF_SCAN:
            return self._check_target(key, value) or (_refused_half(state.plan) if key == "half_cell" and value else "")
        plan, why = apply_change(state.plan, key, value)
        if plan is not None and PlanSettings.of(state).half_cell and not _refused_half(state.plan):
            why = _refused_half(plan)
        return why or self.context.project.held(replace(state, plan=plan))

    def _edited(self, key: str, value: Any) -> None:
        if key in OF_SCAN:
            self._target_edited(key, value)
            return
        plan = self.context.state.plan
        changed = None if plan is None else apply_change(plan, key, value)[0]
        if changed is not None:
            self.context.project.merge(f"change of {key.replace('_', ' ')}", plan=changed)

    # -- target ----------------------------------------------------------------------------------------
    def _check_target(self, key: str, value: Any) -> str:
        state = self.context.state
        try:
            settings = PlanSettings.of(state).changed(key, value).into(state)
        except LfcalError as error:
            return str(error)
        return self.context.project.held(replace(state, settings=settings))

    def _target_edited(self, key: str, value: Any) -> None:
        state = self.context.state
        settings = PlanSettings.of(state).changed(key, value).into(state)
        self.context.project.merge(f"change of {key.replace('_', ' ')}", settings=settings)

    def _show_target(self) -> None:
        self.panel.target.show_settings(PlanSettings.of(self.context.state), busy=bool(self._job))

    def _forget_target(self) -> None:
        """Show no plan of a target that was made for other values, and look for none."""
        job, self._job, self._asked = self._job, 0, None
        self.context.jobs.cancel(job)
        self.panel.target.show_planned(None)

    def plan_target(self) -> None:
        """Look for the frames as a job."""
        state = self.context.state
        plan, settings = state.plan, PlanSettings.of(state)
        if plan is None or not settings.many:
            self.refuse("there is no target to plan; make a plan, and type a source such as array")
            return
        self._forget_target()
        # else the value before it would be planned with
        if refused := self.panel.target.form.error or self.panel.target.more.error:
            self.panel.target.show_refusal(refused)
            return
        self._asked = asked = (plan, settings)

        def done(found: PlannedTarget) -> None:
            if self._asked is asked:
                self.panel.target.show_planned(found)

        self._job = self.context.jobs.start(
            f"Plan {settings.source}", "plan", lambda: iter_target(plan, settings), done, leave=True, at_once=True
        )
        self._show_target()

    def _job_finished(self, job: WindowJob) -> None:
        if job.number != self._job:
            return
        self._job = 0
        self._show_target()
        if job.error:
            self.panel.target.show_refusal(job.error)

    def save_target(self, path: str = "") -> None:
        """Write the plan of the target as JSON."""
        found, state = self.panel.target.found, self.context.state
        if found is None:
            self.refuse("there is no target plan to save; press Plan target first")
            return
        path = path or ask_target(self, "Save target plan", "target_plan.json", "Plans (*.json)")
        text = found.plan.to_json()
        if path and write_file(self, path, lambda part: part.write_text(text, encoding="utf-8")):
            title = f"Save target plan {Path(path).name}"
            self.context.history.add(self.context.taken("plan", title, step=lambda: target_step(state, path)))
            self.context.message.emit(f"target plan saved as {path}: record it on page Acquire, by Target …")

    # -- files -----------------------------------------------------------------------------------------
    def make_default(self) -> None:
        """Make the plan that the camera's geometry suggests."""
        try:
            self.context.project.update("default plan", plan=default_plan(self.context.state.camera))
        except LfcalError as error:
            self.refuse(str(error))

    def open_file(self, path: str = "") -> None:
        """Take a plan, and its camera, from a file."""
        path = path or QFileDialog.getOpenFileName(self, "Open plan", "", "Plans (*.json)")[0]
        if not path:
            return
        name = Path(path).name

        def refused(words: str) -> None:
            self.refuse(words if name in words else f"{name}: {words}")

        settings = PlanSettings.of(self.context.state)
        self.load(name, lambda: read_plan(path, settings), lambda found: self._opened(name, found), on_error=refused)

    def _opened(self, name: str, found: ScanPlan | PlannedTarget) -> None:
        """Go on with a scan's plan, or with a target's and the scan that it stands for."""
        if isinstance(found, ScanPlan):
            self.context.project.update(f"plan {name}", plan=found, camera=found.camera)
            return
        state, scan = self.context.state, found.plan.scan
        settings = PlanSettings.of_plan(found.plan).at_rates_of(PlanSettings.of(state))
        self._forget_target()
        self._asked = (scan, settings)
        self.context.project.update(f"target plan {name}", plan=scan, camera=scan.camera, settings=settings.into(state))
        self.panel.target.show_planned(found)
        self._show_target()
        self.panel.tabs.setCurrentWidget(self.panel.target)

    def save_file(self, path: str = "") -> None:
        """Write the plan as JSON."""
        state, plan = self.context.state, self.context.state.plan
        if plan is None:
            self.refuse("there is no plan to save; make or open one first")
            return
        try:
            half = half_of(plan) if PlanSettings.of(state).half_cell else None
        except LfcalError as error:
            self.refuse(str(error))
            return

        def files(target: str | Path) -> dict[Path, str]:
            """Return what is written, by file."""
            listed = {} if half is None else {list_beside(target): list_text(half)}
            return {Path(target): plan.to_json(), **listed}

        path = path or ask_target(self, "Save plan", "plan.json", "Plans (*.json)", lambda target: list(files(target)))
        if path and all(write_file(self, str(file), _writing(text)) for file, text in files(path).items()):
            self.context.history.add(
                self.context.taken("plan", f"Save plan {Path(path).name}", path, lambda: scan_step(state, path))
            )
            chosen = "" if half is None else f", and {list_beside(path).name} for Positions on page Acquire"
            self.context.message.emit(f"plan saved as {path}{chosen}")

    def accept_drop(self, paths: list[str]) -> bool:
        """Take a dropped plan."""
        if len(paths) == 1 and takes(paths[0]):
            self.open_file(paths[0])
            return True
        return False


def _refused_half(plan: ScanPlan) -> str:
    """Return why half of the period is not enough; empty: it is."""
    try:
        half_of(plan)
    except LfcalError as error:
        return str(error)
    return ""


def _writing(text: str) -> Callable[[Path], object]:
    return lambda part: part.write_text(text, encoding="utf-8")
