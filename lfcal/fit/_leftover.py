"""What a plane's recorded patterns show beyond a model: how it moves, where it helps, and what is left unknown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, for_each_chunk, one_blas_thread, worker_count
from lfcal.fit._leftover_field import Moving, ResidualField, sampled_variance
from lfcal.fit._leftover_size import PlaneResiduals, sized
from lfcal.fit.spread import spread_out

__all__ = ["Leftover", "ResidualKind", "iter_leftover", "left_out", "spot_velocity"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Flags = NDArray[np.bool_]

GAIN = 2.0
"""Standard deviations by which left-out patterns must be nearer for positions between recorded ones to follow."""

FOLDS = 5
"""Sets that recorded positions are left out in."""

FEW = 8
"""Recorded positions of a plane below which none is left out to choose by."""

LENGTHS = ((1.0, 0.5), (1.5, 0.5), (2.0, 0.6), (2.5, 0.7), (3.5, 0.8), (5.0, 1.0))
"""Correlation lengths that are tried: source positions, pixels."""

USUAL = LENGTHS[1]

STRAY = (2.5, 0.7)
"""Correlation lengths of stray light."""

SAMPLES = 8
"""Fields that are drawn for the posterior variance."""

TRIED = 150_000
"""Entries of the middle of a plane by which lengths, velocities and variances are found."""

NEAR = Moving(0.0, 1.0, 0.5)
"""Correlation of the part of spots' residuals that hardly reaches from one position to the next."""

NEAR_SHARES = (0.3, 0.6)
"""Its share of the variance that is tried: by one length alone what is far would be too smooth, or near too rough."""

LIT = 0.02
"""Share of the plane's brightest pixel above which a pixel is lit."""

RATIOS = np.linspace(-3.0, 3.0, 13)
"""Decadic logarithm of variance over noise at which the posterior's share of the variance is found."""

TILE = 32
"""Pixels of the cutout, each way, that are solved at a time."""


@dataclass(frozen=True, slots=True)
class ResidualKind:
    """Of what kind a plane's residual is.

    Attributes
    ----------
    spots, stray
        Correlation of what spots and stray light lack; None: no more than noise shows.
    near
        Share of the spots' variance that hardly reaches from one position to the next.
    supported
        Whether positions that were left out were predicted better by their neighbours than by the model alone.
    spread
        What left-out positions scatter, over what was stated for them (squares).
    """

    spots: Moving | None = None
    stray: Moving | None = None
    near: float = NEAR_SHARES[0]
    supported: bool = False
    spread: float = 1.0

    @property
    def empty(self) -> bool:
        """Whether there is no more than noise."""
        return self.spots is None and self.stray is None


@dataclass(frozen=True, eq=False)
class Leftover:
    """The estimate of what a model lacks.

    Attributes
    ----------
    kind
        Of what kind it is.
    value, variance
        The estimate ``(ny, nx, nt, ns)`` and its variance.
    prior
        Variance of what the model lacks, where nothing is measured.
    """

    kind: ResidualKind
    value: F4
    variance: F4
    prior: F4


def spot_velocity(model: F4, *, around: bool = True) -> float:
    """Return by how many pixels of the cutout spots move where the source goes on by one position.

    By the correlation of patterns up to four positions apart, less their mean.
    """
    varying = model - model.mean((0, 1))
    rates = np.arange(-1.2, 1.21, 0.05)
    total = np.zeros_like(rates)
    for axis in (0, 1):
        for step in range(1, min(5, model.shape[axis])):
            reach = min(math.ceil(1.2 * step) + 1, model.shape[axis + 2] - 1)
            shifts = np.arange(-reach, reach + 1)
            found = [_correlation(varying, axis, step, int(shift), around=around) for shift in shifts]
            total += np.interp(rates * step, shifts, found)
    return float(rates[int(np.argmax(total))])


def _correlation(values: F4, axis: int, step: int, shift: int, *, around: bool) -> float:
    """Return the correlation of patterns with those ``step`` positions on, moved by ``shift`` pixels."""
    other = np.roll(values, (-step, -shift), (axis, axis + 2))
    inside = [slice(None)] * 4
    size = values.shape[axis + 2]
    inside[axis + 2] = slice(max(0, -shift), size - max(0, shift))
    if not around:
        inside[axis] = slice(0, values.shape[axis] - step)
    a, b = values[tuple(inside)], other[tuple(inside)]
    scale = math.sqrt(float(np.square(a).sum(dtype=np.float64)) * float(np.square(b).sum(dtype=np.float64)))
    return float((a * b).sum(dtype=np.float64)) / scale if scale > 0 else 0.0


