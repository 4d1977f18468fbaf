"""What a fault truly costs: a large scene reconstructed with a whole H that has it, and with one that has none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.errors import InputError
from lfcal.inspect.cost import ITERATIONS, difference, scene
from lfcal.psf import PSFMatrix
from lfcal.reconstruct import Projector, richardson_lucy

__all__ = ["TrueCost"]

F4 = NDArray[np.float32]

SIDE_PX = 96
"""Pixels along each axis of the image at least: twice those of what an inspection reconstructs."""

SEED = 5
"""Of the scene: other points than an inspection's."""


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
        rows, columns = (-(-SIDE_PX // n) * n for n in light.shape[1:3])
        self._shape = rows, columns
        self._image = self._projector(light).forward(scene((len(light), rows, columns), SEED))
        self._reference = self._volume(light)
        self.clean = self.error(noisy)

    def error(self, values: F4) -> float:
        """Return the error of a reconstruction with an H, beside that with the true one (NRMSE)."""
        try:
            return difference(self._volume(values), self._reference)
        except InputError:  # so little light in sum that nothing can be reconstructed
            return 1.0

    def cost(self, values: F4) -> float:
        """Return what an H adds to the error that noise makes."""
        return self.error(values) - self.clean

    def _projector(self, values: F4) -> Projector:
        return Projector(PSFMatrix(values), self._shape, (0.0, 0.0), workers=1)

    def _volume(self, values: F4) -> NDArray[np.float64]:
        found = richardson_lucy(self._projector(values), self._image, ITERATIONS)
        return found.volume.astype(np.float64)
