"""Sensor properties from darks: black level, read noise, dark current, offsets of single pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.frames.photon_transfer._pairs import FramePair, TransferPoints, measure_pair
from lfcal.frames.photon_transfer._values import MeasuredValue
from lfcal.frames.photon_transfer.frame_list import CalibrationFrame

__all__ = ["ROUNDING_VARIANCE", "DarkLevel", "dark_current", "measure_darks", "offset_scatter", "read_noise"]

HOT_SIGMAS = 8.0
"""Deviation from the median, in robust standard deviations, above which a pixel is hot."""

MAX_ZEROS = 0.01
"""Fraction of samples at zero above which darks are considered clipped."""

ROUNDING_VARIANCE = 0.3
"""Variance of integer darks below which it may be only rounding: up to 1/4 if black is between two values."""


@dataclass(frozen=True, eq=False)
class DarkLevel:
    """Darks of one exposure.

    Attributes
    ----------
    exposure_s
        Exposure (s), None if unknown.
    mean
        Mean ``(rows, columns)`` (sample values).
    count
        Number of darks.
    variance
        Temporal variance of a sample (squared sample values).
    samples
        Number of differences used for the variance.
    zeros
        Fraction of samples that are zero.
    likeness
        Correlation of neighbours' noise (along columns, along rows).
    good
        Mask, True at pixels that are not hot.
    frame_means
        Mean of each frame.
    """

    exposure_s: float | None
    mean: NDArray[np.float32]
    count: int
    variance: MeasuredValue
    samples: int
    zeros: float
    likeness: tuple[float, float]
    good: NDArray[np.bool_]
    frame_means: NDArray[np.float64]

    @property
    def cut_off(self) -> bool:
        """Whether noise below zero was clipped, which raises the mean and reduces the noise."""
        return self.zeros > MAX_ZEROS

    @property
    def black(self) -> MeasuredValue:
        """Mean level and its error, which includes the drift from frame to frame."""
        values = self.mean[self.good].astype(np.float64)
        drift = float(self.frame_means.std(ddof=1)) / np.sqrt(self.count) if self.count > 1 else 0.0
        # contribution of temporal noise and pixel offsets to the error of the mean
        chance = float(values.std()) / np.sqrt(max(1, values.size))
        return MeasuredValue(float(values.mean()), float(np.hypot(drift, chance)))

    @property
    def point(self) -> TransferPoints:
        """The level as the darkest point of a photon-transfer curve."""
        one = np.zeros(1)
        return TransferPoints(
            one, np.array([self.variance.value]), np.array([self.samples]), np.array([-1]), np.array([0])
        )


def measure_darks(frames: Sequence[CalibrationFrame], exposure_s: float | None) -> DarkLevel:
    """Measure the darks of one exposure; raise `InputError` for a single dark, or identical ones."""
    if len(frames) < 2:
        raise InputError.expected(
            "darks", "two or more of each exposure", f"one ({frames[0].label})", "record at least a pair"
        )
    mean, means, zeros = _mean(frames)
    good = _not_hot(mean)
    variances, weights, likeness = [], [], []
    for first, second in zip(frames[::2], frames[1::2], strict=False):
        # darks have no light: there is nothing to sort by, and no ratio to find
        empty = np.zeros_like(mean)
        found = measure_pair(FramePair(first.read(), second.read(), empty, empty, good, "", len(frames), lit=False))
        if found.equal:
            raise InputError.expected(
                "darks", "different frames", f"identical ones ({first.label}, {second.label})", "remove the copies"
            )
        variances.append(float(found.points.y[0]) if found.points.y.size else 0.0)
        weights.append(int(good.sum()))
        likeness.append(found.likeness)
    value, total = float(np.mean(variances)), sum(weights)
    return DarkLevel(
        exposure_s,
        mean,
        len(frames),
        MeasuredValue(value, _scatter(variances, value, total)),
        total,
        zeros,
        (float(np.mean([one for one, _ in likeness])), float(np.mean([two for _, two in likeness]))),
        good,
        means,
    )


def _scatter(variances: list[float], value: float, total: int) -> float:
    """Return the standard error of a mean of variances: by chance, or from the scatter of pairs if that is larger."""
    chance = value * np.sqrt(2 / max(1, total))
    seen = float(np.std(variances, ddof=1)) / np.sqrt(len(variances)) if len(variances) > 2 else 0.0
    return float(max(chance, seen))


def _mean(frames: Sequence[CalibrationFrame]) -> tuple[NDArray[np.float32], NDArray[np.float64], float]:
    total: NDArray[np.float64] | None = None
    means, zeros = [], 0
    for frame in frames:
        values = frame.read()
        total = np.zeros(values.shape) if total is None else total
        total += values
        means.append(float(values.mean(dtype=np.float64)))
        # samples below zero show that nothing was clipped
        zeros += int(np.count_nonzero(values == 0)) if values.min() >= 0 else 0
    assert total is not None
    return (total / len(frames)).astype(np.float32), np.array(means), zeros / (total.size * len(frames))


def _not_hot(mean: NDArray[np.float32]) -> NDArray[np.bool_]:
    middle = float(np.median(mean))
    spread = 1.4826 * float(np.median(np.abs(mean - middle)))
    # noise clipped at zero is one-sided, and rounding may not change the median
    low, high = np.percentile(mean, (1, 84)).tolist()
    spread = max(spread, high - middle, (middle - low) / 2.33)
    good: NDArray[np.bool_] = np.abs(mean - middle) <= HOT_SIGMAS * max(spread, 0.25)
    return good


def read_noise(dark: DarkLevel, whole: bool) -> MeasuredValue | None:
    """Return the read noise (sample values, rms) without rounding noise; None if rounding hides it."""
    if whole and dark.variance.value < ROUNDING_VARIANCE:
        return None
    rounding = 1 / 12 if whole else 0.0
    found = MeasuredValue(dark.variance.value - rounding, dark.variance.sigma).root()
    if whole and found.value < 0.6:
        # near one step, rounding errors of two frames are correlated, depending on the level between two values
        return MeasuredValue(found.value, float(np.hypot(found.sigma, 0.04)))
    return found


def offset_scatter(dark: DarkLevel, whole: bool) -> MeasuredValue | None:
    """Return the scatter of the pixels' offsets (sample values, rms), without the temporal noise of the mean frame.

    None if rounding hides it, or the darks are clipped at zero.

    EMVA 1288 release 4, section 8; hot pixels are counted separately and left out here.
    """
    if dark.cut_off or (whole and dark.variance.value < ROUNDING_VARIANCE):
        return None
    values = dark.mean[dark.good].astype(np.float64)
    noise = dark.variance.times(1 / dark.count)
    seen = float(values.var())
    chance = seen * np.sqrt(2 / max(1, values.size))
    return MeasuredValue(seen - noise.value, float(np.hypot(chance, noise.sigma))).root()


def dark_current(levels: Sequence[DarkLevel], slope: MeasuredValue) -> tuple[MeasuredValue | None, str]:
    """Return the dark current (electrons per pixel and second) from darks of several exposures, and a note.

    It is derived from the growth of the mean level with exposure, or from that of the variance if the camera subtracts
    its dark signal. The note states the latter, or why the dark current is unknown; otherwise it is empty.
    ``slope`` is the gain (sample values per electron).
    """
    known = sorted((one for one in levels if one.exposure_s), key=lambda one: one.exposure_s or 0.0)
    if len({one.exposure_s for one in known}) < 2:
        return None, "dark current: unknown; record darks of two or more exposures"
    seconds = np.array([one.exposure_s for one in known], float)
    mean = _slope(seconds, [one.black for one in known])
    grown = _slope(seconds, [one.variance for one in known])
    by_mean, by_variance = mean.times(slope.inverse()), grown.times(slope.inverse()).times(slope.inverse())
    if by_mean.value > -3 * by_mean.sigma and by_variance.value < by_mean.value + 5 * np.hypot(
        by_mean.sigma, by_variance.sigma
    ):
        return by_mean, ""
    return (
        by_variance,
        "dark current: derived from the increase of the noise, because the camera subtracts dark current",
    )


def _slope(seconds: NDArray[np.float64], values: Sequence[MeasuredValue]) -> MeasuredValue:
    y = np.array([v.value for v in values])
    weight = 1 / np.maximum(np.array([v.sigma for v in values]), 1e-9) ** 2
    middle = float((weight * seconds).sum() / weight.sum())
    away = seconds - middle
    norm = float((weight * away**2).sum())
    value = float((weight * away * y).sum() / norm)
    free = len(values) - 2
    chi2 = float((weight * (y - (weight * y).sum() / weight.sum() - value * away) ** 2).sum() / free) if free else 1.0
    return MeasuredValue(value, float(np.sqrt(max(1.0, chi2) / norm)))