def _field(data: PlaneResiduals, kind: ResidualKind) -> ResidualField:
    spots, stray = data.sizes
    if kind.spots is None or kind.stray is None:
        # one part alone has all of the variance
        spots = stray = np.hypot(spots, stray)
    parts, shown = [], []
    if kind.spots is not None:
        near = replace(NEAR, velocity=kind.spots.velocity)
        parts += [kind.spots, near]
        shown += [np.float32(math.sqrt(1 - kind.near)) * spots, np.float32(math.sqrt(kind.near)) * spots]
    if kind.stray is not None:
        parts.append(kind.stray)
        shown.append(stray)
    return ResidualField(parts, shown, around=data.around)


def chosen_kind(part: PlaneResiduals, velocity: float, seed: int = 0) -> ResidualKind:
    """Return of what kind a plane's residual is, by patterns that are left out to be predicted by the others."""
    spots, stray = (bool(size.any()) for size in part.sizes)
    usual = ResidualKind(Moving(velocity, *USUAL) if spots else None, Moving(-velocity, *STRAY) if stray else None)
    places = np.argwhere(part.recorded)
    if len(places) < FEW:
        return usual
    sets = left_out(part)
    aside = sets[0]
    candidates = [usual]
    if stray:
        candidates += [replace(usual, stray=Moving(rate, *STRAY)) for rate in (0.0, velocity)]
    best, gains = _best(part, aside, candidates)
    if spots:
        tried = [replace(best, spots=Moving(velocity, *one)) for one in LENGTHS if one != USUAL]
        best, gains = _best(part, aside, [best, *tried])
    if spots and stray:
        best, gains = _best(part, aside, [best, replace(best, spots=None), replace(best, stray=None)])
    helped = float(gains.sum()) > GAIN * math.sqrt(float(np.square(gains).sum()))
    # what hardly reaches to neighbours shows in what is not told of them
    shares = NEAR_SHARES if best.spots is not None else NEAR_SHARES[:1]
    kinds = [replace(best, near=share, supported=helped) for share in shares]
    found = [replace(one, spread=_spread(part, sets, one, seed)) for one in kinds]
    return min(found, key=lambda one: abs(math.log(one.spread)))


