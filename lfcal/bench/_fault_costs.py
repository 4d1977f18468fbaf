"""What a fault truly costs: large scenes reconstructed with a whole H that has it, and with one that has none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.inspect.scenes import SceneTrial

__all__ = ["TrueCost"]

F4 = NDArray[np.float32]

SIDE_PX = 96
"""Pixels along each axis of the images at least."""

SEEDS = (5, 6, 7)
"""Of the scenes: other points than an inspection's."""


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
        self._trial = SceneTrial(light, SIDE_PX, SEEDS, workers=1)
        self.clean = self.error(noisy)

    def error(self, values: F4) -> float:
        """Return the error of a reconstruction with an H, beside that with the true one (NRMSE)."""
        return self._trial.error(values)

    def cost(self, values: F4) -> float:
        """Return what an H adds to the error that noise makes."""
        return self.error(values) - self.clean
