"""The photon-transfer curve: variance over mean, its slope, and where it breaks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError
from lfcal.frames.photon_transfer._pairs import TransferPoints
from lfcal.frames.photon_transfer._values import MeasuredValue

__all__ = ["PhotonTransferCurve", "fit_curve"]

LINEAR_UP_TO = 0.7
"""Share of saturation up to which the variance is taken as linear (EMVA 1288 release 4, section 6)."""

ROUNDING_VARIANCE = 0.35
"""Variance of whole samples (squared counts) below which their rounding hides the noise."""

BENT = 0.02
"""Departure from the line, relative at its upper end, from which the curve's bend is fitted too."""

REFUSED = 0.35
"""Departure at which the samples are no linear measure of light."""


@dataclass(frozen=True, eq=False)
class PhotonTransferCurve:
    """Variance against mean, ``y = C + K x + Q x²`` up to ``limit``.

    Attributes
    ----------
    points
        All points measured, the dark one first.
    used
        Which of them were fitted.
    slope
        K (sample values per electron); None where it cannot be told.
    constant
        C: read noise and rounding (squared sample values).
    bend
        Q; 0 unless the points call for it.
    departure
        Of the variance from the line of its beginning, relative, at the highest point fitted.
    chi2
        Of the points fitted, per degree of freedom.
    limit
        Highest signal fitted (sample values above black).
    saturation
        Signal above black at which the variance breaks; None: it does not.
    refusal
        Why there is no slope; empty where there is one.
    """

    points: TransferPoints
    used: NDArray[np.bool_]
    slope: MeasuredValue | None
    constant: MeasuredValue
    bend: float
    departure: float
    chi2: float
    limit: float
    saturation: MeasuredValue | None
    refusal: str = ""

    def variance(self, signal: ArrayLike) -> NDArray[np.float64]:
        """Return the fitted variance at ``signal`` above black; needs a slope."""
        x = np.asarray(signal, np.float64)
        slope = 0.0 if self.slope is None else self.slope.value
        fitted: NDArray[np.float64] = np.maximum(self.constant.value + slope * x + self.bend * x**2, 0.0)
        return fitted


def fit_curve(points: TransferPoints, clip: float | None, whole: bool) -> PhotonTransferCurve:
    """Fit the curve.

    Parameters
    ----------
    points
        Of all pairs, the dark one among them.
    clip
        Signal above black at which samples are clipped; None where none are.
    whole
        Whether samples are whole numbers, whose rounding hides noise below half a count.

    Raises
    ------
    InputError
        If there is no point with light.
    """
    if not (points.x > 0).any():
        raise InputError.expected("flats", "light above the dark level", "none", "check lamp and shutter")
    limit = LINEAR_UP_TO * float(points.x.max() if clip is None else clip)
    if clip is None and not (points.x[points.x <= limit] > 0).any():
        limit = float(points.x.max())  # flats of one brightness, of which nothing says that they saturate
    saturation = None
    for _ in range(3):
        curve = _fitted(points, limit, whole, saturation)
        found = _break(curve)
        if found is None or curve.refusal:
            return curve
        saturation = found
        lower = LINEAR_UP_TO * found.value
        if lower >= limit * 0.99:
            return _fitted(points, limit, whole, saturation)
        limit = lower
    return curve


def _fitted(points: TransferPoints, limit: float, whole: bool, saturation: MeasuredValue | None) -> PhotonTransferCurve:
    used = points.x <= limit
    lit = used & (points.x > 0.02 * limit)
    if whole:
        used &= points.y > ROUNDING_VARIANCE
    why = ""
    if not lit.any():
        why = "no flat lies between the dark and 70 % of saturation"
    elif not (lit & used).any():
        why = "the noise is below the rounding of the samples; raise the camera's gain"
    elif np.ptp(points.x[used]) < 0.1 * points.x[used].max():
        why = "all flats are of one brightness, and the darks have no noise to compare with"
    if why:
        return PhotonTransferCurve(
            points, used, None, MeasuredValue(0.0, np.inf), 0.0, 0.0, 0.0, limit, saturation, why
        )
    x, y, n = points.x[used], points.y[used], points.n[used].astype(float)
    terms, cov, chi2 = _least_squares(x, y, n, 2)
    bend, departure = 0.0, 0.0
    if x.size >= 5:
        bowed, bowed_cov, bowed_chi2 = _least_squares(x, y, n, 3)
        sure = abs(bowed[2]) > 4 * np.sqrt(bowed_cov[2, 2])
        share = float(bowed[2] * x.max() / bowed[1]) if bowed[1] > 0 else np.inf
        if sure and abs(share) > BENT:
            terms, cov, chi2, bend, departure = bowed, bowed_cov, bowed_chi2, float(bowed[2]), share
    constant, slope = (MeasuredValue(float(terms[k]), float(np.sqrt(cov[k, k]))) for k in (0, 1))
    if not slope.value > 3 * slope.sigma or abs(departure) > REFUSED:
        why = "the variance does not grow in proportion to the light: the samples are processed, or light changed"
    return PhotonTransferCurve(
        points, used, None if why else slope, constant, bend, departure, chi2, limit, saturation, why
    )


def _least_squares(
    x: NDArray[np.float64], y: NDArray[np.float64], n: NDArray[np.float64], terms: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return the polynomial through the points, its covariance (scaled by the scatter), and chi² per freedom."""
    scale = float(x.max())
    base = np.stack([(x / scale) ** k for k in range(terms)], axis=1)
    floor = max(1e-4 * float(y.max()), 1e-12)
    model = np.maximum(y, floor)
    solution = np.zeros(terms)
    for _ in range(12):
        # weights from the model: by the points' own scatter low ones would count more and pull the curve down
        weight = np.sqrt(n / (2 * model**2))
        solution, *_ = np.linalg.lstsq(base * weight[:, None], y * weight, rcond=None)
        model = np.maximum(base @ solution, floor)
    weight = np.sqrt(n / (2 * model**2))
    free = max(1, x.size - terms)
    chi2 = float(np.sum(((y - base @ solution) * weight) ** 2)) / free
    cov = np.linalg.pinv((base * weight[:, None]).T @ (base * weight[:, None])) * max(1.0, chi2)
    back = scale ** -np.arange(terms, dtype=float)
    return solution * back, cov * np.outer(back, back), chi2


def _break(curve: PhotonTransferCurve) -> MeasuredValue | None:
    """Return where the variance has its maximum, if it falls far below the curve beyond it (EMVA: saturation)."""
    if curve.refusal or curve.slope is None:
        return None
    x, y = curve.points.x, curve.points.y
    model = curve.variance(x)
    order = np.argsort(x)
    low = (y < 0.6 * model)[order] & (x > 0.3 * x.max())[order]
    # all that lies above the break is low; a single point that is low is none
    run = np.flatnonzero(~low[::-1])
    high = int(run[0]) if run.size else low.size
    if high < 1:
        return None
    top = x[order][low.size - high :]
    below = x[order][: low.size - high]
    if not below.size:
        return None
    at, nearest = float(np.median(top)), float(below[-1])
    # variance breaks between the last point on the curve and those where it is gone
    return MeasuredValue(max(nearest, float(top.min())), max(abs(at - nearest) / 2, 0.5))
