"""What leaving an effect out costs, by running it: a few positions of a plane with it and without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import LfcalError
from lfcal.camera import ScanPlan
from lfcal.simulate.accuracy.cost import few_seconds
from lfcal.simulate.accuracy.sampling import LevelSampling, finer, step_for
from lfcal.simulate.effects import Effect, FrameEffect, LensletDiffraction, LightEffect, MotionEffect
from lfcal.simulate.engines import SWITCH, EnergyError
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.scene import Scene
from lfcal.simulate.staging import filter_kernel, outlook_of, resolve_level, scene_for

__all__ = ["MAX_RUNS", "Influence"]

FINENESS = 0.02
"""Relative L1 error of the computation: what it does to both responses alike drops out of their difference."""

MAX_RUNS = 24
"""Samples of the light beyond which a measurement takes too long: the formula of a large source or spectrum stays."""

MAX_SECONDS = 15.0
"""Processor time, as it is reckoned, beyond which a measurement takes too long as well: of cutouts of many hundreds of
pixels a large source takes minutes."""

ROWS, COLUMNS = (0.2, 0.7), (0.07, 0.41, 0.76)
"""Positions that are computed, as shares of the period."""

NATIVE_ROWS, NATIVE_COLUMNS = (0.05, 0.2, 0.45, 0.7), (0.07, 0.24, 0.41, 0.58, 0.76, 0.93)
"""The same near the native plane, where one lenslet has all the light, or the gap between two."""

ATTEMPTS = 3
"""Samplings tried until the energy balances."""


class Influence:
    """Measures effects of one depth plane.

    Parameters
    ----------
    plan, z
        The plan and the number of the plane.
    effects
        All that act on it: what an effect changes depends on what else there is. Sources and spectra are added
        to the others one at a time, as each multiplies the work.
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
        """Return sum(|without - with|) / sum(|with|) over the positions; None where it cannot be computed."""
        if isinstance(effect, FrameEffect | MotionEffect):
            return None
        others = tuple(e for e in self._unspread if e.name != effect.name)
        present = len(others) < len(self._unspread)
        if isinstance(effect, LensletDiffraction):  # rays show none of what calls for waves
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
            return None  # a scene that no engine computes: its formula is all there is
        with_it, without = (complete, changed) if present else (changed, complete)
        light = float(np.abs(with_it).sum())
        return float(np.abs(with_it - without).sum()) / light if light > 0 else None

    def _seconds(self, runs: int) -> float:
        """Return the processor time of a number of runs, as it is reckoned."""
        level = resolve_level(self._scene(self._unspread))[1]
        return few_seconds(self._outlook, level, FINENESS, runs * len(self._ys) * len(self._xs))

    def _same_scene(self, one: tuple[Effect, ...], other: tuple[Effect, ...]) -> bool:
        """Return whether two sets describe the same scene and filter: nothing needs to run then."""
        kernels = [filter_kernel(some, self._plan.camera) for some in (one, other)]
        scenes = [resolve_level(self._scene(some))[0] for some in (one, other)]
        offsets = [scene.offsets_um for scene in scenes]
        return scenes[0] == scenes[1] and _same(*kernels) and _same(*offsets)

    def _scene(self, effects: tuple[Effect, ...]) -> Scene:
        return scene_for(self._plan, self._z, effects)

    def _response_pair(self, changed: tuple[Effect, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the responses with all effects and with ``changed``, sampled alike and as finely as energy needs."""
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
        """Return the step of that scene which fewer engines compute: it serves the other too.

        The Debye path serves separable scenes alone; rays need no sampling.
        """
        from lfcal.simulate.engines import is_separable  # compiled code: not loaded before it is needed

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
