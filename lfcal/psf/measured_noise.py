"""The noise of frames, measured on the frames themselves where no file states it.

Repeated frames of a position differ by their noise alone. Frames of neighbouring positions differ by signal as well.
At a fixed pixel of the sensor, however, the signal is a smooth function of the position: from one position to the next
the image moves by a pixel, and under its lenslet by a fraction of one. Fourth differences along both axes of a block of
5 x 5 positions cancel it and keep the noise. Where the signal is not smooth, at the edges of micro-images, differences
along one axis alone show it first. They are orthogonal to the others, so leaving such pixels out biases nothing. What
remains of the signal grows with its square, as flicker of the lamp does: the variance is fitted as
``floor + slope m + q m²``, and the last term is dropped.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.frames.regions import Region, moved
from lfcal.psf.gather import Gatherer

__all__ = ["MeasuredNoise", "measure_noise"]

F8 = NDArray[np.float64]

BLOCKS = 16
"""Blocks of neighbouring positions that are looked at, at most."""

PER_BLOCK = 250
"""Frames of a scan for each block: measuring reads at most a tenth of the frames once more."""

PAIRS = 32
"""Pairs of repeated frames that are looked at, at most."""

FEWEST = 1000
"""Samples that a measurement needs."""

ALIKE = 60
"""Samples of like brightness whose roughness is compared."""

BETTER = 3.0
"""Standard errors that the term of signal² must exceed to be fitted."""

CLIPPED = 0.9950
"""Mean square of a normal number whose squares beyond 9 count as 9."""

CERTAIN = 0.25
"""Largest relative standard error of the slope that counts as measured."""

SMOOTH = 0.5
"""Share of the pixels of like brightness that is kept: those whose signal is smoothest."""


class MeasuredNoise(NamedTuple):
    """The noise of a sample of one corrected frame: its variance at value v is ``floor + slope max(v - black, 0)``.

    Attributes
    ----------
    floor
        Variance without light (counts²).
    slope
        Growth of the variance per count of signal (counts).
    black
        Value of no light (counts).
    source
        Where it is known from, in words.
    stated
        Whether the frames themselves state it, sample by sample.
    """

    floor: float
    slope: float
    black: float
    source: str
    stated: bool = False

    def record(self) -> dict[str, Any]:
        """Return what H keeps of it."""
        return {"floor": self.floor, "slope": self.slope, "black": self.black, "from": self.source}


class _Samples(NamedTuple):
    """Means and differences of samples ``(n,)``; ``difference²`` has the variance of one sample as its mean.

    ``roughness`` is what the signal adds to other differences of the same samples. ``own`` is the variance of the mean,
    as a share of that of a sample.
    """

    mean: F8
    difference: F8
    roughness: F8
    own: F8


def measure_noise(gatherer: Gatherer, order: NDArray[np.int64], counts: NDArray[np.int64]) -> MeasuredNoise | None:
    """Return the noise of the frames of a scan, None where too few of them are alike.

    Parameters
    ----------
    gatherer
        The frames, corrected.
    order
        Their numbers, sorted by position.
    counts
        How many belong to each position ``(nz, ny, nx)``.
    """
    said = _stated(gatherer, order)
    if said is not None:
        return said
    first = np.concatenate([[0], np.cumsum(counts.ravel())[:-1]]).reshape(counts.shape)
    dark = gatherer.source.metadata.get("dark_noise", {})
    floor, share = dark.get("variance"), 1 + (1 / dark["count"] if dark.get("count") else 0.0)
    ways = (
        ("repeated frames", _repeated(gatherer, order, first, counts)),
        ("neighbouring positions", _neighbours(gatherer, order, first, counts, 5)),
        ("neighbouring positions, at most", _neighbours(gatherer, order, first, counts, 3)),
    )
    for name, parts in ways:
        found = list(parts)
        samples = _Samples(*map(np.concatenate, zip(*found, strict=True))) if found else None
        if samples is None or samples.mean.size < FEWEST:
            continue
        fitted = _fitted(samples, floor)
        if fitted is None:
            continue
        constant, slope, black = fitted
        words = f"floor from {'darks' if floor is not None else name}, slope from {name}"
        return MeasuredNoise(constant * share, slope, black, words)
    return None


def _stated(gatherer: Gatherer, order: NDArray[np.int64]) -> MeasuredNoise | None:
    """Return the noise that the frames state of a typical sample, None where they state none."""
    found = gatherer.cut(int(order[len(order) // 2])).noise
    if found is None:
        return None
    return MeasuredNoise(float(found.constant), float(found.slope), 0.0, "as the camera is described", stated=True)


def _repeated(
    gatherer: Gatherer, order: NDArray[np.int64], first: NDArray[np.int64], counts: NDArray[np.int64]
) -> Iterator[_Samples]:
    """Yield samples of pairs of repeated frames."""
    repeated = np.argwhere(counts > 1)
    for at in repeated[:: max(1, len(repeated) // PAIRS)][:PAIRS]:
        k = int(first[tuple(at)])
        numbers = [int(order[k]), int(order[k + 1])]
        if (values := _values(gatherer, numbers, numbers[0])) is not None:
            mean = values.mean(axis=0)
            yield _Samples(mean, (values[0] - values[1]) / np.sqrt(2), np.zeros_like(mean), np.full_like(mean, 0.5))


def _neighbours(
    gatherer: Gatherer, order: NDArray[np.int64], first: NDArray[np.int64], counts: NDArray[np.int64], side: int
) -> Iterator[_Samples]:
    """Yield samples of blocks of ``side`` x ``side`` neighbouring positions."""
    # orthogonal polynomials over the positions: the last one is the difference that cancels all others
    basis = np.linalg.qr(np.vander(np.arange(side) - side // 2, increasing=True).astype(np.float64))[0].T
    both = np.kron(basis[-1], basis[-1])
    single = np.stack([np.kron(*pair) for one in basis[:-1] for pair in ((basis[-1], one), (one, basis[-1]))])
    for z, y, x in _blocks(counts, side):
        numbers = order[first[z, y : y + side, x : x + side].ravel()].tolist()
        if (values := _values(gatherer, numbers, numbers[len(numbers) // 2])) is not None:
            mean = both**2 @ values
            own = np.full_like(mean, (both**4).sum())
            yield _Samples(mean, both @ values, ((single @ values) ** 2).sum(axis=0), own)


def _blocks(counts: NDArray[np.int64], side: int) -> Iterator[tuple[int, int, int]]:
    """Yield the first positions of blocks that were recorded whole, spread over planes and positions."""
    nz, ny, nx = counts.shape
    if min(ny, nx) < side:
        return
    wanted = max(1, min(BLOCKS, int(counts.sum()) // PER_BLOCK))
    ahead = np.pad((counts > 0).astype(np.int64), ((0, 0), (1, 0), (1, 0))).cumsum(1).cumsum(2)
    inside = ahead[:, side:, side:] - ahead[:, :-side, side:] - ahead[:, side:, :-side] + ahead[:, :-side, :-side]
    places = np.argwhere(inside == side * side)
    if not len(places):
        return
    for k in range(wanted):
        share = (k + 0.5) / wanted
        aim = np.array([min(nz - 1, int(share * nz)), share * (ny - side), share * (nx - side)])
        far = np.abs(places - aim) @ np.array([ny + nx, 1.0, 1.0])
        z, y, x = places[int(far.argmin())].tolist()
        yield z, y, x


def _values(gatherer: Gatherer, numbers: list[int], middle: int) -> F8 | None:
    """Return samples ``(frames, pixels)`` of the same pixels of the sensor in some frames, about the ``middle`` one's.

    Pixels that carry no measurement in one of them are left out; None: they have none in common.
    """
    rows, columns = moved(gatherer.place(middle)[1], gatherer.infos[middle].origin)
    height, width = gatherer.source.shape
    tops, lefts = ([gatherer.infos[k].origin[axis] for k in numbers] for axis in (0, 1))
    row = slice(max(rows.start, *tops), min(rows.stop, *(top + height for top in tops)))
    column = slice(max(columns.start, *lefts), min(columns.stop, *(left + width for left in lefts)))
    if row.stop <= row.start or column.stop <= column.start:
        return None
    region: Region = (row, column)
    values, valid = [], np.ones((row.stop - row.start, column.stop - column.start), np.bool_)
    for k in numbers:
        origin = gatherer.infos[k].origin
        found = gatherer.source.samples(k, moved(region, (-origin[0], -origin[1])))
        values.append(np.asarray(found.values, np.float64))
        valid &= np.isfinite(values[-1]) if found.valid is None else found.valid
    return np.stack(values)[:, valid]


def _fitted(samples: _Samples, floor: float | None) -> tuple[float, float, float] | None:
    """Return floor, slope and the value of no light; None where the samples do not determine them."""
    # most pixels of a scan of points are dark
    black = float(np.median(samples.mean[samples.mean <= np.median(samples.mean)]))
    black = 0.0 if abs(black) < 3 * float(np.median(np.abs(samples.difference))) else black
    kept = _smooth(samples)
    light, square = samples.mean[kept] - black, samples.difference[kept] ** 2
    top = float(light.max(initial=0.0))
    if top <= 0:
        return None
    powers = [np.ones_like(light), light / top, (np.maximum(light, 0) / top) ** 2]
    first = 0 if floor is None else 1
    own, line = samples.own[kept] / top**2, 1 - first
    fits = [_likely(np.stack(powers[first:last], axis=1), square, floor or 0.0, own, line) for last in (2, 3)]
    # a term that the samples do not need would take part of the slope
    terms, sigmas = fits[1] if fits[1][0][-1] > BETTER * fits[1][1][-1] else fits[0]
    constant = float(terms[0]) if floor is None else floor
    slope, sigma = float(terms[1 - first]), float(sigmas[1 - first])
    if not slope > 0 or sigma > CERTAIN * slope or constant + slope <= 0:
        return None
    return constant, slope / top, black


def _likely(design: F8, square: F8, known: float, own: F8, line: int) -> tuple[F8, F8]:
    """Return the terms of a variance that make squares of normal differences most likely, and their standard errors.

    Each square has the variance as its mean, so brightness may differ from sample to sample. Squares beyond 9 variances
    count as 9: signal that the differences did not cancel. Noise of the brightness itself, ``own`` variances in column
    ``line``, would flatten the slope and is taken off.
    """
    from scipy.optimize import nnls

    variance = np.full(len(square), max(known, float(np.median(square)) / 0.455))
    for _ in range(12):
        target = np.minimum(square, 9 * variance) / CLIPPED - known
        scaled = design / variance[:, None]
        normal = scaled.T @ scaled
        normal[line, line] = max(normal[line, line] - float((own / variance).sum()), 0.05 * normal[line, line])
        terms, _ = nnls(normal, scaled.T @ (target / variance))
        model = known + design @ terms
        variance = np.maximum(model, 0.25 * float(np.median(model)))
    return terms, np.sqrt(2 * np.abs(np.diag(np.linalg.pinv(normal))))


def _smooth(samples: _Samples) -> NDArray[np.intp]:
    """Return the samples whose signal is smoothest among those of like brightness."""
    order = np.argsort(-samples.mean, kind="stable")
    parts = np.array_split(order, max(1, len(order) // ALIKE))
    rough = [samples.roughness[part] for part in parts]
    return np.concatenate([part[own <= np.quantile(own, SMOOTH)] for part, own in zip(parts, rough, strict=True)])
