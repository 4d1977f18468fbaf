"""Names of `lfcal.simulate.accuracy` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.simulate.accuracy._ladder import (
    Ladder,
    LadderProgress,
    LadderRung,
    draw_ladder,
    iter_ladder,
    ladder,
    shown_steps,
)
from lfcal.simulate.accuracy.cost import learn
from lfcal.simulate.accuracy.forecast import engine_clock, plane_seconds, predict_seconds, whole_of
from lfcal.simulate.accuracy.memory import predict_bytes, task_bytes
from lfcal.simulate.accuracy.planner import FOR_EFFECTS, EffectSelection, PlannedEffect, plan_effects
from lfcal.simulate.accuracy.probe import RETRIES, balanced, settle
from lfcal.simulate.accuracy.sampling import finer, grid_margin, step_for, steps_for

__all__ = [
    "FOR_EFFECTS",
    "RETRIES",
    "EffectSelection",
    "Ladder",
    "LadderProgress",
    "LadderRung",
    "PlannedEffect",
    "balanced",
    "draw_ladder",
    "engine_clock",
    "finer",
    "grid_margin",
    "iter_ladder",
    "ladder",
    "learn",
    "plan_effects",
    "plane_seconds",
    "predict_bytes",
    "predict_seconds",
    "settle",
    "shown_steps",
    "step_for",
    "steps_for",
    "task_bytes",
    "whole_of",
]
