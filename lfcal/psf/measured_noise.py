"""Measure the noise in the frames themselves, if no file states it.

Repeated frames of a position, and the reference frames of a session, differ only by their noise. Frames of
neighbouring positions also differ by signal. At a fixed pixel of the sensor, however, the signal is a smooth function
of the position. From one position to the next, the image moves by a pixel, and by a fraction of one under its lenslet.
Fourth differences along both axes of a block of 5 x 5 positions cancel the signal and keep the noise. Where the signal
is not smooth, at the edges of micro-images, differences along only one axis show it. They are orthogonal to the
others, so leaving such pixels out causes no bias. The part of a difference explained by the light and its gradient is
due to the lamp and the stage. The contribution of the remaining signal grows with the square of the mean value m. The
variance is therefore fitted as ``floor + slope m + q m²``, and the last term is dropped.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import LfcalError, Region, moved
from lfcal.camera import ScanPlan
from lfcal.frames import Frames, FrameSource
from lfcal.psf.cutout import Cutout, Gatherer, by_position
from lfcal.psf.provenance import FrameNoise

__all__ = ["measure_noise", "scan_noise"]

F8 = NDArray[np.float64]

FEW_BLOCKS, BLOCKS = 4, 16
"""Smallest and largest number of blocks of neighbouring positions that are examined."""

PER_BLOCK = 250
"""Number of frames of a scan for each block, so that measuring reads about a tenth of them again, at least 100."""

PAIRS = 32
"""Largest number of pairs of repeated frames that are compared."""

FEWEST = 1000
"""Number of samples needed for a measurement."""

ALIKE = 60
"""Number of samples of similar brightness whose roughness is compared."""

BETTER = 3.0
"""Number of standard errors that the term of signal² must exceed to be fitted."""

CLIPPED = 0.9950
"""Mean square of a standard normal variable whose squares above 9 count as 9."""

CERTAIN = 0.25
"""Largest relative standard error with which the slope counts as measured."""

SMOOTH = 0.5
"""Fraction of the pixels of similar brightness that is kept: those with the smoothest signal."""


ROUGH, TURNS = 2.5, 2
"""Ratio of roughness to noise up to which a sample is smooth, and number of noise measurements on such samples."""


class _Samples(NamedTuple):
    """Means and differences of samples, each ``(n,)``; the mean of ``difference²`` is the variance of one sample.

    ``around`` is light of about the same brightness with independent noise: from other weights, or from neighbouring
    pixels. ``roughness`` is the contribution of the signal to other differences of the same samples. ``own`` is the
    variance of the mean, as a fraction of that of a sample.
    """

    mean: F8
    around: F8
    difference: F8
    roughness: F8
    own: F8

    def of_those(self, kept: NDArray[np.intp]) -> _Samples:
        """Return the samples with these indices."""
        mean, around, difference, roughness, own = (one[kept] for one in self)
        return _Samples(mean, around, difference, roughness, own)

    @classmethod
    def of(cls, mean: F8, around: F8, difference: F8, roughness: F8, own: float, valid: NDArray[np.bool_]) -> _Samples:
        """Return the valid samples of ``(rows, columns)``, without those whose surroundings have no brightness."""
        difference = _unexplained(difference, mean, valid)
        kept = valid & np.isfinite(around)
        every = np.full(int(kept.sum()), own)
        return cls(mean[kept], around[kept], difference[kept], roughness[kept], every)


def measure_noise(gatherer: Gatherer, order: NDArray[np.int64], counts: NDArray[np.int64]) -> FrameNoise | None:
    """Return the noise of the frames of a scan: as they state it, or else as measured.

    It is measured from repeated frames, or else from frames of neighbouring positions. None if no noise is stated, and
    the frames do not determine it.

    Parameters
    ----------
    gatherer
        Reader of the cutouts of corrected frames.
    order
        Frame numbers, sorted by position.
    counts
        Number of frames at each position ``(nz, ny, nx)``.
    """
    said = _stated(gatherer, order)
    if said is not None:
        return said
    first = np.concatenate([[0], np.cumsum(counts.ravel())[:-1]]).reshape(counts.shape)
    dark = gatherer.source.metadata.dark_noise
    floor, share = (None, 1.0) if dark is None else (dark.variance, 1 + 1 / dark.count)
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
        words = f"floor from {'dark frames' if floor is not None else name}, slope from {name}"
        return FrameNoise(constant * share, slope, black, words)
    return None


def scan_noise(source: FrameSource, plan: ScanPlan) -> FrameNoise | None:
    """Return the noise of the corrected frames ``source`` of a scan, as `measure_noise` does; None if unknown."""
    infos = tuple(source.info(k) for k in range(len(source)))
    order, starts = by_position(infos, plan.shape[:3])
    gatherer = Gatherer(source, infos, Cutout.for_plan(plan, outside="zero"))
    return measure_noise(gatherer, order, np.diff(starts).reshape(plan.shape[:3]))


def _stated(gatherer: Gatherer, order: NDArray[np.int64]) -> FrameNoise | None:
    """Return the noise that the frames state for a typical sample; None if they state none."""
    try:
        found = gatherer.cut(int(order[len(order) // 2])).noise
    except LfcalError:  # a damaged frame is reported when its pattern is made
        return None
    if found is None:
        return None
    return FrameNoise(float(found.constant), float(found.slope), 0.0, "as in the camera description", stated=True)


def _repeated(
    gatherer: Gatherer, order: NDArray[np.int64], first: NDArray[np.int64], counts: NDArray[np.int64]
) -> Iterator[_Samples]:
    """Yield samples of pairs of repeated frames: of positions that were recorded twice, and a session's references."""
    repeated = np.argwhere(counts > 1)
    for at in repeated[:: max(1, len(repeated) // PAIRS)][:PAIRS]:
        k = int(first[tuple(at)])
        numbers = [int(order[k]), int(order[k + 1])]
        if (found := _values(gatherer, numbers, numbers[0])) is not None:
            yield _pair(*found)
    yield from _references(gatherer.source)


def _references(source: FrameSource) -> Iterator[_Samples]:
    """Yield samples from pairs of the reference frames that a session recorded repeatedly at one position."""
    try:
        again = source.repeats() if isinstance(source, Frames) else None
        # each frame is in one pair, because the noise of two pairs that share a frame is not independent
        for k in range(0, min(2 * PAIRS, 0 if again is None else len(again) - 1), 2):
            assert again is not None
            if again.info(k).origin != again.info(k + 1).origin:
                continue
            one, other = again.samples(k), again.samples(k + 1)
            values = np.stack([one.values, other.values]).astype(np.float64)
            valid = np.ones(again.shape, np.bool_)
            for frame in (one, other):
                valid &= np.isfinite(frame.values) if frame.valid is None else frame.valid
            # identical frames are copies
            if valid.any() and (values[0] != values[1])[valid].any():
                yield _pair(values, valid)
    except LfcalError:
        return  # damaged reference frames: the noise is measured on neighbouring positions


def _pair(values: F8, valid: NDArray[np.bool_]) -> _Samples:
    """Return samples of two frames ``(2, rows, columns)`` of the same position."""
    mean, difference = values.mean(axis=0), (values[0] - values[1]) / np.sqrt(2)
    padded, there = np.pad(np.where(valid, mean, 0.0), 1), np.pad(valid, 1).astype(np.float64)
    sides = np.array([(row, column) for row, column in np.ndindex(3, 3) if (row, column) != (1, 1)])
    height, width = mean.shape
    total, count = (sum(one[r : r + height, c : c + width] for r, c in sides) for one in (padded, there))
    around = np.divide(total, count, out=np.full(mean.shape, np.nan), where=np.asarray(count) > 0)
    return _Samples.of(mean, around, difference, np.zeros(mean.shape), 0.5, valid)


def _unexplained(difference: F8, light: F8, valid: NDArray[np.bool_]) -> F8:
    """Return a difference of frames minus the part due to lamp and stage, which light and its gradient explain."""
    light = np.where(np.isfinite(light), light, 0.0)
    slopes = np.gradient(light) if min(light.shape) > 1 else []
    basis = np.stack([one[valid] for one in (light, *slopes)], axis=1)
    own, sizes, _ = np.linalg.svd(basis, full_matrices=False)
    own = own[:, sizes > 1e-9 * max(float(sizes.max(initial=0.0)), 1e-300)]
    apart = difference[valid]
    out = np.zeros(difference.shape)
    # the part that is explained takes a fraction of the noise with it
    out[valid] = (apart - own @ (own.T @ apart)) / np.sqrt(np.maximum(1.0 - np.square(own).sum(axis=1), 0.5))
    return out


def _neighbours(
    gatherer: Gatherer, order: NDArray[np.int64], first: NDArray[np.int64], counts: NDArray[np.int64], side: int
) -> Iterator[_Samples]:
    """Yield samples of blocks of ``side`` x ``side`` neighbouring positions."""
    # orthogonal polynomials over the positions: the last one is the difference that cancels all the others
    basis = np.linalg.qr(np.vander(np.arange(side) - side // 2, increasing=True).astype(np.float64))[0].T
    both = np.kron(basis[-1], basis[-1])
    single = np.stack([np.kron(*pair) for one in basis[:-1] for pair in ((basis[-1], one), (one, basis[-1]))])
    # a mean whose noise is independent of both the other mean and the difference
    apart = np.linalg.pinv(np.stack([np.ones(side * side), both**2, both])) @ np.array([1.0, 0.0, 0.0])
    for z, y, x in _blocks(counts, side):
        numbers = order[first[z, y : y + side, x : x + side].ravel()].tolist()
        if (found := _values(gatherer, numbers, numbers[len(numbers) // 2])) is not None:
            values, valid = found
            mean, around, difference = (np.tensordot(weights, values, axes=1) for weights in (both**2, apart, both))
            roughness = np.square(np.tensordot(single, values, axes=1)).mean(axis=0)
            yield _Samples.of(mean, around, difference, roughness, float((both**4).sum()), valid)


def _blocks(counts: NDArray[np.int64], side: int) -> Iterator[tuple[int, int, int]]:
    """Yield the first positions of blocks that were recorded completely, spread over planes and positions."""
    nz, ny, nx = counts.shape
    if min(ny, nx) < side:
        return
    wanted = max(FEW_BLOCKS, min(BLOCKS, int(counts.sum()) // PER_BLOCK))
    ahead = np.pad((counts > 0).astype(np.int64), ((0, 0), (1, 0), (1, 0))).cumsum(1).cumsum(2)
    inside = ahead[:, side:, side:] - ahead[:, :-side, side:] - ahead[:, side:, :-side] + ahead[:, :-side, :-side]
    places = np.argwhere(inside == side * side)
    if not len(places):
        return
    taken = set[tuple[int, ...]]()
    for k in range(wanted):
        share = (k + 0.5) / wanted
        aim = np.array([min(nz - 1, int(share * nz)), share * (ny - side), share * (nx - side)])
        far = np.abs(places - aim) @ np.array([ny + nx, 1.0, 1.0])
        z, y, x = places[int(far.argmin())].tolist()
        if (z, y, x) not in taken:
            taken.add((z, y, x))
            yield z, y, x


def _values(gatherer: Gatherer, numbers: list[int], middle: int) -> tuple[F8, NDArray[np.bool_]] | None:
    """Return samples ``(frames, rows, columns)`` of the same pixels of the sensor, around those of frame ``middle``.

    The second result is True for the pixels ``(rows, columns)`` that are valid in all these frames. None: there are no
    such pixels.
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
        try:
            found = gatherer.source.samples(k, moved(region, (-origin[0], -origin[1])))
        except LfcalError:  # a damaged frame is reported when its pattern is made
            return None
        values.append(np.asarray(found.values, np.float64))
        valid &= np.isfinite(values[-1]) if found.valid is None else found.valid
    return (np.stack(values), valid) if valid.any() else None


def _fitted(samples: _Samples, floor: float | None) -> tuple[float, float, float] | None:
    """Return floor, slope and the sample value without light; None if the samples do not determine them."""
    # most pixels of a scan of points are dark
    black = float(np.median(samples.mean[samples.mean <= np.median(samples.mean)]))
    black = 0.0 if abs(black) < 3 * float(np.median(np.abs(samples.difference))) else black
    kept = samples.of_those(_smooth(samples))
    top = float((kept.mean - black).max(initial=0.0))
    if top <= 0:
        return None
    samples = samples._replace(
        mean=(samples.mean - black) / top, around=(samples.around - black) / top, own=samples.own / top**2
    )
    kept = samples.of_those(_smooth(samples))
    terms, sigmas = _terms(kept, floor)
    for _ in range(TURNS):
        # even the smoothest of bright samples may be rough: only roughness beyond the noise counts
        variance = np.maximum(samples.around, 0.0)[:, None] ** np.arange(2) @ terms[:2]
        kept = samples.of_those(np.flatnonzero(samples.roughness <= ROUGH * variance))
        if kept.mean.size < FEWEST:
            return None
        terms, sigmas = _terms(kept, floor)
    constant, slope, sigma = float(terms[0]), float(terms[1]), float(sigmas[1])
    if not slope > 0 or sigma > CERTAIN * slope or constant + slope <= 0:
        return None
    return constant, slope / top, black


def _terms(samples: _Samples, floor: float | None) -> tuple[F8, F8]:
    """Return the terms of the variance that the samples need, and their standard errors."""
    fits = [_likely(samples, floor, count) for count in (2, 3)]
    # an unnecessary term would take part of the slope
    return fits[1] if fits[1][0][-1] > BETTER * fits[1][1][-1] else fits[0]


def _likely(samples: _Samples, floor: float | None, count: int) -> tuple[F8, F8]:
    """Return ``count`` terms of a variance that is a polynomial of the light, and their standard errors.

    Each squared difference has the variance as its mean, so brightness may differ from sample to sample. Weights and
    moments are taken by the light of the pixels around, whose noise is not the sample's (instrumental variable). If
    they were taken by the light of the sample itself, noise that lowers it would raise its weight. The floor in faint
    light would then be a tenth to a third too high. Squares above 9 variances count as 9 variances, because they
    contain signal that the differences did not cancel.
    """
    from scipy.optimize import nnls

    square, known = np.square(samples.difference), floor or 0.0
    free = slice(0 if floor is None else 1, count)
    # the square of a mean includes its variance
    light = np.stack([np.ones_like(square), samples.mean, samples.mean**2 - samples.own * square], axis=1)[:, free]
    around = np.maximum(samples.around, 0.0)[:, None] ** np.arange(count)[free]
    variance = np.full(len(square), max(known, float(np.median(square)) / 0.455))
    seen = variance
    for _ in range(12):
        target = np.minimum(square, 9 * seen) / CLIPPED - known
        moments = around / np.square(variance)[:, None]
        matrix = moments.T @ light
        terms, _ = nnls(matrix, moments.T @ target)
        model = known + around @ terms
        least = 0.25 * float(np.median(model))
        variance = np.maximum(model, least)
        seen = np.maximum(variance, known + light @ terms)
    inverse = np.linalg.pinv(matrix)
    sigmas = np.sqrt(2 * np.abs(np.diag(inverse @ (moments.T @ (np.square(variance)[:, None] * moments)) @ inverse.T)))
    if floor is not None:
        return np.append(floor, terms), np.append(0.0, sigmas)
    return terms, sigmas


def _smooth(samples: _Samples) -> NDArray[np.intp]:
    """Return the indices of the samples whose signal is smoothest among those of similar brightness."""
    order = np.argsort(-samples.around, kind="stable")
    parts = np.array_split(order, max(1, len(order) // ALIKE))
    rough = [samples.roughness[part] for part in parts]
    return np.concatenate([part[own <= np.quantile(own, SMOOTH)] for part, own in zip(parts, rough, strict=True)])
