"""Estimate effects plane by plane: by a formula if it can be trusted, otherwise by running the effect."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lfcal.base import LfcalError
from lfcal.camera import ScanPlan
from lfcal.simulate._symmetry import is_separable
from lfcal.simulate.accuracy.cost import few_seconds, step_for
from lfcal.simulate.accuracy.sampling import LevelSampling, finer
from lfcal.simulate.effects import (
    Effect,
    Estimate,
    ExactAngles,
    FrameEffect,
    LensletDiffraction,
    LightEffect,
    MotionEffect,
    Outlook,
)
from lfcal.simulate.engines import SWITCH, EnergyError
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.scene import Scene
from lfcal.simulate.staging import filter_kernel, lattice_scene_for, outlook_of, resolve_level

__all__ = ["MAX_RUNS", "Influence", "estimates_of"]

MAX_PLANES = 5
"""Number of planes at which effects are run; results are interpolated between them."""

RUN = "simulated with and without it at a few positions"
"""Text in place of the formula of an estimate that was measured."""

CACHED = 4096
"""Number of measurements kept, because a plan is evaluated again after every change of a slider."""


def estimates_of(
    effects: Sequence[Effect], counting: Sequence[Effect], planes: Sequence[Outlook], plan: ScanPlan
) -> list[list[Estimate]]:
    """Return the estimate of every effect at every plane.

    Parameters
    ----------
    effects
        The effects to estimate.
    counting
        Effects that act on this camera; only these are run, concurrently.
    planes
        The depth planes.
    plan
        The plan with these planes.
    """
    found = [[effect.estimate(outlook) for outlook in planes] for effect in effects]
    counted = tuple(e for e in counting if e.acts_on.enters_h and not _is_run_without(e, planes))
    names = {effect.name for effect in counted}
    run = measured if _hashable(plan, counted) else measured.__wrapped__
    for effect, row in zip(effects, found, strict=True):
        doubtful = [k for k, outlook in enumerate(planes) if not effect.holds(outlook)]
        if effect.name not in names or not doubtful:
            continue
        known = {k: value for k in _evenly_spaced(doubtful) if (value := run(plan, k, counted, effect)) is not None}
        for k in doubtful if known else ():
            row[k] = replace(row[k], error=_between(k, known), formula=RUN, measured=True)
    return found


def _is_run_without(effect: Effect, planes: Sequence[Outlook]) -> bool:
    """Return whether others are run without this effect: it prevents a microscope's fast path and changes little."""
    return isinstance(effect, ExactAngles) and not planes[0].has_lens and all(map(effect.holds, planes))


def _hashable(*values: object) -> bool:
    """Return whether measurements can be stored with these keys; effects of other packages may hold arrays."""
    try:
        hash(values)
    except TypeError:
        return False
    return True


def _evenly_spaced(numbers: Sequence[int]) -> list[int]:
    """Return up to `MAX_PLANES` of the numbers, the first and the last among them."""
    if len(numbers) <= MAX_PLANES:
        return list(numbers)
    step = (len(numbers) - 1) / (MAX_PLANES - 1)
    return [numbers[round(k * step)] for k in range(MAX_PLANES)]


def _between(plane: int, known: dict[int, float]) -> float:
    """Return the error at a plane between those measured: errors span decades, so their logarithm is interpolated."""
    below = max((k for k in known if k <= plane), default=min(known))
    above = min((k for k in known if k >= plane), default=max(known))
    if below == above:
        return known[below]
    share = (plane - below) / (above - below)
    low, high = (max(known[k], 1e-9) for k in (below, above))
    return math.exp((1 - share) * math.log(low) + share * math.log(high))


@lru_cache(maxsize=CACHED)
def measured(plan: ScanPlan, z: int, counting: tuple[Effect, ...], effect: Effect) -> float | None:
    """Return the error of leaving an effect out at a plane, or None if the effect cannot be run."""
    made = influence if _hashable(plan, counting) else influence.__wrapped__
    return made(plan, z, counting).of(effect)


@lru_cache(maxsize=2)
def influence(plan: ScanPlan, z: int, counting: tuple[Effect, ...]) -> Influence:
    """Return the object that measures effects at a plane; the responses with all effects are shared by all of them."""
    return Influence(plan, z, counting)


FINENESS = 0.02
"""Relative L1 error of the computation; errors common to both responses cancel in their difference."""

MAX_RUNS = 24
"""Number of light samples above which the formula for a large source or spectrum is used, to save time."""

MAX_SECONDS = 6.0
"""Forecast processor time above which the formula is used: with cutouts of many hundreds of pixels, a large source
takes minutes."""

ROWS, COLUMNS = (0.2, 0.7), (0.07, 0.41, 0.76)
"""Positions that are computed, as fractions of the period."""

