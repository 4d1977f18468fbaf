"""The photon-transfer curve: variance against mean, its slope, and its limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError
from lfcal.frames.photon_transfer._pairs import TransferPoints
from lfcal.frames.photon_transfer._values import MeasuredValue

__all__ = ["PhotonTransferCurve", "fit_curve"]

LINEAR_UP_TO = 0.7
"""Fraction of saturation up to which the variance is treated as linear (EMVA 1288 release 4, section 6)."""

ROUNDING_VARIANCE = 0.35
"""Variance of integer samples below which rounding hides the noise."""

BENT = 0.02
"""Relative deviation of the variance from a line, at its upper end, above which the curvature is fitted too."""

REFUSED = 0.35
"""Relative deviation above which the samples are not a linear measure of light."""


@dataclass(frozen=True, eq=False)
class PhotonTransferCurve:
    """Variance against mean, ``y = C + K x + Q x²`` up to ``limit``.

    Attributes
    ----------
    points
        All measured points, the dark one first.
    used
        Mask ``(n,)``, True at the points that were fitted.
    slope
        K (sample values per electron); None if it is undetermined.
    constant
        C: variance due to read noise and rounding (squared sample values).
    bend
        Q; 0 unless it is significant.
    departure
        Relative deviation of the variance from the initial line, at the highest fitted point.
    chi2
        Chi² of the fitted points, per degree of freedom.
    limit
        Highest fitted signal (sample values above black).
    saturation
        Signal above black at which the variance drops; None if it does not.
    refusal
        Reason why the slope is undetermined; empty if it is known.
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
        """Return the fitted variance at ``signal`` above black; 0 if the slope is undetermined."""
        x = np.asarray(signal, np.float64)
        slope = 0.0 if self.slope is None else self.slope.value
        fitted: NDArray[np.float64] = np.maximum(self.constant.value + slope * x + self.bend * x**2, 0.0)
        return fitted


def fit_curve(points: TransferPoints, clip: float | None, whole: bool) -> PhotonTransferCurve:
    """Return the photon-transfer curve fitted to points of variance and signal.

    Parameters
    ----------
    points
        Points of all pairs, including the dark one.
    clip
        Signal above black at which samples are clipped; None if none are.
    whole
        Whether samples are integers, whose rounding hides noise below half a count.

    Raises
    ------
    InputError
        If there is no point with light.
    """
    if not (points.x > 0).any():
        raise InputError.expected("flats", "light above the dark level", "none", "check lamp and shutter")
    limit = LINEAR_UP_TO * float(points.x.max() if clip is None else clip)
    if clip is None and not (points.x[points.x <= limit] > 0).any():
        limit = float(points.x.max())  # flats of one brightness, without any sign of saturation
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
        why = "no flat is between the dark level and 70 % of saturation"
    elif not (lit & used).any():
        why = "the noise is below the rounding of the samples; raise the camera's gain"
    elif np.ptp(points.x[used]) < 0.1 * points.x[used].max():
        why = "all flats have the same brightness, and the darks have no noise to compare with"
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
        why = "the variance is not proportional to the light: the samples were processed, or the light changed"
    return PhotonTransferCurve(
        points, used, None if why else slope, constant, bend, departure, chi2, limit, saturation, why
    )


def _least_squares(
    x: NDArray[np.float64], y: NDArray[np.float64], n: NDArray[np.float64], terms: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return polynomial coefficients, their covariance (scaled by the scatter), and chi² per degree of freedom."""
    scale = float(x.max())
    base = np.stack([(x / scale) ** k for k in range(terms)], axis=1)
    floor = max(1e-4 * float(y.max()), 1e-12)
    model = np.maximum(y, floor)
    solution = np.zeros(terms)
    for _ in range(12):
        # weights from the model: with weights from the points' scatter, low points would count more and bias the curve
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
    """Return the signal at which the variance drops far below the curve (EMVA: saturation); None if it does not."""
    if curve.refusal or curve.slope is None:
        return None
    x, y = curve.points.x, curve.points.y
    model = curve.variance(x)
    order = np.argsort(x)
    low = (y < 0.6 * model)[order] & (x > 0.3 * x.max())[order]
    # all points above the drop are low; a single low point is not a drop
    run = np.flatnonzero(~low[::-1])
    high = int(run[0]) if run.size else low.size
    if high < 1:
        return None
    top = x[order][low.size - high :]
    below = x[order][: low.size - high]
    if not below.size:
        return None
    at, nearest = float(np.median(top)), float(below[-1])
    # the drop is between the last point on the curve and the first low one
    return MeasuredValue(max(nearest, float(top.min())), max(abs(at - nearest) / 2, 0.5))
