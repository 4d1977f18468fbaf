"""Values that end at a ceiling, noise that was cut off, and a background."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from lfcal.judge._patch import Patch
from lfcal.judge.evidence import Evidence
from lfcal.judge.fault import Fault, FaultPicture, FoundFault, PutIn, adding
from lfcal.judge.faults._series import SURE, usual
from lfcal.judge.faults.places import place_map

__all__ = ["FAULTS", "BackgroundFault", "CutOff", "Saturated"]

F4 = NDArray[np.float32]

BANDS = (0.01, 0.05)
"""Fractions of the highest value within which samples are at a ceiling: for samples as the sensor gave them, and for
samples divided by a white image."""

CROWDED = 4.0
"""Ratio of the number of samples at a ceiling to the number of samples in the band below."""

FEW = 12
"""Smallest number of samples at a ceiling."""

HIGHER = 2.0
"""Multiple of the band (see `BANDS`) by which the expected light must exceed the highest value."""

ALWAYS, SEVERAL = 0.9, 4
"""Fraction of the patterns in which a hot pixel is at the ceiling, and the number of patterns needed to decide."""

BRIGHT = 2e-4
"""Background, relative to the brightest light, above which it is reported."""

MUCH = 0.005
"""Smallest fraction of the light that the background adds or removes."""


UNEVEN = 2.0
"""Ratio of the background's scatter to its error above which it varies over the sensor."""

DARK, MANY = 5e-4, 2000
"""Fraction of the brightest light below which samples are dark, and the number needed to determine their noise."""

ZEROS = 0.1
"""Smallest fraction of dark samples that are exactly zero, and of those that are not, if noise was cut off."""

TAIL = 5.0
"""Largest value of noise that was cut off, in standard deviations."""

DIM = 4.0
"""Standard deviations of the noise below which samples may have been cut off."""


