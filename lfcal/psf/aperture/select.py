"""How many blades: compare the edge profile with the harmonic combs of irises."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.aperture.profile import ANGLES, RAYS
from lfcal.psf.aperture.shape import blade_radius

__all__ = ["BLADES", "Candidate", "candidates", "strongest_harmonic"]

BLADES = range(4, 16)
"""Blade counts that are distinguished; 3 looks like a tilted lens's trefoil."""

CURVATURES = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.85)
HARMONICS = 60
LOWEST = 3
"""Harmonics 0, 1 and 2 hold size, centre and ellipticity, not blades."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """An iris that may explain a profile; ``blades`` 0 is the circle. A lower ``bic`` is better."""

    bic: float
    blades: int
    rotation_rad: float = 0.0
    curvature: float = 0.0
    apothem_px: float = 0.0


# the same few combs serve every profile of every plane
@functools.cache
def _comb(blades: int, curvature: float) -> tuple[float, NDArray[np.complex128], float]:
    """Return mean radius, spectrum from `LOWEST` on, and energy of a unit iris with a vertex at angle 0."""
    spectrum = np.fft.rfft(blade_radius(ANGLES, blades, 0.0, 1.0, curvature)) / RAYS
    mean = float(spectrum[0].real)
    return mean, *_banded(spectrum)


def _banded(spectrum: NDArray[np.complex128]) -> tuple[NDArray[np.complex128], float]:
    banded = spectrum.copy()
    banded[:LOWEST] = 0
    banded[HARMONICS + 1 :] = 0
    # a real signal's spectrum holds each harmonic twice, at +k and -k
    return banded, 2 * float((np.abs(banded) ** 2).sum())


def candidates(edge: NDArray[np.float64]) -> list[Candidate]:
    """Return the circle and one iris per blade count, best first, by the Bayesian information criterion.

    An iris has no free size: its mean radius is the profile's. Rotation comes from the peak of the circular
    correlation of profile and iris, curvature from a grid.

    Parameters
    ----------
    edge
        Edge radius over `lfcal.psf.aperture.profile.ANGLES`, ``(RAYS,)`` (pixels).
    """
    spectrum = np.fft.rfft(edge) / RAYS
    data, total = _banded(spectrum)
    # two real numbers per complex harmonic
    samples = 2 * (HARMONICS - LOWEST + 1)
    found = [Candidate(samples * math.log(max(total * RAYS, 1e-12) / samples), 0)]
    for blades in BLADES:
        best = (math.inf, 0.0, 0.0, 0.0)
        for curvature in CURVATURES:
            mean, comb, energy = _comb(blades, curvature)
            apothem = float(spectrum[0].real) / mean
            # all curvatures and rotations of a count in one correlation: a vertex at angle 0 turns by a phase
            correlation = np.fft.irfft(data * np.conj(comb), RAYS) * RAYS
            k = int(np.argmax(correlation))
            error = total - 2 * apothem * float(correlation[k]) + apothem**2 * energy
            # an iris looks the same after one blade, so its rotation is known up to that
            if error < best[0]:
                best = (error, float(ANGLES[k]) % (2 * math.pi / blades), curvature, apothem)
        error = max(best[0] * RAYS, 1e-12)
        # Bayesian information criterion: samples log(variance) + parameters log(samples)
        bic = samples * math.log(error / samples) + 3 * math.log(samples)
        found.append(Candidate(bic, blades, *best[1:]))
    return sorted(found, key=lambda c: c.bic)


def strongest_harmonic(edge: NDArray[np.float64]) -> int:
    """Return the blade count whose fundamental is strongest in the profile: a second opinion."""
    size = np.abs(np.fft.rfft(edge))
    return BLADES[int(np.argmax(size[BLADES.start : BLADES.stop]))]
