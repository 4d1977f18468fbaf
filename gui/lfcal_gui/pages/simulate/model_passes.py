"""H in passes, for the window: what a job that is stopped leaves behind. No Qt."""

from __future__ import annotations

from typing import Any

from lfcal.base import Work
from lfcal.camera import ScanPlan
from lfcal_gui.models import going_on
from lfcal_gui.pages.simulate.model import SimulateSettings
from lfcal_gui.pages.simulate.model_effects import EffectsVerdict, sources_of, verdict_of

__all__ = ["Passes"]


class Passes:
    """A simulation in passes, and what it has written so far.

    Attributes
    ----------
    path
        The H file.
    whole
        How accurate the H in the file is, in words; empty before the first pass is done. Set by the job's thread.
    """

    def __init__(self, plan: ScanPlan, settings: SimulateSettings, path: str, verdict: EffectsVerdict | None) -> None:
        self.plan, self.settings, self.path, self.verdict = plan, settings, path, verdict
        self.whole = ""

    def work(self) -> Work[Any]:
        """Simulate; asks the planner first unless the verdict is its answer."""
        from lfcal.simulate import EffectSelection, iter_refine_psf, plan_effects

        plan, settings, verdict = self.plan, self.settings, self.verdict
        if verdict is None or not verdict.fits(plan, settings):
            verdict = verdict_of(plan, settings)
        effects, last = settings.effects(), verdict.found

        def choose(tolerance: float) -> EffectSelection:
            if tolerance == settings.tolerance:
                return last
            return plan_effects(plan, tolerance, settings.choices(), effects=effects)

        return (
            yield from iter_refine_psf(
                plan,
                choose,
                settings.level,
                tolerance=settings.tolerance,
                out=self.path,
                provenance={"plan": plan.to_dict(), "effect_sources": sources_of(settings, last)},
                on_pass=self._wrote,
                run=going_on(),
            )
        )

    def _wrote(self, matrix: Any) -> None:
        worst = max(float(error) for error in matrix.facts.known()["error"])
        self.whole = f"whole within {100 * worst:.2g} %"
