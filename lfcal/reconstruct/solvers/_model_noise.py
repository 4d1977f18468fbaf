"""Model the noise of a recorded H: its contribution to the variance of pixels, and when iterations should end.

Entry ``H[p, v]`` with variance ``a + c H[p, v]`` adds ``sum_v (a + c H[p, v]) g[v]^2`` to the variance of pixel p of
the model ``H g``. This is added to data and model, like the square of the read noise (shifted Poisson: Snyder et al.
1995). The weight of a pixel then reflects its total variance. The errors of H are the same in every iteration. The
misfit therefore does not decrease to that of the frame's noise. It levels off, and any further decrease is noise of the
frame and of H that enters the volume. A run ends there.

The variance is that of the recorded H even if the noise of its patterns is reduced (`lfcal.psf.denoising`). The
remaining errors are shared by neighbouring voxels, so they add up in the image to about the same amount.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers.measurement import Measurement
from lfcal.reconstruct.solvers.planes import box_mean
from lfcal.reconstruct.solvers.smoothing import Sieve
from lfcal.reconstruct.solvers.solver import SolverRun

__all__ = ["LEAST_FALL", "ModelNoise"]

LEAST_FALL = 0.025
"""Relative decrease of the misfit per iteration (mean of the last two) below which only noise is left.

It was tested on beads, lines and smooth objects behind three arrays, with noise of 7 to 30 % in H. When a run ended,
the error of the volume had risen by at most 7 % from its minimum, or would still have fallen by at most 15 %.
"""

FEWEST = 10
"""Smallest number of iterations of a run."""


@dataclass(eq=False)
class ModelNoise:
    """Noise of H in one run.

    Attributes
    ----------
    projector
        Projector of the complete H.
    sieve
        Sieve applied to volumes.
    noise
        Variance of H's entries without light, and variance per unit of signal, for each plane, ``(nz, 2)``.
    gain
        Counts per photoelectron of the frame.
    ends
        Whether the run ends when the misfit levels off.
    misfits
        Misfit of each iteration so far; the last entry belongs to the current iteration.
    """

    projector: Projector
    sieve: Sieve
    noise: NDArray[np.float64]
    gain: float = 1.0
    ends: bool = True
    misfits: list[float] = field(default_factory=lambda: [0.0])

    @classmethod
    def of(cls, P: Projector, sieve: Sieve, run: SolverRun) -> ModelNoise | None:
        """Return the noise of H in a run; None if it is unknown.

        If there are held-out pixels, they end the run instead of the misfit.
        """
        noise = P.noise
        if noise is None:
            return None
        return cls(P, sieve, noise, 1.0 if run.noise is None else run.noise[0], run.held_out is None)

    def variance(self, volume: NDArray[Any]) -> NDArray[Any]:
        """Return the variance ``(Y, X)`` of the image of ``volume`` ``(nz, Y, X)`` due to the noise of H."""
        squares = np.square(self.sieve.apply(volume))
        window = self.projector.grid.cutout
        found = np.zeros(volume.shape[1:], volume.dtype)
        for plane, (floor, slope) in zip(squares, self.noise, strict=True):
            found += volume.dtype.type(floor * window[0] * window[1]) * box_mean(plane, window)
            plane *= plane.dtype.type(slope)
        found += np.maximum(self.projector.forward(squares), 0)
        return found

    def ratio(
        self, volume: NDArray[Any], model: NDArray[Any], mask: NDArray[np.bool_] | None, data: Measurement, floor: float
    ) -> NDArray[Any]:
        """Return data divided by model ``(Y, X)``, both with the variance of H, and accumulate the misfit.

        ``mask`` selects the pixels that count for the misfit (None: all). Values of the model below ``floor`` are
        rounding errors.
        """
        own = self.variance(volume) / model.dtype.type(self.gain)
        spread = np.maximum(model + own, floor)
        missed = data.image - model
        terms = data.weighted(missed * (missed / spread))
        self.misfits[-1] += float(np.sum(terms if mask is None else terms[mask], dtype=np.float64))
        found: NDArray[Any] = np.maximum(1 + missed / spread, 0)
        return found

    def settled(self) -> bool:
        """Return whether the misfit no longer decreases; call it once after each iteration."""
        self.misfits.append(0.0)
        done = self.misfits[:-1]
        return self.ends and len(done) >= FEWEST and done[-1] > (1 - 2 * LEAST_FALL) * done[-3]