class Saturated(Fault):
    """Samples that saturate below the values that the camera model predicts."""

    name = "saturated"
    title = "saturated values"
    subject = "sensor"
    rank = 5
    advice = "Shorten the exposure or dim the lamp, and record these positions again."
    settles: ClassVar[tuple[str, ...]] = ("saturation", "jitter", "flicker", "plane_energy")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault if there is a level that values do not exceed, although the predicted light does."""
        for band in BANDS:
            for one in self._within(evidence, band):
                yield one
                return

    def _within(self, evidence: Evidence, band: float) -> Iterable[FoundFault]:
        """Yield a fault if there is a ceiling, with samples within the fraction ``band`` of the highest value."""
        data = np.where(evidence.valid, evidence.data, -np.inf)
        top = float(data.max())
        level = np.float32((1 - band) * top)
        at = data >= level
        below = int(((data >= (1 - 3 * band) * top) & ~at).sum()) / 2
        if at.sum() < FEW or at.sum() < CROWDED * (below + 1) or not _spread(evidence, at):
            return
        without = evidence.with_data(evidence.data, evidence.valid & ~at)
        light = without.light
        if float(np.median(light[at])) < (1 + HIGHER * band) * top:
            return
        ceiling = float(np.median(data[at]))
        lost = np.where(at, light - evidence.data, 0).sum((1, 2), dtype=np.float64)
        some = np.flatnonzero(at.any((1, 2)))
        yield FoundFault(
            self,
            f"values do not exceed {ceiling:.4g} in {len(some)} of {len(evidence)} compared patterns, where values "
            f"up to {float(light[at].max()):.4g} are expected",
            float(np.sqrt(at.sum())) * 3,
            float(np.clip(lost.sum() / max(float(light.sum()), 1e-300), 0, 1)),
            positions=evidence.index[some],
            picture=place_map(evidence, at.sum((1, 2)).astype(np.float64), "samples", "samples at the ceiling"),
            redo=True,
            masked=lambda values: values >= level,
            put_in=lambda patch: np.minimum(patch.light, np.float32(ceiling)),
        )


def _spread(evidence: Evidence, at: NDArray[np.bool_]) -> bool:
    """Return whether over a third of the samples are at pixels that are not, like hot pixels, always at the ceiling."""
    ny, nx = evidence.plan.period
    nt, ns = evidence.plan.cutout
    hits, seen = np.zeros((2, ny + nt - 1, nx + ns - 1))
    for k, (row, column) in enumerate(evidence.corners().tolist()):
        place = slice(row, row + nt), slice(column, column + ns)
        hits[place] += at[k]
        seen[place] += evidence.valid[k]
    hot = (hits > ALWAYS * seen) & (seen >= SEVERAL)
    return float(hits[~hot].sum()) > float(hits.sum()) / 3


class CutOff(Fault):
    """Dark samples without negative values: half of the noise is missing, and the mean of the rest looks like light."""

    name = "cut_off"
    title = "noise cut off at zero"
    subject = "sensor"
    rank = 6
    advice = "Keep values signed when the dark frame is subtracted, or record with an offset, and assemble H again."
    settles: ClassVar[tuple[str, ...]] = ("clipped", "background", "leak", "snr")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault if dark noise was cut off.

        The noise and its mean before the cut are estimated from the fraction of zeros and the mean of dark samples.
        """
        peak = float(evidence.light.max())
        dark = evidence.data[evidence.valid & (evidence.light < DARK * peak)].astype(np.float64)
        if dark.size < MANY or float(evidence.data[evidence.valid].min()) < 0:
            return
        zeros = float((dark == 0).mean())
        if not ZEROS < zeros < 1 - ZEROS:
            return
        # Gaussian noise about a level, clipped at zero: the fraction of zeros and the mean determine both
        t = -float(ndtri(zeros))
        noise = float(dark.mean()) / (t * float(ndtr(t)) + math.exp(-(t**2) / 2) / math.sqrt(2 * math.pi))
        level = t * noise
        top = float(np.quantile(dark, 0.999))
        if not top < TAIL * noise + max(level, 0.0):  # not such noise, but light, or values in steps
            return
        dim = evidence.valid & (evidence.light + min(level, 0.0) < DIM * noise)
        drawn = np.random.default_rng(0).standard_normal(evidence.data.shape, np.float32) * np.float32(noise)
        whole = np.where(dim, evidence.light + drawn, evidence.data - np.float32(level))
        yield FoundFault(
            self,
            f"{100 * zeros:.0f} % of dark samples are zero and none is negative: noise of {noise:.3g} counts around "
            f"{level:+.3g} was cut off",
            math.sqrt(dark.size) * zeros,
            float(np.abs(whole - evidence.data)[dim].sum() / max(float(evidence.light.sum()), 1e-300)),
            picture=FaultPicture(
                np.histogram(dark, np.linspace(0, top, 41))[0] / dark.size * 100,
                "% of dark samples",
                "distribution of dark samples",
                ("value (counts)",),
                np.linspace(0, top, 41)[:-1],
            ),
            repair=adding(evidence.index, whole - evidence.data),
            put_in=_cut_off(level),
        )


def _cut_off(level: float) -> PutIn:
    def put_in(patch: Patch) -> F4:
        # when the noise of H is added again, there must be no negative values
        found: F4 = np.maximum(patch.light + patch.noise + np.float32(level), np.float32(0)) - patch.noise
        return found

    return put_in


class BackgroundFault(Fault):
    """A constant number of counts under all patterns."""

    name = "background"
    title = "background under all patterns"
    subject = "sensor"
    rank = 43
    advice = "Record a dark frame of the same exposure and temperature, and assemble H again."
    settles: ClassVar[tuple[str, ...]] = ("background", "leak", "truncation", "clipped")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault if the median background of all patterns is significant."""
        values, sigmas = evidence.column("background")
        most = usual(values, sigmas)
        if most is None:
            return
        level, error = most.middle, most.error
        peak, total = float(evidence.light.max()), float(evidence.light.sum((1, 2)).mean())
        share = abs(level) * evidence.light[0].size / max(total, 1e-300)
        if abs(level) < max(BRIGHT * peak, SURE * error) or share < MUCH:
            return
        yield FoundFault(
            self,
            f"{level:+.3g} counts in every sample ({100 * level / peak:+.2f} % of the brightest light)",
            abs(level) / error,
            share,
            picture=FaultPicture(values, "counts", "background of each pattern", ("pattern",)),
            repair=lambda index, patterns: (patterns - np.float32(level)).astype(np.float32),
            put_in=lambda patch: patch.light + np.float32(level),
            # glow varies over the sensor, and costs more than its median
            scatters=most.scatter > UNEVEN * float(np.median(sigmas[most.good])),
        )


FAULTS = (Saturated(), CutOff(), BackgroundFault())
