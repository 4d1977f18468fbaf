"""The public names of `lfcal.simulate`, loaded when the first of them is asked for."""

from __future__ import annotations

from lfcal.simulate.accuracy.forecast import predict_seconds
from lfcal.simulate.accuracy.ladder import Ladder, LadderProgress, draw_ladder, iter_ladder, ladder
from lfcal.simulate.accuracy.memory import predict_bytes
from lfcal.simulate.accuracy.planner import EffectSelection, PlannedEffect, plan_effects
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.progressive import iter_refine_psf
from lfcal.simulate.sensor.camera_source import SimulatedCamera
from lfcal.simulate.sensor.noise import expose
from lfcal.simulate.sensor.session import iter_write_session, write_session
from lfcal.simulate.simulate import iter_simulate_psf, simulate_psf
from lfcal.simulate.volume import iter_light_field, light_field, plume, points, vesicle

__all__ = [
    "EffectSelection",
    "Ladder",
    "LadderProgress",
    "PlannedEffect",
    "Sampling",
    "SimulatedCamera",
    "draw_ladder",
    "expose",
    "iter_ladder",
    "iter_light_field",
    "iter_refine_psf",
    "iter_simulate_psf",
    "iter_write_session",
    "ladder",
    "light_field",
    "plan_effects",
    "plume",
    "points",
    "predict_bytes",
    "predict_seconds",
    "simulate_psf",
    "vesicle",
    "write_session",
]
