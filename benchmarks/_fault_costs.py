"""What a fault truly costs: large scenes reconstructed with a whole H that has it, and with one that has none."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from lfcal.judge._scenes import SceneTrial, beads, lines, scene

__all__ = ["TrueCost"]

F4 = NDArray[np.float32]

SIDE_PX = 96
"""Pixels along each axis of the images at least."""

SCENES = (partial(scene, seed=5), partial(beads, seed=6), partial(lines, seed=7))
"""Points and a smooth part, beads, and lines: others than an inspection's."""


class TrueCost:
    """Errors of reconstructions with patterns of a camera whose light is known.

    Parameters
    ----------
    light
        Patterns ``(nz, ny, nx, nt, ns)`` without noise and faults.
    noisy
        The same with noise: what any recording has.
    """

    def __init__(self, light: F4, noisy: F4) -> None:
        self._trial = SceneTrial(light, SIDE_PX, SCENES, workers=1)
        self.clean = self.error(noisy)

    def error(self, values: F4) -> float:
        """Return the error of a reconstruction with an H, beside that with the true one (NRMSE)."""
        return self._trial.error(values)

    def cost(self, values: F4) -> float:
        """Return the error that an H makes beyond noise: both add in squares."""
        return float(np.sqrt(max(0.0, self.error(values) ** 2 - self.clean**2)))
