"""Properties of the A/D converter from the sample values alone: bits in use, alignment, clipping, averaging."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError

__all__ = ["Converter", "ConverterScan"]

SAMPLE_VALUES = 1 << 16
ROWS = 64
"""Number of rows of a frame examined for fractions."""


@dataclass(frozen=True)
class Converter:
    """Properties of the analogue-to-digital converter found in a series of frames.

    Attributes
    ----------
    top
        Highest sample value found, shifted down by ``shift``.
    clip
        Sample value at which many samples accumulate; None if there is none.
    shift
        Number of unused low bits of left-aligned samples.
    step
        Spacing of sample values after the shift, 0 for floats that are not on a grid.
    used
        Fraction of the possible sample values that occur, in ranges with enough samples for all of them to occur.
    """

    top: float
    clip: float | None
    shift: int
    step: float
    used: float


@dataclass
class ConverterScan:
    """Histograms accumulated over all frames as they are read.

    Attributes
    ----------
    counts
        Number of pixels with each sample value; empty until integer frames are read.
    """

    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    step: float = 0.0
    top: float = -np.inf
    first: NDArray[np.float64] | None = None

    def add(self, values: NDArray[Any], label: str) -> None:
        """Count the samples of one frame."""
        self.top = max(self.top, float(values.max()))
        if values.dtype.kind == "f" and not (values == np.rint(values)).all():
            self._add_fractions(values)
            return
        low, high = float(values.min()), float(values.max())
        if low < 0 or high >= SAMPLE_VALUES:
            # signed or 32-bit samples do not come from a converter; their variance still shows gain and noise
            return
        found = np.bincount(np.ascontiguousarray(values, np.uint16).ravel(), minlength=SAMPLE_VALUES)
        self.counts = found if not self.counts.size else self.counts + found
        if self.first is None:
            self.step = 1.0

    def _add_fractions(self, values: NDArray[Any]) -> None:
        some = values[:ROWS].astype(np.float64)
        if self.first is None:
            self.first, self.step = some, _grid(some)
        # a subtracted mean dark leaves the same fraction in every frame, with the noise of a single one
        elif some.shape == self.first.shape:
            away = some - self.first
            if np.abs(away).max() > 0.5 and np.abs(away - np.rint(away)).max() < 1e-2:
                self.step = 1.0

    def result(self) -> Converter:
        """Return the properties found in the histogram; raise `InputError` if all samples are equal."""
        values = np.flatnonzero(self.counts)
        # if the brightest frames are not integers, the others do not show the converter's upper end
        if not values.size or self.step < 1 or self.top > values[-1]:
            return Converter(self.top, None, 0, self.step, 1.0)
        if values.size < 2:
            raise InputError.expected(
                "flats and darks",
                "varying samples",
                f"{values[0]} everywhere",
                "check the exposure and the saved files",
            )
        # unused low bits: a power of two divides every sample
        whole = int(np.bitwise_or.reduce(values))
        shift = (whole & -whole).bit_length() - 1
        step = float(np.gcd.reduce(values >> shift)) if shift < 8 else 1.0
        counts = self.counts[:: 1 << shift]
        return Converter(float(values[-1] >> shift), _pile(counts), shift, step, _used(counts[:: int(step)]))


def _pile(counts: NDArray[np.int64]) -> float | None:
    """Return the highest sample value if it has far more samples than those just below it."""
    top = int(np.flatnonzero(counts)[-1])
    width = max(4, top // 100)
    below = counts[max(0, top - width) : top]
    # the brightest samples of an unclipped frame become rarer towards the top
    if counts[top] >= 20 and below.size and counts[top] > 5 * max(below.mean(), 0.2 * float(below.max())):
        return float(top)
    return None


def _used(counts: NDArray[np.int64]) -> float:
    """Return the fraction of sample values that occur, in ranges where samples on both sides suggest all would."""
    reach = 6
    sums = np.concatenate([np.zeros(reach + 1, np.int64), np.cumsum(counts), np.full(reach, counts.sum())])
    at = np.arange(counts.size) + reach
    below, above = sums[at] - sums[at - reach], sums[at + 1 + reach] - sums[at + 1]
    # at the end of a light level, one side has no samples
    inside = (below > 20 * reach) & (above > 20 * reach)
    return float((counts[inside] > 0).mean()) if inside.sum() >= 32 else 1.0


def _grid(values: NDArray[Any]) -> float:
    """Return the step 1/n of float samples that are means of n whole numbers, 0 for any other."""
    some = values.ravel()[:20_000].astype(np.float64)
    for count in range(2, 65):
        if np.abs(some * count - np.rint(some * count)).max() < 1e-3:
            return 1 / count
    return 0.0
