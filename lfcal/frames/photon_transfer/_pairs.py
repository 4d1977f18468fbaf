"""Mean and variance of pixels of similar brightness, from the two frames of a pair.

The difference of two frames of equal light contains their temporal noise; static content cancels: dust, vignetting,
micro-images, fixed pattern. Half its variance over pixels of similar mean value is the variance of one sample (EMVA
1288 release 4, section 6; Janesick 2007, chapter 5). A structured frame, such as the white image of a lenslet array,
therefore yields a complete photon-transfer curve from one pair.

If the light differs between the frames by the factor (1 - α)/(1 + α), α times the signal remains in the difference.
``d = (1 - α) a - (1 + α) b`` is free of it, and ``var d / 2 = C (1 + α²) + K m (1 - α²)`` for frames of variance ``C +
K m``. The returned points obey ``y = C + K x`` for every α.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

from lfcal.frames.cfa import pattern_side

__all__ = ["FramePair", "PairFinding", "TransferPoints", "measure_pair", "strips"]

Image = NDArray[np.float32]

STRIP = 1 << 20
"""Number of pixels processed together."""

MAX_BINS = 48
MIN_PIXELS = 200
"""Smallest number of pixels in a bin; this number determines a variance to 10 %."""

COARSE, LEAST_WIDTH = 4.0, 3.0
"""Variance of integer samples below which bins have a minimum width and end between possible means; that width."""

CLIP_SIGMA = 6.0
ROLLING_CHI2 = 3.0
"""Scatter of the light of rows, relative to chance, above which each row gets a separate ratio."""


@dataclass(frozen=True)
class TransferPoints:
    """Points of a photon-transfer curve, arrays ``(n,)``.

    Attributes
    ----------
    x
        Mean signal above black (sample values).
    y
        Temporal variance of a sample (squared sample values).
    n
        Number of pixels used for each point.
    level, site
        Level of light, and position in the colour filter pattern by rows, of each point.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    n: NDArray[np.int64]
    level: NDArray[np.int64]
    site: NDArray[np.int64]

    @classmethod
    def joined(cls, parts: list[Self]) -> Self:
        """Return the points of several pairs as one set."""
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))

    def where(self, chosen: NDArray[np.bool_]) -> TransferPoints:
        """Return the points selected by ``chosen``."""
        return TransferPoints(*(getattr(self, f.name)[chosen] for f in fields(self)))


@dataclass(frozen=True, eq=False)
class FramePair:
    """A pair of flats, with the data needed to compare them.

    Attributes
    ----------
    a, b
        The frames ``(rows, columns)``.
    dark
        Mean dark ``(rows, columns)`` (sample values), subtracted from both frames.
    bright
        Mean of all flats of this level minus the dark, by which pixels are sorted.
    good
        Mask of the good pixels.
    cfa
        Colour filter pattern, empty for none.
    frames
        Number of frames averaged in ``bright``.
    lit
        Whether the frames have light, which may differ between them by a factor.
    """

    a: NDArray[np.generic]
    b: NDArray[np.generic]
    dark: Image
    bright: Image
    good: NDArray[np.bool_]
    cfa: str
    frames: int
    lit: bool = True


@dataclass(frozen=True)
class PairFinding:
    """Result of one pair.

    Attributes
    ----------
    points
        Points of the curve; ``level`` is 0.
    change
        Ratio of the light of the second frame to the first, minus 1.
    rolling
        Scatter of this change over the rows, relative rms in excess of chance.
    likeness
        Correlation between the differences of neighbours of one colour (along columns, along rows).
    equal
        Whether the two frames are identical.
    """

    points: TransferPoints
    change: float
    rolling: float
    likeness: tuple[float, float]
    equal: bool


