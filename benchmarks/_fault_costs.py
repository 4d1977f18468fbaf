"""True costs of faults: large scenes reconstructed with a complete H, with and without the fault."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from lfcal.judge._scenes import SceneTrial, beads, lines, scene

__all__ = ["TrueCost"]

F4 = NDArray[np.float32]

SIDE_PX = 96
"""Smallest side of the images (px)."""

SCENES = (partial(scene, seed=5), partial(beads, seed=6), partial(lines, seed=7))
"""Points with a smooth part, beads, and lines: scenes that an inspection does not use."""


class TrueCost:
    """Errors of reconstructions with patterns of a camera whose light is known.

    Parameters
    ----------
    light
        Patterns ``(nz, ny, nx, nt, ns)`` without noise and faults.
    noisy
        The same patterns with the noise of a recording.
    """

    def __init__(self, light: F4, noisy: F4) -> None:
        self._trial = SceneTrial(light, SIDE_PX, SCENES, workers=1)
        self.clean = self.error(noisy)

    def error(self, values: F4) -> float:
        """Return the NRMSE of the reconstruction with an H, compared with the reconstruction with the true H."""
        return self._trial.error(values)

    def cost(self, values: F4) -> float:
        """Return the error that an H causes in addition to noise; errors add in quadrature."""
        return float(np.sqrt(max(0.0, self.error(values) ** 2 - self.clean**2)))
