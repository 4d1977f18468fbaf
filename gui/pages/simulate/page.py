"""Simulate: only the effects the scene calls for, and what accuracy costs in time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gui.base_page import BasePage
from gui.context import Context
from gui.models.page import PageSpec
from gui.models.project import ProjectState
from gui.pages.simulate.model import (
    SimulateSettings,
    Verdict,
    depth_of,
    iter_simulation,
    preview,
    preview_words,
    verdict_of,
)
from gui.pages.simulate.panel import SimulatePanel
from gui.saving import ask_target
from lfcal.camera import ScanPlan

__all__ = ["Page"]


class Page(BasePage):
    """Asks the planner after every change; what it answered to an earlier question is never used."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.verdict: Verdict | None = None
        self.tool_button("Measure accuracy", "Time and error of every level and sampling for this camera", self.ladder)
        self.tool_button("Simulate H …", "Compute the whole H of the plan as a job", self.simulate, primary=True)
        self.panel = SimulatePanel()
        self.panel.tolerance_asked.connect(self._set_tolerance)
        self.panel.level_asked.connect(self._set_level)
        self.panel.choice_asked.connect(self._set_choice)
        self.panel.depth_moved.connect(lambda: self._preview(fine=False))
        self.set_panel(self.panel)
        context.theme_changed.connect(self._apply_theme)
        self._show(context.state)

    # -- project ---------------------------------------------------------------------------------------
    @property
    def settings(self) -> SimulateSettings:
        """What the user chose."""
        return SimulateSettings.of(self.context.state)

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Ask the planner again if plan or settings changed."""
        if old.plan != new.plan or SimulateSettings.of(old) != SimulateSettings.of(new):
            self._show(new)

    def _show(self, state: ProjectState) -> None:
        if state.plan is None:
            self.show_empty(
                "The simulation needs a scan plan: which positions, planes and cutout.",
                {"Plan": lambda: self.context.go.emit("plan", None)},
            )
            return
        self.show_body()
        settings, plan = self.settings, state.plan
        self.panel.show_settings(settings)
        self.context.jobs.compute(
            "simulate plan", lambda: verdict_of(plan, settings), self._planned, self.context.message.emit
        )

    def _set_tolerance(self, tolerance: float) -> None:
        settings = replace(self.settings, tolerance=tolerance)
        self.context.project.merge("tolerance", settings=settings.into(self.context.state))

    def _set_level(self, level: str) -> None:
        settings = replace(self.settings, level=level)
        self.context.project.update("level of simulation", settings=settings.into(self.context.state))

    def _set_choice(self, effect: str, choice: str) -> None:
        settings = self.settings.with_override(effect, choice)
        self.context.project.update(f"choice for {effect}", settings=settings.into(self.context.state))

    # -- planner and preview ---------------------------------------------------------------------------
    def _planned(self, verdict: Verdict) -> None:
        self.verdict = verdict
        self.panel.show_verdict(verdict)
        self._preview(fine=True)

    def _answer(self) -> Verdict | None:
        """Return the planner's answer to what is asked now, None while it is still at work."""
        fits = self.verdict is not None and self.verdict.fits(self.context.state.plan, self.settings)
        return self.verdict if fits else None

    def _preview(self, *, fine: bool) -> None:
        """Show rays at once; when nothing newer came, the chosen level with the effects the planner has on."""
        plan, verdict, settings = self.context.state.plan, self._answer(), self.settings
        if plan is None or (fine and verdict is None):  # the planner's answer brings the fine preview
            return
        z = depth_of(plan, self.panel.z_slider.value())
        level = settings.level if fine else "geometric"
        effects = verdict.effects if fine and verdict is not None else ()
        self.panel.preview_label.setText(preview_words(plan, z, settings.level if fine else ""))
        self.context.jobs.compute(
            "simulate preview",
            lambda: preview(plan, z, effects, level, settings.tolerance),
            lambda image: self._previewed(image, plan, settings, fine),
            self.panel.preview_label.setText,
        )

    def _previewed(self, image: NDArray[np.float32], plan: ScanPlan, settings: SimulateSettings, fine: bool) -> None:
        if (plan, settings) != (self.context.state.plan, self.settings):
            return  # of an earlier question; the planner's answer brings the next
        self.panel.show_preview(image)
        if not fine:
            self._preview(fine=True)

    # -- work --------------------------------------------------------------------------------------------
    def simulate(self, path: str = "") -> None:
        """Simulate the whole H as a job, with plan and settings as they are now."""
        plan, settings, verdict = self.context.state.plan, self.settings, self._answer()
        if plan is None:
            return
        path = path or ask_target(self, "Simulate H", "simulated.h5", "H file (*.h5)")
        if not path:
            return
        self.context.start_writing(
            f"Simulate {Path(path).name}",
            "simulate",
            path,
            lambda: iter_simulation(plan, settings, path, verdict),
            self._simulated,
        )

    def _simulated(self, matrix: Any) -> None:
        path = matrix.path
        matrix.close()
        self.context.message.emit(f"simulated {path}")
        changes = {"reference": path} if self.context.state.psf else {"psf": path, "reference": path}
        self.context.project.update("simulation", **changes)

    def ladder(self) -> None:
        """Measure time and error of every level, as a job."""
        from lfcal.simulate.accuracy.ladder import iter_ladder

        plan = self.context.state.plan
        if plan is not None:
            tolerance = self.settings.tolerance
            self.context.jobs.start(
                "Accuracy against time",
                "simulate",
                lambda: iter_ladder(plan.camera, plan, tolerance),
                self.panel.show_ladder,
            )

    def _apply_theme(self) -> None:
        self.panel.apply_theme()
        if self.verdict is not None:
            self.panel.show_verdict(self.verdict)
