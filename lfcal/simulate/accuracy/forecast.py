"""Predict the computing time of a simulation from a short run of its engine."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfcal.base import preparing_seconds
from lfcal.camera import ScanPlan
from lfcal.simulate._pupil_scene import PupilScene
from lfcal.simulate._symmetry import is_separable, mirrored_rows
from lfcal.simulate.accuracy.cost import Traits, engine_seconds, step_for
from lfcal.simulate.accuracy.probe import RETRIES
from lfcal.simulate.accuracy.sampling import finer
from lfcal.simulate.effects import Effect
from lfcal.simulate.engines import EnergyError, PlaneEngine, Sampling, engine_for
from lfcal.simulate.plane_task import Budget, EffectsLike, budgeted
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.scene import Scene
from lfcal.simulate.staging import light_samples, outlook_of, resolve_level, scene_for, wave_level

__all__ = [
    "CostScaling",
    "computed_share",
    "cost_scaling",
    "engine_clock",
    "plane_seconds",
    "planned_engines",
    "predict_seconds",
    "timed_plane",
]

PER_PLANE, PER_BYTE = 0.002, 1e-9
"""CPU-seconds besides the engine: to start a plane, and for its memory."""

LONGEST_RUN = 0.5
"""CPU-seconds for which rows are run, if an engine reuses its results."""


SHORT_PROBE_S = 1.0
"""CPU-seconds below which a probe is run twice."""


def predict_seconds(
    plan: ScanPlan,
    effects: EffectsLike = "auto",
    level: str = "auto",
    *,
    tolerance: float | None = None,
    sampling: Sampling | None = None,
) -> float:
    """Predict the CPU time of `simulate_psf` (s) from a short run of the engine.

    Only the plane that is predicted to take longest is run. Its time is scaled to the other planes by their estimated
    costs. The parameters are those of `simulate_psf`.

    Examples
    --------
    >>> from math import ceil
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import predict_seconds
    >>> camera = preset("bench")
    >>> plan = ScanPlan.for_camera(camera, virtual_depths=[3.0])
    >>> print(f"{ceil(predict_seconds(plan, (), 'geometric') / 60)} min of processor time at most")
    1 min of processor time at most
    """
    budget = budgeted(effects, plan, tolerance)
    z = max(range(plan.shape[0]), key=lambda k: _expected(plan, k, budget, level))
    chosen, share = budget.at(plan.depths_um[z])
    probe, again = math.inf, True
    while again:
        response = PlaneResponse(plan, z, chosen, level=level, tolerance=share, sampling=sampling)
        start = engine_clock()
        response.engine()
        took = engine_clock() - start
        # tables that scenes share are made only once: time a short probe after they exist
        again = probe == math.inf and took < SHORT_PROBE_S
        probe = min(probe, took)
    setup = plane = math.inf
    for _ in range(2):  # the first probe of a session may fill caches, and other programs may interfere
        setup, plane = (min(times) for times in zip((setup, plane), timed_plane(response), strict=True))
    shares = cost_scaling(plan, z, budget, response.level, response.runs)
    nz, ny, nx, nt, ns = plan.shape
    # each plane is probed once, for any number of light samples
    return shares.seconds(setup, plane) + nz * (probe + PER_PLANE + PER_BYTE * 4 * ny * nx * nt * ns)


def planned_engines(
    plan: ScanPlan, effects: EffectsLike = "auto", level: str = "auto", *, tolerance: float | None = None
) -> tuple[str, ...]:
    """Return, for each plane, the name of the engine that `simulate_psf` is expected to use.

    The names are those in the provenance of H. The parameters are those of `simulate_psf`, which may use another engine
    if the error that it measures is too large.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import planned_engines
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0])
    >>> planned_engines(plan), planned_engines(plan, (), "geometric")
    (('grid',), ('geometric',))
    """
    budget, found = budgeted(effects, plan, tolerance), []
    for z, z_um in enumerate(plan.depths_um):
        chosen, share = budget.at(z_um)
        scene, resolved = resolve_level(scene_for(plan, z, chosen), level)
        engine = step_for(scene, resolved, share).level
        if engine == "debye":  # other arrays than those along the rows sum windows of the same field
            engine = "microscope" if isinstance(scene, Scene) and is_separable(scene) else "wave"
        found.append(engine)
    return tuple(found)


@dataclass(frozen=True, slots=True)
class CostScaling:
    """Factors that scale the cost of one plane to the whole H.

    Attributes
    ----------
    planes
        Cost of the positions of all planes, relative to that of the positions of the measured plane.
    count
        Number of light samples of all planes, relative to that of the measured plane; the cost of tables scales with
        it.
    runs
        Number of light samples of the measured plane.
    """

    planes: float
    count: float
    runs: int

    def seconds(self, setup: float, plane: float) -> float:
        """Return the time of the whole H (s), extrapolated from times of the measured plane for one light sample (s).

        ``setup`` is the time of its tables, and ``plane`` that of all its positions.
        """
        return self.runs * (setup * self.count + plane * self.planes)


def cost_scaling(
    plan: ScanPlan, z: int, effects: Budget | Sequence[Effect], level: str, runs: int | None = None
) -> CostScaling:
    """Return the factors that scale the cost of the plane with index ``z`` to that of the whole plan.

    ``level`` is the level of the engine. ``runs`` is the number of light samples of the plane. None: it is computed.
    """
    budget = effects if isinstance(effects, Budget) else Budget(tuple(effects), 1.0)
    # planes differ in the number of lit lenslets and in effects: the ratio is estimated, one plane is measured
    samples = [_samples(plan, k, budget) for k in range(plan.shape[0])]
    costs = [_expected(plan, k, budget, level) for k in range(plan.shape[0])]
    return CostScaling(sum(costs) / costs[z], sum(samples) / samples[z], samples[z] if runs is None else runs)


def _samples(plan: ScanPlan, z: int, budget: Budget) -> int:
    outlook = outlook_of(plan, z)
    return len(light_samples(budget.at(plan.depths_um[z])[0], outlook))


def _expected(plan: ScanPlan, z: int, budget: Budget, level: str) -> float:
    """Return the estimated CPU-seconds of a plane; ``auto`` uses rays unless an effect needs waves."""
    waves = wave_level(plan.camera)
    level = {"auto": waves, "microscope": "debye"}.get(level, level)
    chosen, _ = budget.at(plan.depths_um[z])
    if (
        plan.camera.has_lattice
        and level == waves
        and budget.selection is not None
        and not any(effect.needs_waves for effect in chosen)
    ):
        level = "geometric"
    scene = scene_for(plan, z, chosen)
    traits = None if isinstance(scene, PupilScene) else Traits.of(scene)
    return _samples(plan, z, budget) * engine_seconds(outlook_of(plan, z), level, traits=traits)


def timed_plane(response: PlaneResponse) -> tuple[float, float]:
    """Return the measured CPU-seconds of the tables of a plane, and the predicted ones of all its positions.

    Both are for one light sample. The probe of ``response`` must have run. As in the simulation of the plane, the
    sampling is refined if the energy does not balance at a position.
    """
    sampling = response.settled
    for attempt in range(RETRIES + 1):
        start = engine_clock()
        engine = engine_for(response.scene, response.level, sampling)
        setup = engine_clock() - start
        try:
            return setup, plane_seconds(engine)
        except EnergyError:
            if sampling is None or response.sampling is not None or attempt == RETRIES:
                raise
            sampling = finer(sampling)
    raise AssertionError  # the last attempt returns or raises


def plane_seconds(engine: PlaneEngine) -> float:
    """Return the predicted CPU-seconds that a new engine needs for all positions of a plane.

    They are extrapolated from a short run. The Debye path uses the same matrices and responses for many positions, so a
    few positions are not representative. For this path, entire rows of positions are computed until `LONGEST_RUN` has
    passed.
    """
    ny, nx = engine.scene.period
    if engine.level != "debye":
        return engine.predicted_seconds(ny * nx) * computed_share(engine)
    start = engine_clock()
    done = 0
    while done < ny and engine_clock() - start < LONGEST_RUN:
        engine.rows([done], range(nx), workers=1)
        done += 1
    return (engine_clock() - start) * ny / done


def engine_clock() -> float:
    """Return the CPU time of this thread (s), without that for loading kernels, which happens once per process."""
    return time.thread_time() - preparing_seconds()


def computed_share(engine: PlaneEngine) -> float:
    """Return the fraction of the rows of source positions that ``engine`` computes; the others are mirror images."""
    ny = engine.scene.period[0]
    return 1.0 - len(mirrored_rows(engine.scene, np.arange(ny))) / ny if engine.level in ("wave", "grid") else 1.0
