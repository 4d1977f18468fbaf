"""The iris, estimated from the depth-plane sums of all planes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfcal.psf.aperture._verdict import CERTAIN
from lfcal.psf.aperture.shape import Aperture, CountFit

__all__ = ["Iris", "joint_iris"]

USABLE = ("", "unclear")
"""Reasons for refusal with which a plane still adds to the evidence of a clear plane."""

REGULAR = ("", "round", "polygon", "rounded polygon")

ROTATION_FLOOR = math.radians(0.2)
"""Smallest standard error of a rotation, due to the size of pixels."""

COMMON = 0.02
"""Error of the curvature that all planes share, because the lenslets' blur is the same in all of them."""

AGREE = 3.0
"""Deviation of a plane from the mean, in standard errors, above which planes contradict each other."""


@dataclass(frozen=True, slots=True)
class Iris:
    """Shape of the camera's iris, estimated jointly from all depth planes.

    Attributes
    ----------
    blades
        Number of blades; 0 for a circular iris.
    rotation_rad
        Direction of the first vertex (rad), from +column towards +row, in planes that show the iris upright, in [0, 2
        pi / blades). If the blades are odd in number and no plane is known to be upright or inverted, the angle may
        refer to inverted planes.
    curvature, curvature_sigma
        Curvature of the blades (0: straight, 1: circular), and its standard error.
    planes
        Number of planes used.
    margin
        Chi-square of the second-best number of blades, or of a circle if that is smaller, minus that of the result.
    worst
        Largest deviation of the curvature of a plane from the mean, in standard errors.

    Examples
    --------
    >>> from lfcal.psf import open_psf
    >>> from lfcal.psf.aperture import Iris, joint_iris
    >>> with open_psf("H.h5") as H:
    ...     iris: Iris | None = joint_iris([H.aperture(1)], [False])
    >>> print(iris.blades, iris.confident, iris.describe())
    7 True 7 blades, rotated 11.5°, curvature ..., from 1 plane
    """

    blades: int
    rotation_rad: float
    curvature: float
    curvature_sigma: float
    planes: int
    margin: float
    worst: float

    @property
    def confident(self) -> bool:
        """Whether the number of blades and the curvature are reliable, according to `margin` and `worst`."""
        return self.margin >= CERTAIN and self.worst <= AGREE

    def describe(self) -> str:
        """Return a one-line description of the iris."""
        planes = "1 plane" if self.planes == 1 else f"{self.planes} planes"
        if not self.confident:
            why = (
                "planes contradict each other"
                if self.margin >= CERTAIN
                else "several blade counts fit about equally well"
            )
            return f"unknown from {planes}: {why}"
        if not self.blades:
            return f"round, from {planes}"
        shape = f"curvature {self.curvature:.2f} ± {self.curvature_sigma:.2f}"
        return f"{self.blades} blades, rotated {math.degrees(self.rotation_rad):.1f}°, {shape}, from {planes}"


def joint_iris(apertures: Sequence[Aperture], inverted: Sequence[bool | None]) -> Iris | None:
    """Return the iris estimated jointly from all planes; None if no plane shows a clear shape.

    All planes are assumed to show the same number of blades, rotation and curvature. The chi-square of a number of
    blades is the sum over the planes, plus the chi-square of their curvatures and rotations about the weighted means.
    Planes with an irregular or incomplete outline are left out.

    Parameters
    ----------
    apertures
        Aperture of each plane, as returned by `fit_aperture`.
    inverted
        Whether each plane shows the iris inverted, which is so on one side of the native plane; None if unknown.

    Examples
    --------
    >>> from lfcal.psf import open_psf
    >>> from lfcal.psf.aperture import joint_iris
    >>> with open_psf("H.h5") as H:  # both planes on the same side of the native one
    ...     iris = joint_iris([H.aperture(0), H.aperture(1)], [False, False])
    >>> print(iris.blades, "blades,", round(iris.rotation_rad, 1), "rad, from", iris.planes, "planes")
    7 blades, 0.2 rad, from 2 planes
    """
    # the same amount of evidence on both sides
    chosen = [
        (a, turned)
        for a, turned in zip(apertures, inverted, strict=True)
        if a.counts and a.refusal in USABLE and a.kind in REGULAR
    ]
    if not any(a.confident for a, _ in chosen):
        return None
    found = sorted((_of_count(n, chosen) for n in {c.blades for a, _ in chosen for c in a.counts}), key=_left)
    best = found[0]
    others = min(0.0, found[1][0]) if len(found) > 1 else 0.0
    margin = others - best[0]
    rounds = [a for a, _ in chosen if a.kind == "round" and a.confident]
    if rounds and margin < CERTAIN and all(a.kind in ("", "round") for a, _ in chosen):
        return Iris(0, 0.0, 1.0, math.nan, len(rounds), CERTAIN, 0.0)
    _, blades, turn, curvature, sigma, worst = best
    return Iris(blades, turn, curvature, math.hypot(sigma, COMMON), len(chosen), margin, worst)


def _left(entry: tuple[float, int, float, float, float, float]) -> float:
    return entry[0]


def _of_count(
    blades: int, planes: Sequence[tuple[Aperture, bool | None]]
) -> tuple[float, int, float, float, float, float]:
    """Return chi-square beyond the circle's, count, rotation, curvature, its error, and the worst plane's deviation."""
    pairs = [(_fit_of(a, blades), turned) for a, turned in planes]
    known = [(fit, turned) for fit, turned in pairs if fit is not None]
    k = np.array([fit.curvature for fit, _ in known])
    error = np.array([fit.curvature_sigma for fit, _ in known])
    curvature, sigma = _mean(k, error)
    deviation = (k - curvature) / error
    # the mean direction of a rotation that repeats after one blade
    step = 2 * math.pi / blades
    turns = np.array([_upright(fit, turned, step) for fit, turned in known])
    spread = np.hypot([fit.rotation_sigma for fit, _ in known], ROTATION_FLOOR)
    weight = 1 / spread**2
    # planes of unknown side may be inverted, which doubling the angle of an odd count makes irrelevant
    fold = 2 if any(turned is None for _, turned in known) and blades % 2 else 1
    phase = np.exp(1j * blades * fold * turns)
    mean = float(np.angle((weight * phase).sum())) / (blades * fold)
    away = np.angle(phase * np.exp(-1j * blades * fold * mean)) / (blades * fold)
    total = sum(fit.gain for fit, _ in known) + float((deviation**2).sum() + (weight * away**2).sum())
    return total, blades, mean % step, curvature, sigma, float(np.abs(deviation).max(initial=0.0))


def _mean(values: np.ndarray, errors: np.ndarray) -> tuple[float, float]:
    """Return the weighted mean and its error, which is larger where the values scatter by more than their errors."""
    weight = 1 / errors**2
    mean = float((weight * values).sum() / weight.sum())
    scatter = float((weight * (values - mean) ** 2).sum()) / max(1, values.size - 1)
    return mean, math.sqrt(max(1.0, scatter) / float(weight.sum()))


def _fit_of(aperture: Aperture, blades: int) -> CountFit | None:
    return next((fit for fit in aperture.counts if fit.blades == blades), None)


def _upright(fit: CountFit, inverted: bool | None, step: float) -> float:
    return (fit.rotation_rad + (math.pi if inverted else 0.0)) % step
