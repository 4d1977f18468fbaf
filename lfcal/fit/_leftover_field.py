"""What patterns show beyond a model, as a Gaussian field that is smooth over source positions and pixels.

A residual at one position and pixel is that of its neighbours: the source a step farther, the spot a pixel beside.
Light that a lenslet images moves with the velocity of the spots; stray light may lie still, or move against them. Each
such part is a field of variance (amplitude A)² whose correlation is Gaussian in the moving frame,

    k(δ, Δ) = exp(-δ² / 2 h²) exp(-(Δ - a δ)² / 2 w²) on each axis,

δ in source positions, Δ in pixels, a the velocity. The best linear estimate of the field from residuals with noise V is
K (K + V)⁻¹ R (kriging, or Gaussian process regression: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for
Machine Learning, 2006, eq. 2.25): where A² is far below the noise it is 0, where far above the residual itself. It is
solved by conjugate gradients. K = W Wᵀ with a smoothing W, so it is positive however W is cut off, and A W ξ are its
samples, from which the posterior variance is found (G. Papandreou, A. Yuille, NeurIPS 2010).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

__all__ = ["Moving", "ResidualField", "sampled_variance"]

F4 = NDArray[np.float32]

CUT = 0.02
"""Weight below which smoothing is cut off."""

ENOUGH = 1e-2
"""Residual of the equations, relative, at which they are solved."""

MOST = 50
"""Steps of conjugate gradients at most."""


@dataclass(frozen=True, slots=True)
class Moving:
    """Correlation of one part of the field.

    Attributes
    ----------
    velocity
        Pixels in the cutout by which it moves where the source goes on by one position.
    positions, pixels
        Correlation lengths h and w.
    """

    velocity: float
    positions: float
    pixels: float


def smoothing(n: int, size: int, by: Moving, *, around: bool) -> csr_matrix:
    """Return W of one axis, over (position, pixel) of ``n`` positions and ``size`` pixels; rows have unit square.

    ``around``: the last position neighbours the first, as in a whole period.
    """
    from scipy.sparse import csr_matrix, diags_array, eye_array, kron  # slow to load

    apart = np.arange(size)[:, None] - np.arange(size)
    reach = min(n - 1, math.floor(by.positions * math.sqrt(-math.log(CUT))))
    # of a period no neighbour is met both ways
    steps = range(max(-reach, -(n // 2)), min(reach, n - 1 - n // 2) + 1) if around else range(-reach, reach + 1)
    total = csr_matrix((n * size, n * size), dtype=np.float64)
    for step in steps:
        # half as wide in squares: W Wᵀ has the whole width
        weight = np.exp(-((step / by.positions) ** 2) - ((apart - by.velocity * step) / by.pixels) ** 2)
        weight[weight < CUT] = 0.0
        ahead = eye_array(n, k=-step, format="csr")
        if around and step:
            ahead = ahead + eye_array(n, k=n - step if step > 0 else -n - step, format="csr")
        total = total + kron(ahead, csr_matrix(weight), format="csr")
    total.eliminate_zeros()
    length = np.sqrt(np.asarray(total.multiply(total).sum(1)).ravel())
    return csr_matrix((diags_array(1.0 / length) @ total).astype(np.float32))


class ResidualField:
    """The sum of several parts over positions and pixels ``(ny, nx, nt, ns)``.

    Parameters
    ----------
    parts
        Correlation of each part.
    amplitudes
        Standard deviation of each part at every entry.
    around
        Whether positions are a whole period.
    """

    def __init__(self, parts: Sequence[Moving], amplitudes: Sequence[F4], *, around: bool) -> None:
        ny, nx, nt, ns = self.shape = amplitudes[0].shape
        self.amplitudes = tuple(amplitudes)
        self._smoothing = [
            (smoothing(ny, nt, part, around=around), smoothing(nx, ns, part, around=around)) for part in parts
        ]

    @property
    def variance(self) -> F4:
        """Variance of every entry before anything is measured."""
        found: F4 = np.sum([np.square(a) for a in self.amplitudes], axis=0, dtype=np.float32)
        return found

    def covariance(self, values: F4) -> F4:
        """Return K ``values``."""
        ny, nx, nt, ns = self.shape
        out = np.zeros_like(values)
        for (rows, columns), amplitude in zip(self._smoothing, self.amplitudes, strict=True):
            flat = (amplitude * values).transpose(0, 2, 1, 3).reshape(ny * nt, nx * ns)
            flat = (columns.T @ (rows.T @ flat).T).T
            flat = (columns @ (rows @ flat).T).T
            out += amplitude * flat.reshape(ny, nt, nx, ns).transpose(0, 2, 1, 3)
        return out

    def sample(self, rng: np.random.Generator) -> F4:
        """Return a field drawn at random."""
        ny, nx, nt, ns = self.shape
        out = np.zeros(self.shape, np.float32)
        for (rows, columns), amplitude in zip(self._smoothing, self.amplitudes, strict=True):
            flat = rng.standard_normal((ny * nt, nx * ns), np.float32)
            flat = (columns @ (rows @ flat).T).T
            out += amplitude * flat.reshape(ny, nt, nx, ns).transpose(0, 2, 1, 3)
        return out

    def estimate(self, residual: F4, precision: F4) -> F4:
        """Return the best estimate of the field from residuals of variance 1 / ``precision``; 0: not measured."""
        root = np.sqrt(precision)
        preconditioner = 1.0 + precision * self.variance
        wanted = root * residual
        found, left = np.zeros_like(wanted), wanted.copy()
        nearer = left / preconditioner
        way = nearer.copy()
        size = float(np.vdot(left, nearer))
        goal = ENOUGH**2 * size
        for _ in range(MOST):
            if size <= goal or size == 0.0:
                break
            turned = way + root * self.covariance(root * way)
            step = np.float32(size / float(np.vdot(way, turned)))
            found += step * way
            left -= step * turned
            nearer = left / preconditioner
            before, size = size, float(np.vdot(left, nearer))
            way = nearer + np.float32(size / before) * way
        return self.covariance(root * found)


def sampled_variance(field: ResidualField, precision: F4, count: int, rng: np.random.Generator) -> F4:
    """Return the variance of the field about its estimate, as a mean over ``count`` samples."""
    total = np.zeros(field.shape, np.float32)
    noise = np.where(precision > 0, 1.0 / np.sqrt(np.maximum(precision, 1e-30)), 0.0).astype(np.float32)
    for _ in range(count):
        true = field.sample(rng)
        data = true + noise * rng.standard_normal(field.shape, np.float32)
        total += np.square(true - field.estimate(data, precision))
    return total / np.float32(count)
