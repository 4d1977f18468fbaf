"""Position of micro-images relative to the lattice for an iris without a centre of symmetry.

Micro-images of an iris with an odd number of blades touch at points that are not opposite each other. The light of
neighbours then moves the point of best symmetry away from the middle of the iris, by a tenth of a pitch or more. The
Fourier coefficients of the lattice equal the ones of a single micro-image, even if neighbours overlap; for a polygon,
they are known in closed form. A polygon fitted to them separates the centre from the effect of the corners.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.lattice._forms import thinned
from lfcal.lattice._micro_image import SAMPLES_PER_PIXEL, mean_micro_image
from lfcal.lattice._model import LatticeModel

__all__ = ["IrisCentre", "iris_centre"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SHELLS = 6
"""Number of different lengths of the waves that are used, which are the shortest ones."""

BLADES = (3, 5, 7, 9, 11)
"""Odd numbers of blades; with an even number, the centre is the centre of symmetry."""

MIN_IMPROVEMENT = 4.0
"""Smallest factor by which a polygon must reduce the odd residuals of a symmetric micro-image (sums of squares)."""

STEPS = 30
"""Largest number of steps of a fit: the right polygon takes ten to twenty, others need not converge."""

STARTS = 2
"""Number of starts, the best of a grid of radii and rotations, from which a polygon is fitted."""

FIRST_WAVES = 1.25
"""Largest ratio of the lengths of a lattice's first waves to the shortest in two directions."""

MAX_OFFSET = 0.25
"""Largest distance of the centre, in pitches."""

SCALE = np.array([0.1, 0.1, 1.0, 0.3, 0.1, 0.3, 0.1])
"""Step sizes of the parameters: shift x, y, radius, blur (pixels), gain, odd share, rotation (rad)."""

STEP = 1e-7
"""Relative step for numerical derivatives, of each parameter or of 1."""

SAMPLED_PX = 80.0
"""Reach of a cell (pixels) up to which every sample of its table is used; for n times this reach, every nth is."""

CONTRAST = 1e-3
"""Fraction of the light below which a wave is not used."""


@dataclass(frozen=True, slots=True)
class IrisCentre:
    """Position of the middle of the iris relative to the lattice points.

    Attributes
    ----------
    shift
        ``(2,)`` as (x, y) from the lattice point (pixels).
    covariance
        ``(2, 2)`` covariance of the shift (pixels squared).
    blades
        Number of blades of the fitted polygon.
    """

    shift: Array
    covariance: Array
    blades: int


def iris_centre(
    image: NDArray[np.float32], model: LatticeModel, centres: Array, light: Array, workers: int | None = None
) -> IrisCentre | None:
    """Return the middle of an iris with an odd number of corners relative to the lattice points; None for others.

    Parameters
    ----------
    image
        White frame minus its dark level, with the fall-off of light removed.
    model
        The lattice.
    centres, light
        Lattice points (x, y) of working lenslets ``(n, 2)``, and the normalisation of each ``(n,)``.
    workers
        Number of threads. None: one for each available CPU core.
    """
    chosen = thinned(len(centres))
    about = _waves(image, model, centres[chosen], light[chosen], workers)
    if np.abs(about.found).max() < CONTRAST:
        return None
    pitch = float(min(model.pitch, model.row_pitch))
    symmetric = _symmetric(about, pitch)
    odd = min((_polygon(about, blades, pitch) for blades in BLADES), key=lambda fit: fit.cost)
    if MIN_IMPROVEMENT * odd.odd > symmetric.odd:
        # for a symmetric iris, the centre of symmetry is more accurate, as unequal neighbours do not affect it
        return None
    middle = odd.by_first(about)
    return middle if math.hypot(*middle.shift) < MAX_OFFSET * pitch else None


