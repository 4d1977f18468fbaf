"""How much light of neighbours falls into a cutout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.simulate import PlaneResponse, plan_effects
from lfcal.simulate.accuracy import steps_for
from lfcal.simulate.effects import Effect, IrisDiffraction, LensletDiffraction
from lfcal.simulate.engines import EnergyError
from lfcal.targets.images import HoleImages

__all__ = ["Tails", "simulated_tails"]

PHASES = 3
"""Phases per axis over which patterns are averaged: neighbours are of any phase."""

TOLERANCE = 0.1
"""Relative L1 error by which effects are chosen: diffraction is always on, and others change spots more than tails."""

WITHOUT_GRID = 0.003
"""Relative L1 error where no grid holds the scene: windows about the lenslets, which must be wide to hold tails."""

WINDOWS = (4.0, 3.0, 2.5, 2.0, 1.5)
"""Widths of the window, in cutouts, of which the first that a grid holds is taken: what it lacks is counted as dark."""

KEPT = 32
"""Tails that are kept: a target is proposed and planned with the same."""


@dataclass(frozen=True, eq=False)
class Tails:
    """The light of a point far and wide about its chief ray, averaged over phases.

    Attributes
    ----------
    light
        Mean pattern ``(rows, columns)``, odd, of a window four cutouts wide, or as wide as a grid of waves may be
        (`WINDOWS`); its cutout holds 1.
    cutout
        Pixels ``(nt, ns)`` of a cutout.
    level
        How it was computed.
    """

    light: NDArray[np.float64]
    cutout: tuple[int, int]
    level: str

    def share(self, away_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the light of points ``(n, 2)`` as (rows, columns) away in a cutout, over that of its own point."""
        sums = np.pad(self.light.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
        shape = np.array(self.light.shape)
        half = (np.array(self.cutout) - 1) // 2
        middle = (shape - 1) // 2 - np.rint(away_px).astype(np.intp)
        (top, left), (bottom, right) = (np.clip(middle + d, 0, shape).T for d in (-half, half + 1))
        shares: NDArray[np.float64] = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
        return np.maximum(shares, 0.0)

    def grid(self, pitch_px: tuple[float, float]) -> float:
        """Return the crosstalk in a rectangular grid of equally bright points: of all within the window."""
        reach = [int(n // p) + 1 for n, p in zip(self.light.shape, pitch_px, strict=True)]
        index = np.mgrid[-reach[0] : reach[0] + 1, -reach[1] : reach[1] + 1].reshape(2, -1).T
        others = index[(index != 0).any(axis=1)]
        return float(self.share(others * np.array(pitch_px)).sum())

    def among(self, images: HoleImages) -> float:
        """Return the largest crosstalk of a hole whose neighbours are where ``images`` are; all as bright."""
        if len(images) < 2:
            return 0.0
        # holes far from each other change no sum, and tables of all pairs of thousands would be large
        sums = np.zeros(len(images))
        near = np.array(self.light.shape)
        for k, place in enumerate(images.pixels):
            away = images.pixels - place
            close = (np.abs(away) < near).all(axis=1)
            close[k] = False
            sums[k] = self.share(away[close]).sum()
        return float(sums.max())

    def least_pitch(self, crosstalk: float) -> int:
        """Return the smallest spacing of a square grid whose crosstalk is at most a limit (pixels).

        Raises
        ------
        InputError
            If there is none within two cutouts.
        """
        first, last = (max(self.cutout) - 1) // 2, 2 * max(self.cutout)
        for pitch in range(first, last):
            if self.grid((pitch, pitch)) <= crosstalk:
                return pitch
        raise InputError.expected("crosstalk", "a limit that two cutouts' distance keeps", crosstalk, "allow more")


@lru_cache(maxsize=KEPT)
def simulated_tails(plan: ScanPlan, z: int, *, level: str = "auto") -> Tails:
    """Return the tails of plane ``z``: patterns of the described camera, by rays or by waves, averaged over phases.

    A pattern's error says nothing of its tails, which hold less than a percent of its light, and windows about the
    lenslets cut them off. Waves are therefore computed on one grid of the whole array.

    Parameters
    ----------
    plan, z
        The scan and the number of the plane.
    level
        ``"geometric"``: rays, whose patterns end; ``"auto"``: waves, with the diffraction of lenslets and iris.
    """
    on = dict.fromkeys((LensletDiffraction.name, IrisDiffraction.name), "on")
    effects = plan_effects(plan, TOLERANCE, on).effects
    response = _response(plan, z, effects, WINDOWS[0], level=level, tolerance=TOLERANCE)
    light = None
    if response.level == "wave" and (light := _light_by_grid(plan, z, effects)) is None:
        response = _response(plan, z, effects, WINDOWS[0], level=level, tolerance=WITHOUT_GRID)
    if light is None:
        light = _light(response)
    bare = Tails(light, plan.cutout, response.level)
    own = float(bare.share(np.zeros((1, 2)))[0])
    if not own > 0:
        raise InputError.expected("simulated light", "some in the cutout", "none", "check cutout and depths")
    light /= own
    light.setflags(write=False)  # kept for whoever asks next
    return Tails(light, plan.cutout, response.level)


def _response(plan: ScanPlan, z: int, effects: Sequence[Effect], window: float, **how: Any) -> PlaneResponse:
    """Return the response of a plane in a window so many cutouts wide."""
    rows, columns = (2 * int(window * n / 2) + 1 for n in plan.cutout)
    return PlaneResponse(plan, z, effects, cutout=(rows, columns), on_sensor=True, **how)


def _light(response: PlaneResponse) -> NDArray[np.float64]:
    """Return the mean pattern over phases."""
    ys, xs = (np.unique(np.linspace(0, n - 1, PHASES + 1).astype(np.intp)[:-1]) for n in response.scene.period)
    mean: NDArray[np.float64] = response.rows(ys, xs).mean(axis=(0, 1), dtype=np.float64)
    return mean


def _light_by_grid(plan: ScanPlan, z: int, effects: Sequence[Effect]) -> NDArray[np.float64] | None:
    """Return the mean pattern of waves on the finest grid, in the widest window that one holds; None where none does.

    A grid of 4 samples per pixel, which is good enough for spots, lacks a fifth of the light far out.
    """
    for window in WINDOWS:
        steps = steps_for(_response(plan, z, effects, window).scene, "wave")
        if steps[-1].level == "grid":
            try:
                return _light(_response(plan, z, effects, window, level="grid", sampling=steps[-1].sampling))
            except EnergyError:  # too coarse for its window: a finer one holds a smaller window
                continue
    return None
