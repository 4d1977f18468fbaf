"""The pupil as it is described: the iris's shape and the main lens's aberrations."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_number

__all__ = ["PupilIris", "Wavefront", "check_wavefront", "pixel_response", "seidel"]

Wavefront = tuple[tuple[int, int, float], ...]
"""Zernike terms ``(n, m, waves)``."""


@dataclass(frozen=True, slots=True)
class PupilIris:
    """The main lens's iris, in units of the radius of the disc f/(2 N): its area is that disc's, pi.

    Attributes
    ----------
    blades
        Number of blades; 0 is a circle.
    curvature
        Apothem over blade radius: 0 straight edges, 1 a circle.
    rotation_rad
        Angle of the first vertex from +x towards +y.
    stop
        A second, circular stop ``(x, y, radius)`` that cuts the pupil seen from off axis (mechanical
        vignetting), or None. It takes light away: what is left has less than the unit energy.
    """

    blades: int = 0
    curvature: float = 0.0
    rotation_rad: float = 0.0
    stop: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check every value."""
        check_number("iris blades", self.blades, at_least=0, at_most=64, integer=True)
        if self.blades in (1, 2):
            check_number("iris blades", self.blades, at_least=3, remedy="use 0 for a circular iris")
        check_number("blade curvature", self.curvature, at_least=0, at_most=1)
        check_number("blade rotation (rad)", self.rotation_rad)
        if self.stop is not None:
            object.__setattr__(self, "stop", tuple(float(v) for v in self.stop))
            if len(self.stop) != 3:
                raise InputError.expected("second stop", "(x, y, radius)", self.stop, "give three numbers")
            for value in self.stop:
                check_number("second stop (pupil radii)", value)
            check_number("second stop's radius (pupil radii)", self.stop[2], above=0)

    @property
    def circular(self) -> bool:
        """Whether the iris is a plain circle."""
        return (self.blades == 0 or self.curvature == 1) and self.stop is None


MAX_ORDER = 40
"""Largest order n of a Zernike term: beyond, its polynomial's coefficients cancel to rounding."""


def check_wavefront(terms: Iterable[tuple[int, int, float]]) -> None:
    """Raise `InputError` unless every term ``(n, m, waves)`` is a finite share of a Zernike polynomial."""
    for n, m, waves in terms:
        check_number("wavefront coefficient (waves)", waves)
        check_number("order of a Zernike term", n, at_least=0, at_most=MAX_ORDER)
        # Zernike radial polynomials exist for these indices only
        if n != int(n) or m != int(m) or n < 0 or abs(m) > n or (n - abs(m)) % 2:
            raise InputError.expected(
                "Zernike term", "n >= |m| >= 0 with n - |m| even", f"n={n:g}, m={m:g}", "correct it"
            )


def seidel(*, spherical: float = 0.0, coma: float = 0.0, angle_rad: float = 0.0) -> Wavefront:
    """Return the Zernike terms of Seidel W040 rho^4 + W131 rho^3 cos(theta - angle), coefficients in waves.

    rho^4 = (R40 + 3 R20 + 2 R00) / 6 and rho^3 = (R31 + 2 R11) / 3.
    """
    # Zernike terms are 1 at the rim (not orthonormal); piston and defocus of the expansion stay in, so that the
    # wavefront is the Seidel one exactly
    terms: list[tuple[int, int, float]] = []
    if spherical:
        terms += [(4, 0, spherical / 6), (2, 0, spherical / 2), (0, 0, spherical / 3)]
    if coma:
        for m, part in ((1, math.cos(angle_rad)), (-1, math.sin(angle_rad))):
            terms += [(3, m, coma * part / 3), (1, m, coma * part * 2 / 3)]
    return tuple(terms)


def pixel_response(power: float, sine_y: ArrayLike, sine_x: ArrayLike) -> NDArray[np.float64]:
    """Return cos^power of the angle of rays with these sines; 0 where there is no such ray."""
    square = np.square(sine_y) + np.square(sine_x)
    response: NDArray[np.float64] = np.clip(1.0 - square, 0.0, None) ** (power / 2)
    return response
