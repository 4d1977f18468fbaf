"""The public names of `lfcal.simulate`: each is loaded on first use."""

from __future__ import annotations

from lfcal.simulate.accuracy import (
    EffectSelection,
    Ladder,
    LadderProgress,
    PlannedEffect,
    draw_ladder,
    iter_ladder,
    ladder,
    plan_effects,
    planned_engines,
    predict_bytes,
    predict_seconds,
)
from lfcal.simulate.assumed_values import AssumedEffect, iter_assumed_effects
from lfcal.simulate.engines import Sampling
from lfcal.simulate.noise_forecast import (
    ExpectedLight,
    ScanChoice,
    iter_expected_light,
    scan_choices,
)
from lfcal.simulate.progressive import iter_refine_psf
from lfcal.simulate.sensor import SimulatedCamera, expose, iter_write_session, write_session
from lfcal.simulate.simulate import iter_simulate_psf, simulate_psf
from lfcal.simulate.undescribed import EffectMeasurement, UndescribedEffects, undescribed_effects
from lfcal.simulate.volume import iter_light_field, light_field, plume, points, vesicle

__all__ = [
    "AssumedEffect",
    "EffectMeasurement",
    "EffectSelection",
    "ExpectedLight",
    "Ladder",
    "LadderProgress",
    "PlannedEffect",
    "Sampling",
    "ScanChoice",
    "SimulatedCamera",
    "UndescribedEffects",
    "draw_ladder",
    "expose",
    "iter_assumed_effects",
    "iter_expected_light",
    "iter_ladder",
    "iter_light_field",
    "iter_refine_psf",
    "iter_simulate_psf",
    "iter_write_session",
    "ladder",
    "light_field",
    "plan_effects",
    "planned_engines",
    "plume",
    "points",
    "predict_bytes",
    "predict_seconds",
    "scan_choices",
    "simulate_psf",
    "undescribed_effects",
    "vesicle",
    "write_session",
]
