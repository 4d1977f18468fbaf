"""Residuals in units of their noise: gain and background of planes, variance of the model, robust weights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.fit.measured import Measured

__all__ = ["BEND", "PatternLevels", "Response", "Weighed", "levels_of", "unlike_others", "weighed"]

BEND = 4.0
"""Residual (sigmas) above which the loss is linear (Huber); noise alone hardly ever exceeds it."""

OUTLIER_SIGMAS = 25.0
"""Residual (sigmas) above which a single pixel is not used as a measurement."""

UNLIKE_SIGMAS = 8.0
"""Robust standard deviations by which a pattern's chi² must exceed the others' for the pattern to be an outlier."""

UNLIKE_RATIO = 1.3
"""Ratio to the others' chi² that is required as well, whatever their scatter."""

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Response:
    """Pixel response non-uniformity (PRNU): pixels have different gains.

    Attributes
    ----------
    squared
        Square of the relative rms.
    sigma
        Standard deviation of ``squared``.
    """

    squared: float = 0.0
    sigma: float = 0.0

    @property
    def rms(self) -> float:
        """Relative rms of the gains."""
        return math.sqrt(self.squared)


@dataclass(frozen=True, eq=False)
class PatternLevels:
    """Relation between model and recorded pattern: recorded = gain (1 + lamp) model + background.

    Attributes
    ----------
    gains, backgrounds
        Gain and background of each plane ``(nz,)``.
    lamps
        Relative change of the brightness of the lamp at each pattern ``(n,)``.
    """

    gains: F8
    backgrounds: F8
    lamps: F8

    def factors(self, planes: NDArray[np.intp]) -> F8:
        """Return gain (1 + lamp) of each pattern ``(n,)``; ``planes`` ``(n,)`` are the indices of their planes."""
        found: F8 = self.gains[planes] * (1.0 + self.lamps)
        return found

    def between(self, seen: NDArray[np.intp], depths_um: Sequence[float]) -> PatternLevels:
        """Return the levels, with gains of planes without patterns interpolated in depth between those ``seen``.

        Beyond the outermost seen plane, its gain is used. A gain is counts per fraction of the light. Without a pattern
        it is undetermined. However, one lamp illuminates all planes, and a gain of 1 would give H of such a plane in
        another unit.
        """
        depths = np.asarray(depths_um, np.float64)
        known = seen[np.argsort(depths[seen])]
        gains = np.interp(depths, depths[known], self.gains[known])
        gains[seen] = self.gains[seen]
        return replace(self, gains=gains)


@dataclass(frozen=True, eq=False)
class Weighed:
    """Residuals of patterns and their weights, each ``(n, m)``.

    Attributes
    ----------
    residual
        Recorded minus predicted values, in standard deviations of the noise; 0 where a pixel is not valid.
    inverse
        1/sigma of each pixel; 0 for invalid pixels.
    robust
        Square root of Huber's weight.
    bright
        Fraction of the variance that is due to light, between 0 and 1.
    """

    residual: F4
    inverse: F4
    robust: F4
    bright: F4

    @property
    def cost(self) -> F8:
        """Huber's loss of each pattern ``(n,)``, times two: the sum of squares if no residual is large."""
        size = np.abs(self.residual, dtype=np.float64)
        loss = np.where(size <= BEND, size * size, BEND * (2 * size - BEND))
        found: F8 = loss.sum(1)
        return found

    @property
    def outlying(self) -> NDArray[np.bool_]:
        """Mask of the pixels that are not used as measurements: outliers in patterns whose other pixels are not."""
        size = np.abs(self.residual)
        found: NDArray[np.bool_] = size > np.maximum(
            OUTLIER_SIGMAS, 6 * np.sqrt(np.square(size).mean(1, keepdims=True))
        )
        return found

    def of(self, keep: NDArray[np.bool_]) -> Weighed:
        """Return the patterns that the mask ``keep`` ``(n,)`` selects."""
        return replace(
            self, **{name: getattr(self, name)[keep] for name in ("residual", "inverse", "robust", "bright")}
        )


def flat(measured: Measured) -> tuple[F4, NDArray[np.bool_]]:
    """Return patterns and valid pixels in the shape ``(n, m)``."""
    # with an explicit number, because there may be no patterns
    shape = (len(measured), math.prod(measured.sampled))
    return measured.patterns.reshape(shape), measured.valid.reshape(shape)


