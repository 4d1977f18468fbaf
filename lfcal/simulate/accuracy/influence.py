"""What leaving an effect out costs, by running it: a few positions of a plane with it and without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan
from lfcal.errors import LfcalError
from lfcal.simulate.accuracy.sampling import Step, finer, step_for
from lfcal.simulate.effects.base import Effect, FrameEffect, LightEffect, MotionEffect
from lfcal.simulate.effects.optics import LensletDiffraction
from lfcal.simulate.engines.base import EnergyError
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.scene import Scene
from lfcal.simulate.staging import filter_kernel, outlook_of, resolve_level, scene_for

__all__ = ["MOST_RUNS", "Influence"]

FINENESS = 0.02
"""Relative L1 error of the computation: what it does to both responses alike drops out of their difference."""

MOST_RUNS = 24
"""Samples of the light beyond which a measurement takes too long: the formula of a large source or spectrum stays."""

ROWS, COLUMNS = (0.2, 0.7), (0.07, 0.41, 0.76)
"""Positions that are computed, as shares of the period."""

TILTED = 1e-9
"""A tilt (per µm) that changes nothing but the steps that a scene is offered."""

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
        # by whether the array is tilted, which calls for another level
        self._steps: dict[bool, Step] = {}
        self._beside: dict[bool, NDArray[np.float64]] = {}
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
            tilted = any(self._scene(some).tilt != (0.0, 0.0) for some in (self._still, changed_set))
            if tilted not in self._beside:
                self._beside[tilted] = self._responses(self._still, tilted=tilted)
            beside, changed = self._beside[tilted], self._responses(changed_set, tilted=tilted)
        except LfcalError:
            return None  # a scene that no engine computes: its formula is all there is
        with_it, without = (beside, changed) if present else (changed, beside)
        light = float(np.abs(with_it).sum())
        return float(np.abs(with_it - without).sum()) / light if light > 0 else None

    def _alike(self, one: tuple[Effect, ...], other: tuple[Effect, ...]) -> bool:
        """Return whether two sets describe the same scene and filter: nothing needs to run then."""
        kernels = [filter_kernel(some, self._plan.camera) for some in (one, other)]
        scenes = [resolve_level(self._scene(some))[0] for some in (one, other)]
        offsets = [scene.offsets_um for scene in scenes]
        return scenes[0] == scenes[1] and _same(*kernels) and _same(*offsets)

    def _scene(self, effects: tuple[Effect, ...]) -> Scene:
        return scene_for(self._plan, self._z, effects)

    def _responses(self, effects: tuple[Effect, ...], *, tilted: bool) -> NDArray[np.float64]:
        """Return the responses with ``effects``; all are sampled alike, as finely as their energy needs."""
        scene, level = resolve_level(self._scene(effects))
        for attempt in range(ATTEMPTS):
            if tilted not in self._steps:
                self._steps[tilted] = step_for(self._common(scene, tilted=tilted), level, FINENESS)
            step = self._steps[tilted]
            # rays have no sampling, and stay rays beside waves
            chosen = level if "geometric" in (level, step.level) else step.level
            response = PlaneResponse(self._plan, self._z, effects, level=chosen, sampling=step.sampling)
            try:
                return response.rows(self._ys, self._xs, workers=1).astype(np.float64)
            except EnergyError:
                if attempt == ATTEMPTS - 1:
                    raise
                self._steps[tilted] = replace(step, sampling=finer(step.sampling))
        raise AssertionError  # the last attempt returns or raises

    def _common(self, scene: Scene, *, tilted: bool) -> Scene:
        """Return a scene whose steps serve those of both arrays that are compared."""
        return replace(scene, tilt=(TILTED, 0.0)) if tilted and scene.tilt == (0.0, 0.0) else scene


def _same(one: NDArray[np.float64] | None, other: NDArray[np.float64] | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other)
