"""Distortion of the micro-image lattice, and lens distortion as stated by a manufacturer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import hypot, isqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, any_of, check_choice, check_number, check_tuple, check_type, format_count

__all__ = ["MODELS", "BrownDistortion", "LatticeDistortion", "monomials", "polynomial_powers"]

Array = NDArray[np.float64]
MODELS = ("polynomial", "radial")

REACH = 1.25
"""Distance from the centre, in length scales, beyond which the displacement is continued linearly."""

MAX_DEGREE = 7
STEP = 1e-3
"""Step of the finite differences for derivatives, in length scales: exact to 1e-6 of the derivative."""

INVERSE_ROUNDS = 60
INVERSE_TOLERANCE = 1e-12
"""Largest last step of the inversion, relative to the sum of the length scale and the largest coordinate."""


@dataclass(frozen=True, slots=True)
class BrownDistortion:
    """Radial lens distortion after Brown's model, as stated in a calibration file.

    Such files state neither the unit of the radius nor the corner from which the centre is measured. The coefficients
    are therefore stored but not applied.

    Attributes
    ----------
    coefficients
        Radial coefficients k1, k2, … in the order of the file.
    centre_px
        Centre of distortion (x, y) as in the file (px).

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lfcal.camera import BrownDistortion, preset
    >>> camera = replace(preset("r29"), distortion=BrownDistortion((-0.0015, 0.0007), (3288.0, 2192.0)))
    >>> print(camera.distortion)
    BrownDistortion(coefficients=(-0.0015, 0.0007), centre_px=(3288.0, 2192.0))
    """

    coefficients: tuple[float, ...]
    centre_px: tuple[float, float]

    def __post_init__(self) -> None:
        """Check every value."""
        values = check_tuple("distortion coefficients", self.coefficients)
        object.__setattr__(self, "coefficients", values)
        object.__setattr__(self, "centre_px", check_tuple("distortion centre (x, y) (px)", self.centre_px, 2))


def polynomial_powers(degree: int) -> list[tuple[int, int]]:
    """Return the powers (i, j) of u^i v^j from order 2 to ``degree``: u², uv, v², then u³, u²v, and so on."""
    return [(order - j, j) for order in range(2, degree + 1) for j in range(order + 1)]


def monomials(u: Array, degree: int) -> Array:
    """Return u_x^i u_y^j at the points ``u``, ``(..., 2)``, as an array ``(..., terms)``.

    The powers (i, j) are those of ``polynomial_powers(degree)``, in this order.
    """
    powers = polynomial_powers(degree)
    x, y = _powers(u, degree)
    found = np.empty((len(powers), *u.shape[:-1]))
    for k, (i, j) in enumerate(powers):
        found[k] = x[i] * y[j]
    return np.moveaxis(found, 0, -1)


def _powers(u: Array, degree: int) -> tuple[list[Array], list[Array]]:
    """Return u_x^n and u_y^n for n = 0 … ``degree``."""
    both = []
    for axis in (0, 1):
        powers = [np.ones(u.shape[:-1])]
        for _ in range(degree):
            powers.append(powers[-1] * u[..., axis])
        both.append(powers)
    return both[0], both[1]


def _monomial_slopes(u: Array, degree: int) -> Array:
    """Return the derivatives of `monomials` with respect to u_x and u_y: ``(..., 2, terms)``."""
    powers = polynomial_powers(degree)
    x, y = _powers(u, degree)
    found = np.zeros((2, len(powers), *u.shape[:-1]))
    for k, (i, j) in enumerate(powers):
        if i:
            found[0, k] = i * x[i - 1] * y[j]
        if j:
            found[1, k] = j * x[i] * y[j - 1]
    return np.moveaxis(found, (0, 1), (-2, -1))


def _radial_slopes(u: Array, terms: int) -> Array:
    """Return the derivatives of |u|² u, |u|⁴ u, … (rows) with respect to u (columns): ``(..., 2, 2, terms)``."""
    square = (u**2).sum(-1)[..., None, None]
    outer = u[..., :, None] * u[..., None, :]
    return np.stack([square**m * np.eye(2) + 2 * m * square ** (m - 1) * outer for m in range(1, terms + 1)], axis=-1)


@lru_cache(maxsize=16)
def _slopes_within_reach(model: str, count: int) -> Array:
    """Return `_radial_slopes` (``count`` terms) or `_monomial_slopes` (degree ``count``) on the disc |u| <= `REACH`."""
    grid = np.linspace(-REACH, REACH, 15)
    points = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    inside = points[np.hypot(*points.T) <= REACH]
    return _radial_slopes(inside, count) if model == "radial" else _monomial_slopes(inside, count)


@dataclass(frozen=True, slots=True)
class LatticeDistortion:
    """Smooth displacement of the micro-images from an ideal lattice.

    A point x = (x, y) of the ideal lattice, with u = (x - centre) / scale, is displaced by

    - ``"polynomial"``: sum over orders 2 … n of ``terms[0][k]`` u_x^i u_y^j along x, and of ``terms[1][k]`` along y, in
      the order of `polynomial_powers`;
    - ``"radial"``: (k1 |u|² + k2 |u|⁴ + …) u with terms[0] = (k1, k2, …), after Brown (1966).

    Constant and linear displacements are part of the ideal lattice. All lengths have the unit of the lattice: µm from
    the sensor's centre in a `LensletLattice`, and pixels (column, row) in a `lfcal.lattice.LatticeFit`. At distances of
    more than `REACH` times ``scale`` from the centre, the displacement is extrapolated linearly, so that distant
    lenslets remain in order.

    Attributes
    ----------
    model
        ``"polynomial"`` or ``"radial"``.
    centre
        Point (x, y) of the ideal lattice at which u = 0, in the unit of the lattice.
    scale
        Distance from the centre at which |u| = 1, in the unit of the lattice.
    terms
        Coefficients in the unit of the lattice: two tuples for the polynomial (along x and along y), one for the radial
        model.

    Raises
    ------
    InputError
        If the number of terms is wrong. Also if, within `REACH` times ``scale`` from the centre, the distortion
        reverses the order of lenslets or shrinks an area to less than 0.1 of its size.

    Examples
    --------
    >>> from lfcal.camera import LatticeDistortion
    >>> barrel = LatticeDistortion("radial", (0.0, 0.0), 1000.0, ((-3.0,),))
    >>> print(barrel.displacement([[600.0, 800.0], [300.0, 400.0]]).round(3).tolist())
    [[-1.8, -2.4], [-0.225, -0.3]]
    >>> print(round(barrel.largest, 3), barrel.invert(barrel.apply([[600.0, 800.0]])).round(6).tolist())
    3.0 [[600.0, 800.0]]
    """

    model: str
    centre: tuple[float, float]
    scale: float
    terms: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        """Check every value, and that no two points are mapped to the same position."""
        check_choice("model of the lattice's distortion", self.model, MODELS)
        object.__setattr__(self, "centre", check_tuple("centre of the distortion (x, y)", self.centre, 2))
        check_number("length scale of the distortion", self.scale, above=0)
        check_type("terms of the distortion", self.terms, (tuple, list))
        object.__setattr__(self, "terms", tuple(check_tuple("terms of the distortion", t) for t in self.terms))
        self._check_counts()
        slopes = _slopes_within_reach(self.model, len(self.terms[0]) if self.model == "radial" else self.degree)
        with np.errstate(over="ignore", invalid="ignore"):  # terms that overflow are refused below
            stretched = np.eye(2) + self._weighted(slopes) / self.scale
            least = float(np.linalg.det(stretched).min())
            # if both directions are inverted, the area is positive again
            turned = float(stretched.trace(axis1=-2, axis2=-1).min())
        if not (least > 0.1 and turned > 0):
            got = f"one that shrinks an area to {least:.2g} of its size"
            if not (np.isfinite(least) and np.isfinite(turned)):
                got = "terms too large to evaluate"
            elif least <= 0 or turned <= 0:
                got = "one that reverses their order"
            raise InputError.expected(
                "distortion of the lattice",
                "one that keeps the order of neighbouring lenslets and shrinks no area to less than 0.1 of its size",
                got,
                "reduce its terms, or correct its scale",
            )

    def _check_counts(self) -> None:
        counts = [len(t) for t in self.terms]
        if self.model == "radial":
            if len(counts) != 1 or not 1 <= counts[0] <= 4:
                raise InputError.expected(
                    "terms of a radial distortion",
                    "one list of 1 to 4 terms",
                    f"{format_count(len(counts), 'list', 'lists')} of {' and '.join(map(str, counts))} terms"
                    if counts
                    else "no list",
                    "give a single list, without the terms of higher order",
                )
            return
        right = [len(polynomial_powers(n)) for n in range(2, MAX_DEGREE + 1)]
        if len(counts) != 2 or counts[0] != counts[1] or counts[0] not in right:
            raise InputError.expected(
                "terms of a polynomial distortion",
                f"two lists of {any_of(map(str, right))} terms each",
                f"lists of {' and '.join(map(str, counts))} terms" if counts else "no lists",
                "write 0 for each term that is not known",
            )

    @property
    def degree(self) -> int:
        """Highest power of u in the displacement."""
        if self.model == "radial":
            return 2 * len(self.terms[0]) + 1
        # orders 2 … n hold (n + 1)(n + 2)/2 - 3 terms
        return (isqrt(8 * (len(self.terms[0]) + 3) + 1) - 3) // 2

    def _inner(self, u: Array) -> Array:
        if self.model == "radial":
            square = (u**2).sum(-1, keepdims=True)
            gain = np.zeros_like(square)
            for k in reversed(self.terms[0]):
                gain = (gain + k) * square
            result: Array = gain * u
            return result
        displaced: Array = monomials(u, self.degree) @ np.array(self.terms).T
        return displaced

    def _weighted(self, slopes: Array) -> Array:
        """Return the derivative ``(..., 2, 2)`` of the displacement with respect to u, from that of its terms."""
        terms = np.array(self.terms)
        found: Array = slopes @ terms[0] if self.model == "radial" else (slopes @ terms.T).swapaxes(-1, -2)
        return found

    def displacement(self, points: ArrayLike) -> Array:
        """Return the displacements (x, y), ``(..., 2)``, of points (x, y) of the ideal lattice, in the same unit."""
        u = (np.asarray(points, float) - np.array(self.centre)) / self.scale
        radius = np.hypot(u[..., 0], u[..., 1])
        far = radius > REACH
        if not far.any():
            return self._inner(u)
        outward = u[far] / radius[far][:, None]
        result = self._inner(np.where(far[..., None], 0.0, u))
        slope = (self._inner((REACH + STEP) * outward) - self._inner((REACH - STEP) * outward)) / (2 * STEP)
        result[far] = self._inner(REACH * outward) + (radius[far] - REACH)[:, None] * slope
        return result

    def apply(self, points: ArrayLike) -> Array:
        """Return the distorted positions (x, y), ``(..., 2)``, of points (x, y) of the ideal lattice, in its unit."""
        seen: Array = np.asarray(points, float) + self.displacement(points)
        return seen

    def invert(self, seen: ArrayLike) -> Array:
        """Return the ideal points (x, y), ``(..., 2)``, of the distorted positions ``seen``; inverse of `apply`.

        Raises
        ------
        InputError
            If a point is not finite, or is so far from the centre that the distortion cannot be inverted.
        """
        target = np.asarray(seen, float)
        points = target.copy()
        if not points.size:
            return points
        if bad := int((~np.isfinite(target)).any(axis=-1).sum()):
            raise InputError.expected(
                "distorted positions",
                "finite numbers",
                f"NaN or infinity in {bad} of them",
                "leave these positions out",
            )
        # the derivative changes little: the one of the first iteration serves all
        inverse = np.linalg.inv(self.jacobian(points))
        for _ in range(INVERSE_ROUNDS):
            step = np.einsum("...ij,...j->...i", inverse, target - self.apply(points))
            points += step
            if np.abs(step).max() <= INVERSE_TOLERANCE * (self.scale + float(np.abs(points).max())):
                return points
        raise InputError(
            "distortion of the lattice: cannot be inverted at points beyond the sensor; use points near the sensor"
        )

    def jacobian(self, points: ArrayLike) -> Array:
        """Return the Jacobian of `apply`, ``(..., 2, 2)``; rows are the distorted, columns the ideal x and y."""
        at, step = np.asarray(points, float), STEP * self.scale
        u = (at - np.array(self.centre)) / self.scale
        far = np.hypot(u[..., 0], u[..., 1]) > REACH
        near, terms = np.where(far[..., None], 0.0, u), len(self.terms[0])
        slopes = _radial_slopes(near, terms) if self.model == "radial" else _monomial_slopes(near, self.degree)
        jacobian: Array = np.eye(2) + self._weighted(slopes) / self.scale
        if far.any():
            out = at[far]
            changes = [self.displacement(out + e) - self.displacement(out - e) for e in step * np.eye(2)]
            jacobian[far] = np.stack(changes, axis=-1) / (2 * step) + np.eye(2)
        return jacobian

    @property
    def largest(self) -> float:
        """Largest length of the displacement within the distance `scale` from the centre, in the unit of the lattice.

        It is the maximum over 720 points on ten circles.
        """
        angle = np.linspace(0, 2 * np.pi, 73)[:-1]
        ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        points = (np.linspace(0, 1, 11)[:, None, None] * ring * self.scale).reshape(-1, 2) + np.array(self.centre)
        return max(hypot(x, y) for x, y in self.displacement(points))

    def scaled(self, factor: float, shift: tuple[float, float] = (0.0, 0.0)) -> LatticeDistortion:
        """Return the distortion in transformed coordinates ``factor * (x, y) + shift``, for another unit or origin.

        The displacements are scaled by ``factor``, too, which must be positive; ``shift`` is in the new unit.
        """
        check_number("factor of the distortion", factor, above=0)
        x, y = (factor * c + s for c, s in zip(self.centre, shift, strict=True))
        terms = tuple(tuple(factor * t for t in line) for line in self.terms)
        return replace(self, centre=(x, y), scale=factor * self.scale, terms=terms)
