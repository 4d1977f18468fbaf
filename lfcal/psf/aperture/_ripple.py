"""The ripple that the lenslet lattice leaves on a depth-plane sum: plane waves, fitted inside the lit patch.

Sums over whole periods of the lattice have no ripple, except where spots are thinner than their spacing. The
remaining ripple is coherent: plane waves with the lattice's wave vectors. Where they cross an edge, they look like
blades. They are therefore fitted away from the edge and extrapolated to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.aperture._locate import offsets

__all__ = ["Ripple", "find_ripple"]

Values = NDArray[np.float64]

MOST = 12
"""Largest number of waves that are searched for; a hexagonal lattice has three, each with harmonics."""

CHANCE = 16.0
"""Smallest power of a wave over the mean of the noise; noise alone exceeds it in one of ``exp(16)`` places."""

SHORTEST = 4.0
"""Shortest pitch (pixels)."""

LONGEST = 1.0
"""Longest pitch in units of the radius; longer waves are treated as shading."""

SMALLEST = 12.0
"""Smallest radius in which waves can be distinguished from shading (pixels)."""


@dataclass(frozen=True, slots=True)
class Ripple:
    """Plane waves relative to the lit level of the patch.

    Attributes
    ----------
    waves
        ``(n, 2)`` wave vectors (column, row) (rad/pixel).
    cosine, sine
        ``(n,)`` amplitudes about the origin of the fit.
    """

    waves: Values
    cosine: Values
    sine: Values

    @property
    def amplitude(self) -> float:
        """Largest amplitude of any wave; 0 without waves."""
        return float(np.hypot(self.cosine, self.sine).max(initial=0.0))

    @property
    def pitch_px(self) -> float:
        """Pitch of the strongest wave (pixels); NaN without waves."""
        if not self.waves.size:
            return math.nan
        strongest = int(np.argmax(np.hypot(self.cosine, self.sine)))
        return 2 * math.pi / math.hypot(*self.waves[strongest])

    def at(self, x: Values, y: Values) -> Values:
        """Return the ripple at places relative to the origin, in an array of their shape."""
        total = np.zeros_like(x)
        for (u, v), c, s in zip(self.waves, self.cosine, self.sine, strict=True):
            phase = u * x + v * y
            total += c * np.cos(phase) + s * np.sin(phase)
        return total

    def removed(self, flat: Values, row: float, column: float, reach: float) -> Values:
        """Return ``flat`` divided by one plus the ripple, within ``reach`` of the origin."""
        if not self.waves.size:
            return flat
        x, y = offsets(flat.shape, row, column)
        factor = np.where(np.hypot(x, y) < reach, 1 + self.at(x, y), 1.0)
        clean: Values = flat / np.clip(factor, 0.5, 2.0)
        return clean


NONE = Ripple(np.zeros((0, 2)), np.zeros(0), np.zeros(0))


def find_ripple(flat: Values, row: float, column: float, radius: float) -> Ripple:
    """Return the plane waves inside a disc that are significant against the noise.

    The strongest peaks of the spectrum are added one after the other. After each, all waves found so far are fitted
    again together with a paraboloid: amplitudes, phases and wave vectors (Gauss-Newton).

    Parameters
    ----------
    flat
        Image normalised to a lit level of 1.
    row, column, radius
        Centre and radius of the disc, well inside the edge (pixels).
    """
    if radius < SMALLEST:
        return NONE
    x, y = offsets(flat.shape, row, column)
    inside = np.hypot(x, y) < radius
    fit = _WaveFit(x[inside], y[inside], flat[inside] - 1.0, radius)
    size = 1 << math.ceil(math.log2(2 * max(flat.shape)))
    fx, fy = np.fft.fftfreq(size)[None, :], np.fft.rfftfreq(size)[:, None]
    q = np.hypot(fx, fy)
    # count each wave once: use the rows of the half spectrum, and one half of row 0
    once = (fy > 0) | (fx > 0)
    band = (q > 1 / (LONGEST * radius)) & (q < 1 / SHORTEST) & once
    quiet = (q > 1 / (LONGEST * radius)) & once
    # a taper keeps a strong wave from hiding weak ones behind its side lobes
    taper = np.cos(math.pi / 2 * np.hypot(x[inside], y[inside]) / radius)
    picture = np.zeros((size, size))
    places = np.nonzero(inside)
    waves = np.zeros((0, 2))
    ripple = fit.fitted(waves)
    for _ in range(MOST):
        picture[places] = fit.left * taper
        power = np.abs(np.fft.rfft2(picture.T).T) ** 2
        # the power of noise is exponentially distributed: its median is ln 2 times its mean
        noise = float(np.median(power[quiet])) / math.log(2)
        k, m = np.unravel_index(int(np.argmax(np.where(band, power, 0.0))), power.shape)
        if not power[k, m] > CHANCE * noise:
            break
        more = np.vstack([waves, [2 * math.pi * fx[0, m], 2 * math.pi * fy[k, 0]]])
        found = fit.fitted(more)
        length = np.hypot(*found.waves.T)
        if (length < 2 * math.pi / (1.2 * LONGEST * radius)).any() or found.amplitude > 1:
            fit.fitted(waves)  # two waves that cancel, or shading: a lattice does not produce these
            break
        waves, ripple = found.waves, found
    return ripple


class _WaveFit:
    """Least-squares fit of plane waves and a paraboloid to a disc's pixels; ``left`` is the last fit's residual."""

    def __init__(self, x: Values, y: Values, value: Values, radius: float) -> None:
        self.x, self.y, self.value, self.radius = x, y, value, radius
        u, v = x / radius, y / radius
        self.base = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], 1)
        self.left = value

    def fitted(self, waves: Values) -> Ripple:
        """Return the refined waves with their amplitudes."""
        for last in (False, False, True):
            phase = np.outer(self.x, waves[:, 0]) + np.outer(self.y, waves[:, 1])
            cos, sin = np.cos(phase), np.sin(phase)
            terms = np.concatenate([self.base, cos, sin], 1)
            found = _solve(terms, self.value)
            self.left = self.value - terms @ found
            c, s = np.split(found[6:], 2)
            if last or not len(waves):
                break
            turn = s * cos - c * sin  # the derivative with respect to phase
            slopes = np.concatenate([terms, turn * self.x[:, None], turn * self.y[:, None]], 1)
            step = _solve(slopes, self.left)[6 + 2 * len(waves) :]
            # a peak is known to a fraction of the spectrum's resolution
            step = np.clip(step, -0.5 / self.radius, 0.5 / self.radius)
            waves = waves + step.reshape(2, -1).T
        return Ripple(waves, c, s)


def _solve(terms: Values, values: Values) -> Values:
    """Return the least-squares solution by normal equations: few unknowns, thousands of pixels."""
    normal = terms.T @ terms
    normal[np.diag_indices_from(normal)] *= 1 + 1e-9
    solution: Values = np.asarray(np.linalg.solve(normal, terms.T @ values), np.float64)
    return solution