NATIVE_ROWS, NATIVE_COLUMNS = (0.05, 0.2, 0.45, 0.7), (0.07, 0.24, 0.41, 0.58, 0.76, 0.93)
"""Positions near the native plane, where one lenslet or the gap between two lenslets receives all the light."""

ATTEMPTS = 3
"""Number of samplings tried until the energy balances."""


class Influence:
    """Measures effects of one depth plane.

    Parameters
    ----------
    plan, z
        The plan and the index of the plane.
    effects
        All effects on the plane, because the influence of an effect depends on the others. Finite sources and spectra
        are added to the others one at a time, because each multiplies the computing time.
    """

    def __init__(self, plan: ScanPlan, z: int, effects: Sequence[Effect]) -> None:
        self._plan, self._z = plan, z
        self._outlook = outlook_of(plan, z)
        self._unspread = tuple(e for e in effects if e.acts_on.enters_h and not isinstance(e, LightEffect))
        self._with_all: dict[LevelSampling, NDArray[np.float64]] = {}
        near = self._outlook.has_lens and self._outlook.fresnel_main < SWITCH
        shares = (NATIVE_ROWS, NATIVE_COLUMNS) if near else (ROWS, COLUMNS)
        self._ys, self._xs = (
            sorted({int(share * n) for share in some}) for some, n in zip(shares, plan.period, strict=True)
        )

    def of(self, effect: Effect) -> float | None:
        """Return sum(|without - with|) / sum(|with|) over the positions; None if it cannot be computed."""
        if isinstance(effect, FrameEffect | MotionEffect):
            return None
        others = tuple(e for e in self._unspread if e.name != effect.name)
        present = len(others) < len(self._unspread)
        if isinstance(effect, LensletDiffraction):  # rays cannot show effects that need waves
            others = tuple(e for e in others if not e.needs_waves)
        if isinstance(effect, LightEffect):
            runs = effect.runs(self._outlook)
            if runs > MAX_RUNS or self._seconds(runs) > MAX_SECONDS:
                return None
        elif self._same_scene(others, (*others, effect)):
            return 0.0
        changed_set = others if present else (*self._unspread, effect)
        try:
            complete, changed = self._response_pair(changed_set)
        except LfcalError:
            return None  # no engine can compute this scene: only its formula remains
        with_it, without = (complete, changed) if present else (changed, complete)
        light = float(np.abs(with_it).sum())
        return float(np.abs(with_it - without).sum()) / light if light > 0 else None

    def _seconds(self, runs: int) -> float:
        """Return the forecast processor time of a number of runs."""
        level = resolve_level(self._scene(self._unspread))[1]
        return runs * few_seconds(self._outlook, level, FINENESS, len(self._ys) * len(self._xs))

    def _same_scene(self, one: tuple[Effect, ...], other: tuple[Effect, ...]) -> bool:
        """Return whether two sets of effects describe the same scene and filter, so that no run is needed."""
        kernels = [filter_kernel(some, self._plan.camera) for some in (one, other)]
        scenes = [resolve_level(self._scene(some))[0] for some in (one, other)]
        offsets = [scene.offsets_um for scene in scenes]
        return scenes[0] == scenes[1] and _same(*kernels) and _same(*offsets)

    def _scene(self, effects: tuple[Effect, ...]) -> Scene:
        return lattice_scene_for(self._plan, self._z, effects)

    def _response_pair(self, changed: tuple[Effect, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the responses with all effects and with ``changed``, both with the sampling that the energy needs."""
        step = self._common_step(self._unspread, changed)
        for attempt in range(ATTEMPTS):
            try:
                if step not in self._with_all:
                    self._with_all[step] = self._responses(self._unspread, step)
                return self._with_all[step], self._responses(changed, step)
            except EnergyError:
                if attempt == ATTEMPTS - 1:
                    raise
                step = replace(step, sampling=finer(step.sampling))
        raise AssertionError  # the last attempt returns or raises

    def _common_step(self, *sets: tuple[Effect, ...]) -> LevelSampling:
        """Return the sampling of the scene that fewer engines support, which is suitable for the other scene too.

        The Debye path supports only separable scenes; rays need no sampling.
        """

        def choosy(found: tuple[Scene, str]) -> tuple[bool, bool]:
            scene, level = found
            return level != "geometric", level == "debye" and not is_separable(scene)

        scene, level = max((resolve_level(self._scene(effects)) for effects in sets), key=choosy)
        return step_for(scene, level, FINENESS)

    def _responses(self, effects: tuple[Effect, ...], step: LevelSampling) -> NDArray[np.float64]:
        _, level = resolve_level(self._scene(effects))
        level = level if level == "geometric" else step.level
        response = PlaneResponse(self._plan, self._z, effects, level=level, sampling=step.sampling)
        return response.rows(self._ys, self._xs, workers=1).astype(np.float64)


def _same(one: NDArray[np.float64] | None, other: NDArray[np.float64] | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other)
