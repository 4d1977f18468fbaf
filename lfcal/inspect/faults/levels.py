"""Values that end at a ceiling, and a background under all of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.inspect.evidence import Evidence
from lfcal.inspect.faults.places import place_map
from lfcal.inspect.faults.series import SURE, usual
from lfcal.inspect.finding import Fault, Finding, Picture

__all__ = ["FAULTS", "Background", "Saturated"]

F4 = NDArray[np.float32]

BAND = 0.01
"""Part of the highest value that samples at a ceiling lie within."""

CROWDED = 4.0
"""Times as many samples as in the band below that a ceiling has."""

FEW = 12
"""Samples that make a ceiling at least."""

HIGHER = 1.02
"""Light over the ceiling that samples at it should have had."""

BRIGHT = 3e-4
"""Background over the brightest light that is worth a word."""

MUCH = 0.005
"""Share of the light that it adds or takes away at least."""


class Saturated(Fault):
    """Values that end below what the light should make of them."""

    name = "saturated"
    title = "saturated values"
    rank = 5
    advice = "Shorten the exposure or dim the lamp, and record these positions again."
    settles: ClassVar[tuple[str, ...]] = ("saturation", "jitter", "flicker", "plane_energy")

    def found(self, evidence: Evidence) -> Iterable[Finding]:
        """Yield the ceiling, where the camera has more light than that."""
        data = np.where(evidence.valid, evidence.data, -np.inf)
        top = float(data.max())
        level = np.float32((1 - BAND) * top)
        at = data >= level
        below = int(((data >= (1 - 3 * BAND) * top) & ~at).sum()) / 2
        if at.sum() < FEW or at.sum() < CROWDED * (below + 1) or not _spread(evidence, at):
            return
        without = evidence.with_data(evidence.data, evidence.valid & ~at)
        light = without.light
        if float(np.median(light[at])) < HIGHER * top:
            return
        lost = np.where(at, light - evidence.data, 0).sum((1, 2), dtype=np.float64)
        some = np.flatnonzero(at.any((1, 2)))
        yield Finding(
            self,
            f"values end at {top:.4g} in {len(some)} of {len(evidence)} patterns compared, "
            f"where the light makes up to {float(light[at].max()):.4g}",
            float(np.sqrt(at.sum())) * 3,
            float(np.clip(lost.sum() / max(float(light.sum()), 1e-300), 0, 1)),
            positions=evidence.index[some],
            picture=place_map(evidence, at.sum((1, 2)).astype(np.float64), "", "samples at the ceiling"),
            redo=True,
            masked=lambda values: values >= level,
            put_in=lambda patch: np.minimum(patch.light, np.float32(top)),
        )


def _spread(evidence: Evidence, at: NDArray[np.bool_]) -> bool:
    """Return whether samples lie on many pixels of the sensor: a hot one is seen by many patterns."""
    k, t, s = np.nonzero(at)
    places = evidence.corners()[k] + np.stack([t, s], 1)
    return len(np.unique(places, axis=0)) > len(k) / 3


class Background(Fault):
    """The same counts under all patterns."""

    name = "background"
    title = "background under all patterns"
    rank = 43
    advice = "Take a dark frame of the same exposure and temperature, and assemble H again."
    settles: ClassVar[tuple[str, ...]] = ("background", "leak", "truncation", "clipped")

    def found(self, evidence: Evidence) -> Iterable[Finding]:
        """Yield the background in the middle of all patterns."""
        values, sigmas = evidence.column("background")
        most = usual(values, sigmas)
        if most is None:
            return
        level, error = most.middle, most.error
        peak, total = float(evidence.light.max()), float(evidence.light.sum((1, 2)).mean())
        share = abs(level) * evidence.light[0].size / max(total, 1e-300)
        if abs(level) < max(BRIGHT * peak, SURE * error) or share < MUCH:
            return
        yield Finding(
            self,
            f"{level:+.3g} counts under every sample, {100 * level / peak:+.2f} % of the brightest light",
            abs(level) / error,
            share,
            picture=Picture(values, "counts", "background of each pattern", ("pattern",)),
            repair=lambda index, patterns: (patterns - np.float32(level)).astype(np.float32),
            put_in=lambda patch: patch.light + np.float32(level),
        )


FAULTS = (Saturated(), Background())
