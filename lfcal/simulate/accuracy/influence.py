"""What leaving an effect out costs, by running it: a few positions of a plane with it and without."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan
from lfcal.errors import LfcalError
from lfcal.simulate.accuracy.sampling import finer, step_for
from lfcal.simulate.effects.base import Effect, FrameEffect, LightEffect, MotionEffect
from lfcal.simulate.effects.optics import ExactAngles, LensletDiffraction
from lfcal.simulate.engines.base import EnergyError, Sampling
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.staging import filter_kernel, outlook_of, resolve_level, scene_for

__all__ = ["MOST_RUNS", "Influence"]

FINENESS = 0.02
"""Relative L1 error of the computation: what it does to both responses alike drops out of their difference."""

MOST_RUNS = 24
"""Samples of the light beyond which a measurement takes too long: the formula of a large source or spectrum stays."""

ROWS, COLUMNS = (0.2, 0.7), (0.07, 0.41, 0.76)
"""Positions that are computed, as shares of the period."""

ATTEMPTS = 3
"""Samplings tried until the energy balances."""


class Influence:
    """Measures effects of one depth plane.

    Parameters
    ----------
    plan, z
        The plan and the number of the plane.
    effects
        All that act on it: what an effect changes depends on what else there is. Sources and spectra are put beside
        the others one at a time, as each multiplies the work.
    """

    def __init__(self, plan: ScanPlan, z: int, effects: Sequence[Effect]) -> None:
        self._plan, self._z = plan, z
        self._outlook = outlook_of(plan, z)
        self._still = tuple(e for e in effects if e.acts_on.enters_h and not isinstance(e, LightEffect))
        self._sampling: Sampling | None = None
        self._beside: NDArray[np.float64] | None = None
        ny, nx = plan.period
        # near the native plane one lenslet has all the light, or the gap between two: a few places are too few
        self._ys, self._xs = sorted({int(share * ny) for share in ROWS}), sorted({int(share * nx) for share in COLUMNS})

    def of(self, effect: Effect) -> float | None:
        """Return sum(|without - with|) / sum(|with|) over the positions; None where it cannot be computed."""
        if isinstance(effect, FrameEffect | MotionEffect):
            return None
        others = tuple(e for e in self._still if e.name != effect.name)
        present = len(others) < len(self._still)
        if isinstance(effect, LensletDiffraction):  # rays show none of what calls for waves
            others = tuple(e for e in others if not e.needs_waves)
        if isinstance(effect, LightEffect):
            if effect.runs(self._outlook) > MOST_RUNS:
                return None
        elif self._alike(others, (*others, effect)):
            return 0.0
        changed_set = others if present else (*self._still, effect)
        try:
            if isinstance(effect, ExactAngles) and not self._followed(self._still):
                beside, changed = self._by_reference(self._still), self._by_reference(changed_set)
            else:
                beside, changed = self._undisturbed(), self._responses(changed_set)
        except LfcalError:
            return None  # a scene that no engine computes: its formula is all there is
        with_it, without = (beside, changed) if present else (changed, beside)
        light = float(np.abs(with_it).sum())
        return float(np.abs(with_it - without).sum()) / light if light > 0 else None

    def _alike(self, one: tuple[Effect, ...], other: tuple[Effect, ...]) -> bool:
        """Return whether two sets describe the same scene and filter: nothing needs to run then."""
        kernels = [filter_kernel(some, self._plan.camera) for some in (one, other)]
        scenes = [resolve_level(scene_for(self._plan, self._z, some))[0] for some in (one, other)]
        offsets = [scene.offsets_um for scene in scenes]
        return scenes[0] == scenes[1] and _same(*kernels) and _same(*offsets)

    def _followed(self, effects: tuple[Effect, ...]) -> bool:
        """Return whether waves follow rays at exact angles: not near the native plane, where rays cross."""
        from lfcal.simulate.engines.field import choose_mode  # compiled code: not loaded before it is needed

        return choose_mode(scene_for(self._plan, self._z, effects)) != "U"

    def _by_reference(self, effects: tuple[Effect, ...]) -> NDArray[np.float64]:
        scene, level = resolve_level(scene_for(self._plan, self._z, effects), "reference")
        sampling = step_for(scene, level, FINENESS).sampling
        response = PlaneResponse(self._plan, self._z, effects, level=level, sampling=sampling)
        return response.rows(self._ys, self._xs, workers=1).astype(np.float64)

    def _undisturbed(self) -> NDArray[np.float64]:
        if self._beside is None:
            self._beside = self._responses(self._still)
        return self._beside

    def _responses(self, effects: tuple[Effect, ...]) -> NDArray[np.float64]:
        """Return the responses with ``effects``; all are sampled alike, as finely as their energy needs."""
        for attempt in range(ATTEMPTS):
            if self._sampling is None:
                scene, level = resolve_level(scene_for(self._plan, self._z, effects))
                self._sampling = step_for(scene, level, FINENESS).sampling
            response = PlaneResponse(self._plan, self._z, effects, sampling=self._sampling)
            try:
                return response.rows(self._ys, self._xs, workers=1).astype(np.float64)
            except EnergyError:
                if attempt == ATTEMPTS - 1:
                    raise
                self._sampling = finer(self._sampling)
        raise AssertionError  # the last attempt returns or raises


def _same(one: NDArray[np.float64] | None, other: NDArray[np.float64] | None) -> bool:
    if one is None or other is None:
        return one is other
    return one.shape == other.shape and bool((one == other).all()) and math.isfinite(float(one.sum()))