def left_out(part: PlaneResiduals) -> list[Flags]:
    """Return sets ``(ny, nx)`` of recorded positions, each of them spread over the plane; none is in two."""
    found: list[Flags] = []
    places = np.argwhere(part.recorded)
    count = max(2, len(places) // FOLDS)
    while len(places) >= count and len(found) < FOLDS:
        some = spread_out(np.c_[np.zeros(len(places), np.intp), places], count, part.period)
        found.append(np.zeros(part.recorded.shape, np.bool_))
        found[-1][tuple(places[some].T)] = True
        places = np.delete(places, some, axis=0)
    return found


def _middle(data: PlaneResiduals) -> tuple[slice, slice]:
    """Return rows and columns of the cutout's middle that hold as much as is tried."""
    ny, nx, nt, ns = data.model.shape
    side = max(5, math.isqrt(TRIED // (ny * nx)))
    rows, columns = (slice(max(0, (n - side) // 2), max(0, (n - side) // 2) + min(n, side)) for n in (nt, ns))
    return rows, columns


def _best(data: PlaneResiduals, aside: Flags, kinds: Sequence[ResidualKind]) -> tuple[ResidualKind, F8]:
    """Return the kind that predicts the patterns ``aside`` best, and by how much it is better at each of them."""
    found: list[tuple[float, int, F8]] = []
    kept = data.without(aside)
    for k, kind in enumerate(kinds):
        field = _field(data, kind)
        value = field.estimate(kept.residual, kept.precision)[aside]
        noise, residual = data.precision[aside], data.residual[aside]
        weight = noise / (1.0 + noise * field.variance[aside])
        gains = (weight * (np.square(residual) - np.square(residual - value))).sum((1, 2), dtype=np.float64)
        found.append((float(gains.sum()), -k, gains))
    _, k, gains = max(found, key=lambda one: one[:2])
    return kinds[-k], gains


def _spread(data: PlaneResiduals, sets: Sequence[Flags], kind: ResidualKind, seed: int) -> float:
    """Return what left-out patterns scatter about their prediction beyond noise, over what is stated (squares).

    Each set is predicted by all others. Where noise is most of what is seen, one set tells it to two fifths.
    """
    field, found, known = _field(data, kind), 0.0, 0.0
    # dark pixels are many, and nobody asks for them
    light = LIT * data.model.max()
    for aside in sets:
        kept = data.without(aside)
        value = field.estimate(kept.residual, kept.precision)[aside]
        stated = sampled_variance(field, kept.precision, 4, np.random.default_rng(seed))[aside]
        precision = data.precision[aside]
        noise = 1.0 / np.maximum(precision, 1e-30)
        weight = np.where((data.model[aside] > light) & (precision > 0), np.square(stated / (noise + stated)), 0.0)
        square = np.square(data.residual[aside] - value) - noise
        found += float((weight * square / np.maximum(stated, 1e-30)).sum(dtype=np.float64))
        known += float(weight.sum(dtype=np.float64))
    return min(9.0, max(0.25, (0.5 * found / len(sets) + 1.0) / (0.5 * known / len(sets) + 1.0)))


def _shares(part: PlaneResiduals, kind: ResidualKind, seed: int) -> F4:
    """Return the share of the variance that is left ``(ny, nx, ratios)``, by position and by variance over noise.

    The ratio is that of `RATIOS`, to the noise that a recorded pattern has or would have.
    """
    field = _field(part, kind)
    own = sampled_variance(field, part.precision, SAMPLES, np.random.default_rng(seed))
    prior = np.maximum(field.variance, 1e-30)
    nearest = _ratio(part, field)
    found = np.full((*part.recorded.shape, len(RATIOS)), np.nan)
    for k in range(len(RATIOS)):
        at = nearest == k
        count = at.sum((2, 3))
        total = np.where(at, own / prior, 0.0).sum((2, 3))
        # few pixels of one position scatter: those of all recorded ones, and of all others, stand beside them
        for flags in (part.recorded, ~part.recorded):
            if count[flags].sum():
                mean = total[flags].sum() / count[flags].sum()
                found[flags, k] = (total[flags] + 5 * mean) / (count[flags] + 5)
    for y, x in np.ndindex(part.recorded.shape):
        known = np.isfinite(found[y, x])
        found[y, x] = np.interp(RATIOS, RATIOS[known], found[y, x][known])
    return np.clip(found, 0.0, 1.0).astype(np.float32)


def _ratio(part: PlaneResiduals, field: ResidualField) -> NDArray[np.intp]:
    """Return which of `RATIOS` each entry's variance over noise is nearest to.

    Of what is not recorded the noise is as it would be at this brightness.
    """
    recorded = part.precision > 0
    light = np.maximum(part.model, 0) + np.float32(1e-3) * part.model.max()
    slope = float(np.median(1.0 / (part.precision[recorded] * light[recorded]))) if recorded.any() else 1.0
    noise = np.where(recorded, 1.0 / np.maximum(part.precision, 1e-30), slope * light)
    ratio = np.log10(np.maximum(field.variance, 1e-30) / noise)
    nearest = np.rint((ratio - RATIOS[0]) / (RATIOS[1] - RATIOS[0]))
    found: NDArray[np.intp] = np.clip(nearest, 0, len(RATIOS) - 1).astype(np.intp)
    return found


def iter_leftover(data: PlaneResiduals, note: str, *, seed: int = 0, workers: int | None = None) -> Work[Leftover]:
    """Estimate what a plane's patterns show beyond the model; yields progress in tiles of the cutout."""
    _, _, nt, ns = data.model.shape
    tiles = [(t, s) for t in range(0, nt, TILE) for s in range(0, ns, TILE)]
    clock = Clock(note, 1 + len(tiles))
    yield clock.at(0)
    data = sized(data)
    value, variance = np.zeros_like(data.model), np.zeros_like(data.model)
    if not data.sizes:
        yield clock.at(1 + len(tiles))
        return Leftover(ResidualKind(), value, variance, np.zeros_like(value))
    part = data.window(*_middle(data))
    kind = chosen_kind(part, spot_velocity(part.model, around=data.around), seed)
    shares = _shares(part, kind, seed)
    yield clock.at(1)
    # left-out positions tell whether too little is stated; whether too much is, of recorded ones, by half at most
    grown = np.float32(kind.spread if kind.spread > 1.0 else math.sqrt(kind.spread))
    parts = [one for one in (kind.spots, kind.stray) if one is not None]
    # beyond it neighbours' patterns tell nothing of a tile
    halo = math.ceil(max(3 * one.pixels + 2.2 * abs(one.velocity) * one.positions for one in parts))

    def solve(start: int, stop: int) -> None:
        for corner in tiles[start:stop]:
            outer = [slice(max(0, a - halo), min(n, a + TILE + halo)) for a, n in zip(corner, (nt, ns), strict=True)]
            inner = [slice(a, min(n, a + TILE)) for a, n in zip(corner, (nt, ns), strict=True)]
            t, s = (slice(i.start - o.start, i.stop - o.start) for i, o in zip(inner, outer, strict=True))
            tile = data.window(outer[0], outer[1])
            field = _field(tile, kind)
            value[:, :, inner[0], inner[1]] = field.estimate(tile.residual, tile.precision)[:, :, t, s]
            share = np.take_along_axis(shares[:, :, None, None, :], _ratio(tile, field)[..., None], -1)[..., 0]
            variance[:, :, inner[0], inner[1]] = (grown * share * field.variance)[:, :, t, s]

    count = worker_count(workers)
    with one_blas_thread():
        for first in range(0, len(tiles), count):
            last = min(len(tiles), first + count)
            for_each_chunk(lambda a, b, at=first: solve(at + a, at + b), last - first, count)  # type: ignore[misc]
            yield clock.at(1 + last)
    prior: F4 = np.float32(max(1.0, kind.spread)) * (np.square(data.sizes[0]) + np.square(data.sizes[1]))
    return Leftover(kind, value, variance, prior)