def variance(measured: Measured, light: F4, *, doubtful: bool, error: float) -> F4:
    """Return the variance ``(n, m)`` of samples whose light is predicted as ``light``.

    While the model is ``doubtful``, the larger of model and data is used, because a dark model would otherwise imply no
    noise for bright data. The error of the engine, a fraction ``error`` of the light, is added.
    """
    shown = np.maximum(light, 0)
    if doubtful:
        shown = np.maximum(shown, flat(measured)[0])
    constant, slope = (measured.noise[:, k, None].astype(np.float32) for k in (0, 1))
    floor = np.float32(1e-12) * np.float32(max(1e-30, float(np.square(measured.patterns).max(initial=0.0))))
    found: F4 = constant + slope * shown + np.square(np.float32(error) * shown) + floor
    return found


def levels_of(measured: Measured, model: F4, lamps: F8, *, doubtful: bool, error: float) -> PatternLevels:
    """Return gain and background of each plane that fit the patterns best, by weighted least squares.

    ``model`` ``(n, m)`` are predictions with unit gain. Held-out patterns are used only in planes without other
    patterns.
    """
    data, valid = flat(measured)
    planes, nz = measured.level, measured.levels
    gains, backgrounds = np.ones(nz), np.zeros(nz)
    for z in np.unique(planes).tolist():
        own = (planes == z) & ~measured.held_out
        if not own.any():
            own = planes == z
        part, m, d, good = measured.of(own), model[own], data[own], valid[own]
        m = m * (1.0 + lamps[own, None]).astype(np.float32)
        total = float(m[good].sum(dtype=np.float64))
        gain, background = (float(d[good].sum(dtype=np.float64)) / total if total > 0 else 1.0), 0.0
        for _ in range(3):
            var = variance(part, np.float32(gain) * m, doubtful=doubtful, error=error)
            weight = np.where(good, 1.0 / var, 0.0)
            # pixels beyond the bend of the loss have less weight, as in the fit itself
            size = np.abs(d - gain * m - background) / np.sqrt(var)
            weight *= np.minimum(1.0, BEND / np.maximum(size, BEND))
            a, b, c = (float((weight * v).sum(dtype=np.float64)) for v in (m * m, m, np.ones_like(m)))
            e, f = float((weight * m * d).sum(dtype=np.float64)), float((weight * d).sum(dtype=np.float64))
            det = a * c - b * b
            if det > 1e-9 * a * c:
                gain, background = (c * e - b * f) / det, (a * f - b * e) / det
        gains[z], backgrounds[z] = gain, background
    return PatternLevels(gains, backgrounds, lamps)


def weighed(
    measured: Measured, model: F4, levels: PatternLevels, *, doubtful: bool, error: float, inverse: F4 | None = None
) -> Weighed:
    """Return the residuals of predictions ``model`` ``(n, m)`` with unit gain.

    ``inverse`` is 1/sigma of each sample, to compare two models with the same noise. None: computed from ``model``.
    """
    data, valid = flat(measured)
    planes = measured.level
    light = model * levels.factors(planes)[:, None].astype(np.float32)
    var = variance(measured, light, doubtful=doubtful, error=error)
    if inverse is None:
        inverse = np.where(valid, 1.0 / np.sqrt(var), 0.0).astype(np.float32)
    back = levels.backgrounds[planes, None].astype(np.float32)
    residual = np.where(valid, (data - light - back) * inverse, 0.0).astype(np.float32)
    robust = np.sqrt(BEND / np.maximum(np.abs(residual), BEND)).astype(np.float32)
    bright = (1.0 - (measured.noise[:, 0, None] / var)).astype(np.float32)
    return Weighed(residual, inverse, robust, np.clip(bright, 0.0, 1.0))


def unlike_others(chi2: F8, pixels: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return a mask ``(n,)`` of the patterns that are outliers, by their chi² per pixel.

    The chi² of each pattern is compared with the median and spread of all.
    """
    if len(chi2) < 4:
        return np.zeros(len(chi2), np.bool_)
    middle = float(np.median(chi2))
    noise = middle * float(np.median(np.sqrt(2.0 / pixels)))
    spread = max(1.4826 * float(np.median(np.abs(chi2 - middle))), noise)
    found: NDArray[np.bool_] = (chi2 > middle + UNLIKE_SIGMAS * spread) & (chi2 > UNLIKE_RATIO * middle)
    # if more than a quarter of the patterns are outliers, the model is wrong
    return found if found.mean() <= 0.25 else np.zeros_like(found)
