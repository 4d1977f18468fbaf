"""Plan: planes, cutout and order; the region on the lattice with the scan path; what it costs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QFileDialog

from gui.base_page import BasePage
from gui.context import Context
from gui.models.page import PageSpec
from gui.models.project import ProjectState
from gui.pages.plan import takes
from gui.pages.plan.model import apply_change, default_plan
from gui.pages.plan.panel import PlanPanel
from gui.saving import ask_target, write_file
from lfcal.camera import ScanPlan
from lfcal.errors import LfcalError
from lfcal.files import read_text

__all__ = ["Page"]


OPEN = "Go on with a plan that was saved before (.json), of this camera"
DEFAULT = "Planes, cutout and anchor as the camera's geometry suggests: a start, to be changed"


class Page(BasePage):
    """Every change that passes is an undoable change of the project."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.tool_button("Open …", OPEN, self.open_file)
        self.tool_button("Save …", "Write this plan as JSON, for lfcal acquire and lfcal assemble", self.save_file)
        self.tool_button("Default", DEFAULT, self.make_default)
        self.panel = PlanPanel(self._check)
        self.panel.edited.connect(self._edited)
        self.set_panel(self.panel)
        self.theme_changed.connect(self.panel.apply_theme)
        self._show(context.state)

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Show the plan if it changed."""
        if old.plan != new.plan or old.camera != new.camera:
            self._show(new)

    def _show(self, state: ProjectState) -> None:
        if state.plan is None:
            self.show_empty(
                "No plan yet for this camera.\nThe plan says where the point source goes and what it costs.",
                {"Make a plan": (DEFAULT, self.make_default), "Open a plan …": (OPEN, self.open_file)},
            )
            return
        self.show_body()
        self.panel.show_plan(state.plan)

    def _check(self, key: str, value: Any) -> str:
        state = self.context.state
        if state.plan is None:
            return ""
        plan, why = apply_change(state.plan, key, value)
        return why or self.context.project.held(replace(state, plan=plan))

    def _edited(self, key: str, value: Any) -> None:
        plan = self.context.state.plan
        changed = None if plan is None else apply_change(plan, key, value)[0]
        if changed is not None:
            self.context.project.merge(f"change of {key.replace('_', ' ')}", plan=changed)

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
        self.load(
            name,
            lambda: ScanPlan.from_json(read_text(path)),
            lambda plan: self.context.project.update(f"plan {name}", plan=plan, camera=plan.camera),
        )

    def save_file(self, path: str = "") -> None:
        """Write the plan as JSON."""
        plan = self.context.state.plan
        if plan is None:
            self.refuse("there is no plan to save; make or open one first")
            return
        path, text = path or ask_target(self, "Save plan", "plan.json", "Plans (*.json)"), plan.to_json()
        if path and write_file(self, path, lambda part: part.write_text(text, encoding="utf-8")):
            self.context.history.add(self.context.taken("plan", f"Save plan {Path(path).name}", path))
            self.context.message.emit(f"plan saved as {path}")

    def accept_drop(self, paths: list[str]) -> bool:
        """Take a dropped plan."""
        if len(paths) == 1 and takes(paths[0]):
            self.open_file(paths[0])
            return True
        return False
