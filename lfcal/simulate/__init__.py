"""What a described camera does to the light of a point: only the effects a scene calls for.

- ``scene``: one depth plane as an engine needs it; ``pupil``, ``specimen``: parts of it
- ``engines``: from rays to the coherent reference, their sampling, and the energy they account for
- ``effects``: physical effects as objects with their a-priori estimates, found by registry
- ``accuracy``: what a simulation costs, which effects to simulate, how finely to compute, the ladder of levels
- ``staging``, ``response``: effects put to work on one plane
- ``simulate``: H, in memory or straight to a file; ``progressive``: in passes
- ``sensor``: sensor frames of a simulated session
- ``volume``: light fields of extended objects through the same H
"""

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
