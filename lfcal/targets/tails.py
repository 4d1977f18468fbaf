"""How much light of neighbours falls into a cutout."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan
from lfcal.errors import InputError
from lfcal.simulate.accuracy.planner import plan_effects
from lfcal.simulate.response import PlaneResponse
from lfcal.targets.images import HoleImages

__all__ = ["Tails", "simulated_tails"]

PHASES = 3
"""Phases per axis over which patterns are averaged: neighbours are of any phase."""

TOLERANCE = 0.1
"""Relative L1 error of the patterns; tails need no more."""


@dataclass(frozen=True, eq=False)
class Tails:
    """The light of a point far and wide about its chief ray, averaged over phases.

    Attributes
    ----------
    light
        Mean pattern ``(rows, columns)``, odd, of a window three cutouts wide; its cutout holds 1.
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


def simulated_tails(plan: ScanPlan, z: int, *, level: str = "auto") -> Tails:
    """Return the tails of plane ``z``: patterns of the described camera, by rays or by waves, averaged over phases.

    Parameters
    ----------
    plan, z
        The scan and the number of the plane.
    level
        ``"geometric"``: rays, whose patterns end; ``"auto"``: waves, with the lenslets' diffraction.
    """
    effects = plan_effects(plan.camera, plan, TOLERANCE).effects
    window = (3 * plan.cutout[0], 3 * plan.cutout[1])
    response = PlaneResponse(plan, z, effects, level=level, tolerance=TOLERANCE, cutout=window, on_sensor=True)
    ny, nx = plan.period
    ys, xs = (np.unique(np.linspace(0, n - 1, PHASES + 1).astype(np.intp)[:-1]) for n in (ny, nx))
    light = response.rows(ys, xs).mean(axis=(0, 1), dtype=np.float64)
    bare = Tails(light, plan.cutout, response.level)
    own = float(bare.share(np.zeros((1, 2)))[0])
    if not own > 0:
        raise InputError.expected("simulated light", "some in the cutout", "none", "check cutout and depths")
    return Tails(light / own, plan.cutout, response.level)