def strips(shape: tuple[int, int], side: int = 1) -> Iterator[slice]:
    """Yield groups of rows to process together, in whole periods of a colour filter pattern."""
    step = max(1, STRIP // shape[1] // side) * side
    for start in range(0, shape[0], step):
        yield slice(start, min(start + step, shape[0]))


def measure_pair(pair: FramePair) -> PairFinding:
    """Return the points of one pair, and properties of its light and noise."""
    alpha, rolling = _ratios(pair)
    quick = _quick_variance(pair, alpha)
    edges = _edges(pair, quick)
    points, likeness = _moments(pair, alpha, edges, quick)
    mean = float(alpha.mean())
    change = (1 - mean) / (1 + mean) - 1
    return PairFinding(points, change, rolling, likeness, _copies(pair))


def _copies(pair: FramePair) -> bool:
    """Return whether the frames are identical; completely saturated frames do not count as copies."""
    return bool(np.array_equal(pair.a, pair.b)) and bool((pair.a != pair.a.flat[0]).any())


def _ratios(pair: FramePair) -> tuple[NDArray[np.float64], float]:
    """Return α of every row ``(rows, 1)``, equal unless rows differ beyond chance, and the scatter of their light."""
    rows = pair.a.shape[0]
    if not pair.lit:
        return np.zeros((rows, 1)), 0.0
    d, s, d2 = np.zeros(rows), np.zeros(rows), np.zeros(rows)
    for part in strips((rows, pair.a.shape[1])):
        a, b, good = _above(pair, part)
        difference = np.where(good, a - b, 0)
        d[part], s[part] = difference.sum(axis=1), np.where(good, a + b, 0).sum(axis=1)
        d2[part] = (difference * difference).sum(axis=1)
    total = s.sum()
    one = float(d.sum() / total) if total > 0 else 0.0
    lit = s > 0.2 * np.median(s)
    if not lit.any() or not total > 0 or lit.sum() < 8:
        return np.full((rows, 1), one), 0.0
    of_row = np.full(rows, one)
    of_row[lit] = d[lit] / s[lit]
    chance = d2[lit] / s[lit] ** 2
    chi2 = float(np.mean((of_row[lit] - one) ** 2 / np.maximum(chance, 1e-300)))
    if not chi2 > ROLLING_CHI2:
        return np.full((rows, 1), one), 0.0
    beyond = float(np.mean((of_row[lit] - one) ** 2 - chance))
    return of_row[:, None], 2 * float(np.sqrt(max(beyond, 0.0)))


def _above(pair: FramePair, part: slice) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    dark = pair.dark[part]
    return pair.a[part].astype(np.float64) - dark, pair.b[part].astype(np.float64) - dark, pair.good[part]


def _quick_variance(pair: FramePair, alpha: NDArray[np.float64]) -> float:
    """Return the approximate variance of a sample, to choose the width of the bins."""
    rows = slice(pair.a.shape[0] // 4, max(pair.a.shape[0] // 4 + 8, 3 * pair.a.shape[0] // 4))
    a, b, good = _above(pair, rows)
    d = ((1 - alpha[rows]) * a - (1 + alpha[rows]) * b)[good]
    if not d.size:
        return 0.0
    middle = d[:: max(1, d.size // 200_000)]
    return float(np.mean((middle - middle.mean()) ** 2)) / 2


def _edges(pair: FramePair, variance: float) -> NDArray[np.float64]:
    """Return the edges of the bins: wider than the noise of the sorting, and a single bin for a uniform frame."""
    some = pair.bright[pair.good]
    some = some[:: max(1, some.size // 200_000)]
    low, high = np.percentile(some, (0.1, 99.9)).tolist() if some.size else (0.0, 0.0)
    noise = np.sqrt(max(variance, 1e-12) / pair.frames)
    # bins narrower than the noise would sort by noise, and bias the mean within a bin
    width = max(4 * noise, (high - low) / MAX_BINS)
    coarse = pair.a.dtype.kind in "iu" and variance < COARSE
    width = max(width, LEAST_WIDTH) if coarse else width
    count = int((high - low) / width) if width > 0 else 0
    if count < 2:
        return np.array([-np.inf, np.inf])
    inner = np.linspace(low, high, count + 1)[1:-1]
    if coarse:
        # means of few integer samples are on a grid, where their position depends on their difference
        level = float(np.median(pair.dark))
        inner = np.round(inner + level) + 0.5 / pair.frames - level
    return np.concatenate([[-np.inf], inner, [np.inf]])


def _moments(
    pair: FramePair, alpha: NDArray[np.float64], edges: NDArray[np.float64], quick: float
) -> tuple[TransferPoints, tuple[float, float]]:
    side = pattern_side(pair.cfa)
    bins = len(edges) - 1
    limits = np.full((side * side * bins, 2), (-np.inf, np.inf))
    for turn in range(2):
        n, s1, d1, d2 = np.zeros((4, side * side * bins))
        products = np.zeros((2, 2))
        for part in strips((pair.a.shape[0], pair.a.shape[1]), side):
            a, b, good = _above(pair, part)
            d = (1 - alpha[part]) * a - (1 + alpha[part]) * b
            m = (a + b) * 0.5 * (1 - alpha[part] ** 2)
            where = _bin(pair, part, edges, side)
            good = good & (d >= limits[where, 0]) & (d <= limits[where, 1])
            index, chosen = where[good], d[good]
            n += np.bincount(index, minlength=n.size)
            s1 += np.bincount(index, m[good], minlength=n.size)
            d1 += np.bincount(index, chosen, minlength=n.size)
            d2 += np.bincount(index, chosen * chosen, minlength=n.size)
            if turn:
                products += _neighbours(np.where(good, d - limits[where].mean(axis=-1), 0), good, side)
        mean = d1 / np.maximum(n, 1)
        variance = (d2 / np.maximum(n, 1) - mean**2) * n / np.maximum(n - 1, 1)
        # a particle or a blinking pixel must not dominate the variance of a bin
        reach = CLIP_SIGMA * np.sqrt(np.maximum(variance, quick * 1e-3)) + 1e-6
        limits = np.stack([mean - reach, mean + reach], axis=1)
    factor = 1 + float(np.mean(alpha**2))
    enough = n >= MIN_PIXELS
    at = np.flatnonzero(enough)
    points = TransferPoints(
        s1[at] / n[at] / factor,
        variance[at] / 2 / factor,
        n[at].astype(np.int64),
        np.zeros(at.size, np.int64),
        at // bins,
    )
    likeness = products[0] / np.maximum(products[1], 1e-300)
    return points, (float(likeness[0]), float(likeness[1]))


def _bin(pair: FramePair, part: slice, edges: NDArray[np.float64], side: int) -> NDArray[np.intp]:
    where = np.searchsorted(edges[1:-1], pair.bright[part])
    if side > 1:
        rows, columns = np.arange(part.start, part.stop) % side, np.arange(pair.a.shape[1]) % side
        where = where + (rows[:, None] * side + columns) * (len(edges) - 1)
    return where


def _neighbours(d: NDArray[np.float64], good: NDArray[np.bool_], side: int) -> NDArray[np.float64]:
    """Return sums of products of neighbours of one colour and of their norms, ``(2, axes)``."""
    out = np.zeros((2, 2))
    for axis, (first, second) in enumerate(
        (
            ((slice(None, -side), slice(None)), (slice(side, None), slice(None))),
            ((slice(None), slice(None, -side)), (slice(None), slice(side, None))),
        )
    ):
        both = good[first] & good[second]
        one, two = d[first] * both, d[second] * both
        out[0, axis] = float((one * two).sum())
        out[1, axis] = float(np.sqrt((one * one).sum() * (two * two).sum()))
    return out