@dataclass(frozen=True, slots=True)
class _Waves:
    """First waves of a lattice ``(n, 2)`` as (x, y) (per pixel), one of each pair, and their fractions of the light."""

    wave: Array
    found: Complex

    def moved(self, shift: Array) -> Complex:
        """Return the fractions ``(..., n)`` about points ``shift`` ``(..., 2)`` as (x, y) from the lattice point."""
        shares: Complex = self.found * np.exp(2j * np.pi * (shift @ self.wave.T))
        return shares


def _waves(
    image: NDArray[np.float32], model: LatticeModel, centres: Array, light: Array, workers: int | None
) -> _Waves:
    """Return the waves of the mean micro-image about ``centres``."""
    basis = model.basis()
    inverse = np.linalg.inv(basis)
    reach = float(np.abs(basis).sum(0).max())
    micro = mean_micro_image(image, centres, light, reach, workers)
    # the first waves need no more samples of a large cell
    every = max(1, int(reach / SAMPLED_PX))
    middle = micro.table.shape[0] // 2
    table = micro.table[middle % every :: every, middle % every :: every]
    side = (np.arange(len(table)) - middle // every) * every / SAMPLES_PER_PIXEL
    index = np.stack(np.broadcast_arrays(side, side[:, None]), -1) @ inverse
    # a triangular window of two cells along each axis: its transform vanishes at all other waves of the lattice
    share = table * np.clip(1 - np.abs(index), 0, None).prod(-1)
    counts = np.array([(a, b) for a in range(-4, 5) for b in range(-4, 5) if (a, b) > (0, 0)])
    wave = counts @ inverse.T
    length = np.hypot(*wave.T) / np.hypot(*wave.T).min()
    kept = length < 1.02 * np.unique(length.round(2))[:SHELLS].max()
    values = [(share * np.exp(-2j * np.pi * (index @ count))).sum() for count in counts[kept]]
    return _Waves(wave[kept], np.array(values) / share.sum())


def _transforms(wave: Array, blades: int, radius: Array, rotation_rad: Array) -> Complex:
    """Return the Fourier transforms ``(m, n)`` of regular polygons over their areas, at waves ``(n, 2)`` (per pixel).

    By the divergence theorem, each is a sum over the sides; each side contributes a sinc about its middle.

    Parameters
    ----------
    wave
        Waves (x, y), none of them 0.
    blades
        Number of corners.
    radius
        Radius of circles with the same area ``(m,)`` (pixels).
    rotation_rad
        Angle of the first corner ``(m,)`` (rad).
    """
    area = math.pi * radius**2
    corner = np.sqrt(2 * area / (blades * math.sin(2 * math.pi / blades)))
    angle = rotation_rad[:, None] + 2 * np.pi * np.arange(blades) / blades
    first = corner[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    last = np.roll(first, -1, axis=2)
    side, middle = last - first, (last + first) / 2
    # outward normals with the length of the side
    normal = np.stack([side[:, 1], -side[:, 0]], 1)
    turned = np.sinc(wave @ side) * np.exp(-2j * np.pi * (wave @ middle)) * (wave @ normal)
    transforms: Complex = 1j * turned.sum(2) / (2 * np.pi * (wave**2).sum(1) * area[:, None])
    return transforms


@dataclass(frozen=True, slots=True)
class _Fit(IrisCentre):
    """A fitted shape: its waves about its centre, the sum of squared residuals, and the odd part of it."""

    shape: Complex
    cost: float
    odd: float

    @classmethod
    def of(cls, about: _Waves, residuals: Callable[[Array], Array], start: Array, bounds: Array, blades: int) -> _Fit:
        """Return the least squares of ``residuals`` over parameters ``(k,)`` that begin with the shift.

        ``residuals`` takes several sets ``(m, k)`` and returns the residuals of the waves ``(m, 2n)``, odd parts first.
        """
        from scipy import optimize

        def slopes_at(p: Array) -> Array:
            steps = STEP * np.maximum(1, np.abs(p))
            residual: Array = residuals(np.vstack([p, p + np.diag(steps)]))
            return np.asarray(((residual[1:] - residual[0]) / steps[:, None]).T)

        def residual_of(p: Array) -> Array:
            return np.asarray(residuals(p[None])[0])

        fit = optimize.least_squares(
            residual_of,
            start,
            jac=slopes_at,
            bounds=(bounds[0], bounds[1]),
            x_scale=SCALE[: start.size],
            max_nfev=STEPS,
        )
        shift, residual, slopes = np.array(fit.x[:2]), np.asarray(fit.fun), np.asarray(fit.jac)
        variance = 2 * float(fit.cost) / max(1, residual.size - start.size)
        covariance = np.linalg.pinv(slopes.T @ slopes)[:2, :2] * variance
        centred, n = about.moved(shift), about.found.size
        # a symmetric shape has no odd part, and an arbitrary even one
        shape = centred - (residual[n:] + 1j * residual[:n]) if blades else centred.real.astype(np.complex128)
        return cls(shift, covariance, blades, shape, float(fit.cost), float(residual[:n] @ residual[:n]))

    def by_first(self, about: _Waves) -> IrisCentre:
        """Return the centre from the phases of the first waves only, minus the phases of the shape.

        Odd corners matter least for these waves, so that an approximate shape suffices. The difference from the fit to
        all waves is used as an error.
        """
        length = np.hypot(*about.wave.T)
        # two directions at least: of rectangular cells, the shortest waves all have one
        order = np.argsort(length, kind="stable")
        unit = about.wave[order] / length[order, None]
        other = np.abs(unit[:, 0] * unit[0, 1] - unit[:, 1] * unit[0, 0]) > 0.1
        first = length < FIRST_WAVES * length[order][int(np.argmax(other))]
        weight = np.abs(about.found[first])
        phase = np.angle(about.moved(self.shift)[first] / self.shape[first]) / (-2 * np.pi)
        rows = about.wave[first] * weight[:, None]
        inverse = np.linalg.inv(rows.T @ rows)
        more = inverse @ (rows.T @ (phase * weight))
        residual = phase * weight - rows @ more
        covariance = self.covariance + inverse * float(residual @ residual) + np.diag(more**2)
        return IrisCentre(self.shift + more, covariance, self.blades)


def _symmetric(about: _Waves, pitch: float) -> _Fit:
    """Return the centre about which a micro-image is even: there, the waves are real."""
    far = np.full(2, pitch / 3)
    return _Fit.of(about, lambda shift: about.moved(shift).imag, np.zeros(2), np.array([-far, far]), 0)


def _polygon(about: _Waves, blades: int, pitch: float) -> _Fit:
    """Return the centre of a polygon, with radius, blur, gain, odd share and rotation as free parameters."""
    square = (about.wave**2).sum(1)

    def residuals(p: Array) -> Array:
        shape = _transforms(about.wave, blades, p[:, 2], p[:, 6])
        # curved blades have a smaller odd part
        shape = p[:, 4:5] * (shape.real + 1j * p[:, 5:6] * shape.imag) * np.exp(-2 * np.pi**2 * square * p[:, 3:4] ** 2)
        residual = about.moved(p[:, :2]) - shape
        return np.concatenate([residual.imag, residual.real], 1)

    far = pitch / 3
    bounds = np.array([[-far, -far, 0.2 * pitch, 0, 0.3, 0, -7], [far, far, 0.65 * pitch, pitch / 5, 2, 1.3, 7]])
    starts = np.array(
        [
            (0, 0, radius * pitch, 0.5, 1, 1, turn * 2 * math.pi / blades)
            for radius in (0.36, 0.4, 0.44, 0.48, 0.52)
            for turn in np.arange(8) / 8
        ]
    )
    best = np.argsort(np.square(residuals(starts)).sum(1), kind="stable")[:STARTS]
    return min((_Fit.of(about, residuals, p, bounds, blades) for p in starts[best]), key=lambda fit: fit.cost)
