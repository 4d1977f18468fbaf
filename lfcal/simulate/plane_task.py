"""Compute one plane of an H by simulation, with all settings that determine its values: effects, tolerance, engine."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Meter, Progress, Work, worker_count
from lfcal.camera import ScanPlan
from lfcal.simulate._pupil_scene import PupilScene
from lfcal.simulate.accuracy import EFFECTS_SHARE, EffectSelection, Traits, correct_rate, plan_effects
from lfcal.simulate.effects import Effect
from lfcal.simulate.engines import Sampling
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.staging import outlook_of

__all__ = ["Budget", "Computed", "EffectsLike", "PlaneTask", "budgeted", "describe", "tolerance_for"]

BLOCK_BYTES = 64 << 20
"""Approximate size of a block of rows that is computed between two progress reports."""

USUAL_TOLERANCE = 0.03
"""Relative L1 error allowed by default."""

EffectsLike: TypeAlias = Iterable[Effect] | EffectSelection | str


@dataclass(frozen=True, slots=True)
class Budget:
    """Effects at each depth and the tolerance shared between their omission and the computation.

    Attributes
    ----------
    effects
        All effects that are on at any depth.
    tolerance
        Total allowed relative L1 error.
    selection
        Effects that are on at each depth, and the omitted error. None: the same effects at all depths, with nothing
        omitted.
    """

    effects: tuple[Effect, ...]
    tolerance: float
    selection: EffectSelection | None = None

    def at(self, z_um: float) -> tuple[tuple[Effect, ...], float]:
        """Return the effects at a depth, and the relative L1 error that remains for the computation there."""
        chosen = self.selection
        if chosen is None:
            return self.effects, self.tolerance
        # a selection made for another tolerance must not use up all of this one
        remaining = max(self.tolerance - chosen.left_out[chosen.plane(z_um)], (1 - EFFECTS_SHARE) * self.tolerance)
        return chosen.at(z_um), remaining


def tolerance_for(effects: object, tolerance: float | None) -> float:
    """Return ``tolerance`` if given; otherwise the tolerance of a selection of effects, or else `USUAL_TOLERANCE`."""
    if tolerance is not None:
        return tolerance
    return effects.tolerance if isinstance(effects, EffectSelection) else USUAL_TOLERANCE


def budgeted(effects: EffectsLike, plan: ScanPlan, tolerance: float | None) -> Budget:
    """Return the budget for ``effects``: given effects, an `EffectSelection`, or ``"auto"``, which selects them.

    For given effects, the error of omitted effects is 0. ``tolerance`` is as in `tolerance_for`. Raise `InputError` if
    ``effects`` is none of these.
    """
    tolerance = tolerance_for(effects, tolerance)
    if isinstance(effects, str):
        if effects != "auto":
            raise InputError.expected(
                "effects", "a list of effects, an EffectSelection or 'auto'", repr(effects), "pass one of these"
            )
        effects = plan_effects(plan, tolerance)
    if isinstance(effects, EffectSelection):
        return Budget(effects.effects, tolerance, effects)
    chosen = tuple(effects)
    for effect in chosen:
        if not isinstance(effect, Effect):
            raise InputError.expected(
                "effects",
                "objects derived from Effect",
                type(effect).__name__,
                "choose effects of lfcal.simulate.effects",
            )
    return Budget(chosen, tolerance)


def describe(effects: Iterable[Effect]) -> list[dict[str, Any]]:
    """Return the name and the parameters of each effect as plain JSON types, for provenance."""
    return [{"name": e.name, **dataclasses.asdict(e)} for e in effects]  # type: ignore[call-overload]


class Computed(NamedTuple):
    """Error and record of a plane that was computed.

    Attributes
    ----------
    error
        Relative L1 error: the estimate for effects that are omitted, or that a computation with rays ignores, plus
        `PlaneResponse.reached`. NaN if the sampling was given.
    record
        For provenance: `PlaneResponse.record`, with ``seconds`` (elapsed), ``processor_seconds`` and, if it is known,
        ``error``.
    """

    error: float
    record: dict[str, Any]


@dataclass(frozen=True)
class PlaneTask:
    """One plane of an H, with all settings that determine its values.

    Attributes
    ----------
    plan, z
        The plan and the index of the plane.
    effects
        Effects that are on at this plane.
    level, sampling
        As in `simulate_psf`.
    tolerance
        Relative L1 error allowed for the computation.
    left_out
        Estimated relative L1 error of omitted effects.
    """

    plan: ScanPlan
    z: int
    effects: tuple[Effect, ...]
    level: str
    tolerance: float
    left_out: float
    sampling: Sampling | None

    def compute(self, out: NDArray[np.float32], workers: int | None) -> Work[Computed]:
        """Compute the plane into ``out`` ``(ny, nx, nt, ns)``, which must contain zeros; return error and record."""
        begun, cpu, meter, count = time.perf_counter(), time.process_time(), Meter(), worker_count(workers)
        with meter.running():
            response = PlaneResponse(
                self.plan, self.z, self.effects, level=self.level, tolerance=self.tolerance, sampling=self.sampling
            )
        name = f"simulate plane {self.z + 1} of {self.plan.shape[0]}"
        yield from _plane(out, response, name, count, meter)
        outlook, rays = outlook_of(self.plan, self.z), response.level == "geometric"
        lost = sum(e.estimate(outlook).error for e in self.effects if rays and e.needs_waves)
        elapsed, spent = time.perf_counter() - begun, meter.seconds
        if not self.plan.camera.has_lattice:
            # matrix products in threads of the BLAS: of the process's time, at most as much as they can have used
            spent = max(spent, min(time.process_time() - cpu, count * elapsed))
        if self.sampling is None:  # of a given sampling, nothing was forecast
            traits = None if isinstance(response.scene, PupilScene) else Traits.of(response.scene)
            correct_rate(outlook, response.level, self.tolerance, response.runs, spent, traits)
        error = response.reached + self.left_out + lost
        known = {"error": error} if math.isfinite(error) else {}
        record = {**response.record(), "seconds": round(elapsed, 3), "processor_seconds": round(spent, 3), **known}
        return Computed(error, record)


def _plane(
    out: NDArray[np.float32], response: PlaneResponse, name: str, workers: int, meter: Meter
) -> Iterable[Progress]:
    """Compute one plane into ``out`` ``(ny, nx, nt, ns)``, zeroed; yield progress."""
    ny, nx = out.shape[:2]
    # the same blocks for any number of threads: rows of a block may be mirror images, and another division would
    # change
    # rounding. An even number, because such rows come in pairs.
    block = min(ny, max(2, BLOCK_BYTES // max(1, out[0].nbytes) // 2 * 2))
    clock = Clock(name, ny * response.runs)
    yield clock.at(0)
    steps = response.accumulate(out, np.arange(ny), np.arange(nx), block=block, workers=workers)
    while True:
        with meter.running():
            done = next(steps, None)
        if done is None:
            return
        yield clock.at(done)
