"""Names of `lfcal.simulate.accuracy` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.simulate.accuracy._ladder import (
    Ladder,
    LadderProgress,
    LadderRung,
    draw_ladder,
    iter_ladder,
    ladder,
    quick_steps,
    rung_label,
)
from lfcal.simulate.accuracy.calibration import machine_speed
from lfcal.simulate.accuracy.cost import Traits, correct_rate, few_seconds, step_for
from lfcal.simulate.accuracy.forecast import cost_scaling, engine_clock, planned_engines, predict_seconds, timed_plane
from lfcal.simulate.accuracy.memory import predict_bytes, task_bytes
from lfcal.simulate.accuracy.planner import EFFECTS_SHARE, EffectSelection, PlannedEffect, plan_effects
from lfcal.simulate.accuracy.probe import RETRIES, balanced, settle
from lfcal.simulate.accuracy.sampling import finer, grid_margin, steps_for

__all__ = [
    "EFFECTS_SHARE",
    "RETRIES",
    "EffectSelection",
    "Ladder",
    "LadderProgress",
    "LadderRung",
    "PlannedEffect",
    "Traits",
    "balanced",
    "correct_rate",
    "cost_scaling",
    "draw_ladder",
    "engine_clock",
    "few_seconds",
    "finer",
    "grid_margin",
    "iter_ladder",
    "ladder",
    "machine_speed",
    "plan_effects",
    "planned_engines",
    "predict_bytes",
    "predict_seconds",
    "quick_steps",
    "rung_label",
    "settle",
    "step_for",
    "steps_for",
    "task_bytes",
    "timed_plane",
]
