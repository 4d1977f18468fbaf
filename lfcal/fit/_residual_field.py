"""Residuals of patterns beyond a model, as a Gaussian field that is smooth over source positions and pixels.

A residual at one position and pixel is similar to that of its neighbours: the source one step farther, the spot one
pixel further. Light that a lenslet images moves with the velocity of the spots. Stray light may be static, or move in
the opposite direction. Each such part is a field of variance (amplitude A)², whose correlation is Gaussian in the
moving frame,

    k(δ, Δ) = exp(-δ² / 2 h²) exp(-(Δ - a δ)² / 2 w²) on each axis,

with δ in source positions, Δ in pixels, and the velocity a. The best linear estimate of the field from residuals with
noise V is K (K + V)⁻¹ R (kriging, or Gaussian process regression: C. E. Rasmussen, C. K. I. Williams, Gaussian
Processes for Machine Learning, 2006, eq. 2.25). Where A² is far below the noise, it is 0; where A² is far above, it is
the residual itself. It is solved by conjugate gradients. K = W Wᵀ with a smoothing W, so K is positive however W is
truncated. With white noise ξ, A W ξ are samples of the field, from which the posterior variance is estimated (G.
Papandreou, A. Yuille, NeurIPS 2010).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, for_each_chunk, one_blas_thread, worker_count
from lfcal.fit.spread import spread_out

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

__all__ = [
    "Moving",
    "PlaneResiduals",
    "ResidualEstimate",
    "ResidualField",
    "ResidualKind",
    "amplitudes",
    "held_out_folds",
    "iter_residual_estimate",
    "sampled_variance",
    "sized",
    "spot_velocity",
]

F4 = NDArray[np.float32]

CUT = 0.02
"""Weight below which smoothing kernels are cut off."""

TOLERANCE = 1e-2
"""Relative residual at which the equations count as solved."""

MOST_STEPS = 50
"""Largest number of steps of conjugate gradients."""


@dataclass(frozen=True, slots=True)
class Moving:
    """Correlation of one part of the field.

    Attributes
    ----------
    velocity
        Motion in the cutout (pixels) when the source moves by one position.
    positions, pixels
        Correlation lengths h (source positions) and w (pixels).
    """

    velocity: float
    positions: float
    pixels: float


def smoothing(n: int, size: int, by: Moving, *, around: bool) -> csr_matrix:
    """Return W along one axis, over (position, pixel) of ``n`` positions and ``size`` pixels; rows have unit norm.

    With ``around``, the last position is a neighbour of the first, as in a full period.
    """
    from scipy.sparse import csr_matrix, diags_array, eye_array, kron  # slow to import

    apart = np.arange(size)[:, None] - np.arange(size)
    reach = min(n - 1, math.floor(by.positions * math.sqrt(-math.log(CUT))))
    # in a period, no neighbour is counted in both directions
    steps = range(max(-reach, -(n // 2)), min(reach, n - 1 - n // 2) + 1) if around else range(-reach, reach + 1)
    total = csr_matrix((n * size, n * size), dtype=np.float64)
    for step in steps:
        # half the squared width, so that W Wᵀ has the whole width
        weight = np.exp(-((step / by.positions) ** 2) - ((apart - by.velocity * step) / by.pixels) ** 2)
        weight[weight < CUT] = 0.0
        ahead = eye_array(n, k=-step, format="csr")
        if around and step:
            ahead = ahead + eye_array(n, k=n - step if step > 0 else -n - step, format="csr")
        total = total + kron(ahead, csr_matrix(weight), format="csr")
    total.eliminate_zeros()
    length = np.sqrt(np.asarray(total.multiply(total).sum(1)).ravel())
    return csr_matrix((diags_array(1.0 / length) @ total).astype(np.float32))


class ResidualField:
    """The sum of several parts over positions and pixels ``(ny, nx, nt, ns)``.

    Parameters
    ----------
    parts
        Correlation of each part.
    amplitudes
        Standard deviation of each part at every entry.
    around
        Whether the positions are a full period.
    """

    def __init__(self, parts: Sequence[Moving], amplitudes: Sequence[F4], *, around: bool) -> None:
        ny, nx, nt, ns = self.shape = amplitudes[0].shape
        self.amplitudes = tuple(amplitudes)
        self._smoothing = [
            (smoothing(ny, nt, part, around=around), smoothing(nx, ns, part, around=around)) for part in parts
        ]

    @property
    def variance(self) -> F4:
        """Variance of every entry before any measurement."""
        found: F4 = np.sum([np.square(a) for a in self.amplitudes], axis=0, dtype=np.float32)
        return found

    def covariance(self, values: F4) -> F4:
        """Return the product of the covariance K and ``values``."""
        ny, nx, nt, ns = self.shape
        out = np.zeros_like(values)
        for (rows, columns), amplitude in zip(self._smoothing, self.amplitudes, strict=True):
            flat = (amplitude * values).transpose(0, 2, 1, 3).reshape(ny * nt, nx * ns)
            flat = (columns.T @ (rows.T @ flat).T).T
            flat = (columns @ (rows @ flat).T).T
            out += amplitude * flat.reshape(ny, nt, nx, ns).transpose(0, 2, 1, 3)
        return out

    def sample(self, rng: np.random.Generator) -> F4:
        """Return a random sample of the field."""
        ny, nx, nt, ns = self.shape
        out = np.zeros(self.shape, np.float32)
        for (rows, columns), amplitude in zip(self._smoothing, self.amplitudes, strict=True):
            flat = rng.standard_normal((ny * nt, nx * ns), np.float32)
            flat = (columns @ (rows @ flat).T).T
            out += amplitude * flat.reshape(ny, nt, nx, ns).transpose(0, 2, 1, 3)
        return out

    def estimate(self, residual: F4, precision: F4) -> F4:
        """Return the best estimate of the field from residuals of variance 1 / ``precision``; 0: not measured."""
        root = np.sqrt(precision)
        preconditioner = 1.0 + precision * self.variance
        wanted = root * residual
        found, left = np.zeros_like(wanted), wanted.copy()
        nearer = left / preconditioner
        way = nearer.copy()
        size = float(np.vdot(left, nearer))
        goal = TOLERANCE**2 * size
        for _ in range(MOST_STEPS):
            if size <= goal or size == 0.0:
                break
            turned = way + root * self.covariance(root * way)
            step = np.float32(size / float(np.vdot(way, turned)))
            found += step * way
            left -= step * turned
            nearer = left / preconditioner
            before, size = size, float(np.vdot(left, nearer))
            way = nearer + np.float32(size / before) * way
        return self.covariance(root * found)


def sampled_variance(field: ResidualField, precision: F4, count: int, rng: np.random.Generator) -> F4:
    """Return the variance of the field about its estimate, as a mean over ``count`` samples."""
    total = np.zeros(field.shape, np.float32)
    noise = np.where(precision > 0, 1.0 / np.sqrt(np.maximum(precision, 1e-30)), 0.0).astype(np.float32)
    for _ in range(count):
        true = field.sample(rng)
        data = true + noise * rng.standard_normal(field.shape, np.float32)
        total += np.square(true - field.estimate(data, precision))
    return total / np.float32(count)


# -- amplitude of the field
# --------------------------------------------------------------------------------------------
F8 = NDArray[np.float64]
Flags = NDArray[np.bool_]

SIGNIFICANCE = 5.0
"""Significance, in standard deviations, above which a variance in excess of the noise is accepted."""

KNOTS = np.log(np.array([0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0]))
"""Logarithms of brightness, relative to the plane's brightest pixel, at which the size of residuals is estimated."""


@dataclass(frozen=True, eq=False)
class PlaneResiduals:
    """The model of a plane, and its measurements.

    Attributes
    ----------
    model
        Predicted light ``(ny, nx, nt, ns)``.
    residual
        Measured minus predicted light; 0 without a measurement.
    precision
        Inverse variance of the noise; 0 without a measurement.
    recorded
        Positions ``(ny, nx)`` to use.
    around
        Whether the positions are a full period, so that the last is a neighbour of the first.
    sizes
        Standard deviations of the residuals of spots and of stray light, beyond noise; empty if not yet known.
    """

    model: F4
    residual: F4
    precision: F4
    recorded: Flags
    around: bool
    sizes: tuple[F4, ...] = ()

    @property
    def period(self) -> tuple[int, int]:
        """Number of positions ``(ny, nx)``."""
        return self.model.shape[0], self.model.shape[1]

    def window(self, rows: slice, columns: slice) -> PlaneResiduals:
        """Return the plane within a window of the cutout."""
        model, residual, precision, *sizes = (
            np.ascontiguousarray(one[:, :, rows, columns])
            for one in (self.model, self.residual, self.precision, *self.sizes)
        )
        return PlaneResiduals(model, residual, precision, self.recorded, self.around, tuple(sizes))

    def without(self, aside: Flags) -> PlaneResiduals:
        """Return the plane with the positions ``aside`` treated as not measured."""
        keep = ~aside
        return replace(self, precision=self.precision * keep[:, :, None, None], recorded=self.recorded & keep)


def amplitudes(model: F4) -> tuple[F4, F4]:
    """Return the relative amplitudes of the residuals of spots and of stray light, in proportion to the light nearby.

    For spots, this is the geometric mean of the light of a pixel and of its surroundings. Dim pixels next to bright
    ones have larger errors than their own light suggests. For stray light, it is the mean of all positions, because it
    comes from any lenslet.
    """
    from scipy.ndimage import gaussian_filter  # slow to import

    near, far = (gaussian_filter(np.square(model), (0, 0, width, width)).clip(min=0) for width in (0.6, 4.0))
    mean = gaussian_filter(model.mean((0, 1)), 3).clip(min=0)
    return ((near * far) ** 0.25).astype(np.float32), np.broadcast_to(mean.astype(np.float32), model.shape)


def sized(data: PlaneResiduals) -> PlaneResiduals:
    """Return the plane with the standard deviations of errors in spots and stray light, unchanged if noise dominates.

    Residuals have E[R² - V] = s² A² + c² B² with the amplitudes A and B, and s depending on brightness. Weights are
    between those of chi², with which only dark pixels would count, and those of the squared light.
    """
    own = data.recorded
    near, mean = amplitudes(data.model)
    good = data.precision[own] > 0
    noise = (1.0 / data.precision[own][good]).astype(np.float64)
    square = np.square(data.residual[own][good], dtype=np.float64) - noise
    x = np.stack([np.square(one[own][good], dtype=np.float64) for one in (near, mean)])
    found = np.zeros(2)
    for _ in range(6):
        weight = 1.0 / (noise + found @ x)
        found = _not_negative((x * weight) @ x.T, (x * weight) @ square)
    sure = [_deviation(x[k], noise) * SIGNIFICANCE < found[k] for k in (0, 1)]
    if not any(sure):
        return data
    found = np.where(sure, found, 0.0)
    brightness = np.log(np.maximum(data.model / max(float(data.model.max()), 1e-30), 1e-6))
    grown = _by_brightness(found @ x, square, noise, brightness[own][good])
    grown = np.interp(brightness, KNOTS, grown)
    # bright pixels, to which chi² is insensitive, may have larger errors: then all are scaled
    stated = (found @ x) * grown[own][good]
    whole, error = (float(v) / float(stated.sum()) for v in (square.sum(), math.sqrt(2.0 * float((noise**2).sum()))))
    if whole > 1.0 + 2.0 * error:
        grown *= min(4.0, whole)
    grown = np.sqrt(grown).astype(np.float32)
    spots, stray = (np.float32(math.sqrt(size)) * one * grown for size, one in zip(found, (near, mean), strict=True))
    return replace(data, sizes=(spots, stray))


def _not_negative(matrix: F8, gradient: F8) -> F8:
    """Return the solution of the normal equations of two unknowns under the constraint that neither is negative."""
    out = np.zeros(2)
    used = [k for k in (0, 1) if matrix[k, k] > 0]
    while used:
        part = np.linalg.lstsq(matrix[np.ix_(used, used)], gradient[used], rcond=1e-10)[0]
        if (part > 0).all():
            out[used] = part
            break
        used.remove(used[int(np.argmin(part))])
    return out


def _deviation(x: F8, noise: F8) -> float:
    """Return the standard deviation of the factor of ``x`` fitted to squares of pure noise, of variance 2 V² each."""
    total = float((x * x / noise).sum())
    return math.sqrt(2.0 * float((x * x).sum())) / total if total > 0 else math.inf


def _by_brightness(stated: F8, square: F8, noise: F8, brightness: F8) -> F8:
    """Return the ratio of residual scatter beyond noise to its stated value (squares), at each of `KNOTS`.

    With few pixels, it stays near 1.
    """
    nearest = np.abs(brightness[:, None] - KNOTS).argmin(1)
    out = np.ones(len(KNOTS))
    for k in range(len(KNOTS)):
        part, other, size = (one[nearest == k] for one in (stated, noise, square))
        weights = np.square(part / (other + part))
        if weights.sum() > 0:
            weight = 0.5 * float(weights.sum())
            value = float((weights * size / np.maximum(part, 1e-30)).sum()) / float(weights.sum())
            out[k] = min(25.0, max(0.04, (value * weight + 1.0) / (weight + 1.0)))
    return out


# -- the estimate of a plane -------------------------------------------------------------------------------------------

SIGNIFICANT_GAIN = 2.0
"""Standard deviations by which neighbours must improve the prediction before missing positions are interpolated."""

FOLDS = 5
"""Number of sets into which recorded positions are divided for holding them out."""

FEWEST_HELD_OUT = 8
"""Number of recorded positions of a plane below which none is held out."""

LENGTHS = ((1.0, 0.5), (1.5, 0.5), (2.0, 0.6), (2.5, 0.7), (3.5, 0.8), (5.0, 1.0))
"""Correlation lengths that are tried: source positions, pixels."""

USUAL = LENGTHS[1]

STRAY = (2.5, 0.7)
"""Correlation lengths of stray light."""

SAMPLES = 8
"""Number of random fields for the posterior variance."""

ENTRIES_TRIED = 150_000
"""Number of entries in the middle of a plane with which lengths, velocities and variances are estimated."""

NEAR = Moving(0.0, 1.0, 0.5)
"""Correlation of the part of the spots' residuals that hardly extends from one position to the next."""

NEAR_SHARES = (0.3, 0.6)
"""Fractions of the spots' variance tried for `NEAR`; with one length, the field would be too smooth or too rough."""

LIT = 0.02
"""Fraction of the plane's brightest pixel above which a pixel is lit."""

RATIOS = np.linspace(-3.0, 3.0, 13)
"""Decadic logarithms of variance over noise at which the posterior's share of the variance is computed."""

TILE = 32
"""Side of the tiles of the cutout that are solved one after the other (pixels)."""


@dataclass(frozen=True, slots=True)
class ResidualKind:
    """Properties of the residuals of a plane.

    Attributes
    ----------
    spots, stray
        Correlation of the residuals of spots and stray light. None: only noise.
    near
        Fraction of the variance of the spots that is hardly correlated between neighbouring positions.
    supported
        Whether held-out positions are predicted better from their neighbours than by the model alone.
    spread
        Ratio of the scatter of held-out positions to the stated one (squares).
    """

    spots: Moving | None = None
    stray: Moving | None = None
    near: float = NEAR_SHARES[0]
    supported: bool = False
    spread: float = 1.0

    @property
    def empty(self) -> bool:
        """Whether there is only noise."""
        return self.spots is None and self.stray is None


@dataclass(frozen=True, eq=False)
class ResidualEstimate:
    """Estimate of the residual field of a model.

    Attributes
    ----------
    kind
        Properties of the residual.
    value, variance
        The estimate ``(ny, nx, nt, ns)`` and its variance.
    prior
        Variance of the residual without a measurement.
    """

    kind: ResidualKind
    value: F4
    variance: F4
    prior: F4


def spot_velocity(model: F4, *, around: bool = True) -> float:
    """Return the motion of spots in the cutout (pixels) when the source moves by one position.

    It is determined from the correlation of patterns up to four positions apart, after subtraction of their mean.
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
    """Return the correlation of patterns with those ``step`` positions farther, moved by ``shift`` pixels."""
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
        # one part with all the variance
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
    """Return the kind of residual with which held-out patterns of a plane are best predicted from the others."""
    spots, stray = (bool(size.any()) for size in part.sizes)
    usual = ResidualKind(Moving(velocity, *USUAL) if spots else None, Moving(-velocity, *STRAY) if stray else None)
    places = np.argwhere(part.recorded)
    if len(places) < FEWEST_HELD_OUT:
        return usual
    sets = held_out_folds(part)
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
    helped = float(gains.sum()) > SIGNIFICANT_GAIN * math.sqrt(float(np.square(gains).sum()))
    # a part that is not correlated with neighbours appears in the residuals of their prediction
    shares = NEAR_SHARES if best.spots is not None else NEAR_SHARES[:1]
    kinds = [replace(best, near=share, supported=helped) for share in shares]
    found = [replace(one, spread=_spread(part, sets, one, seed)) for one in kinds]
    return min(found, key=lambda one: abs(math.log(one.spread)))


def held_out_folds(part: PlaneResiduals) -> list[Flags]:
    """Return disjoint masks ``(ny, nx)`` of recorded positions, each spread over the plane."""
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
    """Return the rows and columns in the middle of the cutout that contain `ENTRIES_TRIED` entries."""
    ny, nx, nt, ns = data.model.shape
    side = max(5, math.isqrt(ENTRIES_TRIED // (ny * nx)))
    rows, columns = (slice(max(0, (n - side) // 2), max(0, (n - side) // 2) + min(n, side)) for n in (nt, ns))
    return rows, columns


def _best(data: PlaneResiduals, aside: Flags, kinds: Sequence[ResidualKind]) -> tuple[ResidualKind, F8]:
    """Return the kind that predicts the patterns ``aside`` best, and its improvement at each of them."""
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
    """Return the ratio of the scatter of held-out patterns about their prediction, beyond noise, to the stated one.

    Values are squares. Each set is predicted by all others. If noise dominates, one set determines the ratio to 40 %.
    """
    field, found, known = _field(data, kind), 0.0, 0.0
    # dark pixels are numerous and irrelevant
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
    """Return the fraction of the variance that is left ``(ny, nx, ratios)``, by position and by variance over noise.

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
        # few pixels of one position scatter strongly: combine them with those of all recorded positions, and of all
        # others
        for flags in (part.recorded, ~part.recorded):
            if count[flags].sum():
                mean = total[flags].sum() / count[flags].sum()
                found[flags, k] = (total[flags] + 5 * mean) / (count[flags] + 5)
    for y, x in np.ndindex(part.recorded.shape):
        known = np.isfinite(found[y, x])
        found[y, x] = np.interp(RATIOS, RATIOS[known], found[y, x][known])
    return np.clip(found, 0.0, 1.0).astype(np.float32)


def _ratio(part: PlaneResiduals, field: ResidualField) -> NDArray[np.intp]:
    """Return the index of the value in `RATIOS` that is nearest to the variance over noise of each entry.

    For entries that were not recorded, the noise is that expected at this brightness.
    """
    recorded = part.precision > 0
    light = np.maximum(part.model, 0) + np.float32(1e-3) * part.model.max()
    slope = float(np.median(1.0 / (part.precision[recorded] * light[recorded]))) if recorded.any() else 1.0
    noise = np.where(recorded, 1.0 / np.maximum(part.precision, 1e-30), slope * light)
    ratio = np.log10(np.maximum(field.variance, 1e-30) / noise)
    nearest = np.rint((ratio - RATIOS[0]) / (RATIOS[1] - RATIOS[0]))
    found: NDArray[np.intp] = np.clip(nearest, 0, len(RATIOS) - 1).astype(np.intp)
    return found


def iter_residual_estimate(
    data: PlaneResiduals, note: str, *, seed: int = 0, workers: int | None = None
) -> Work[ResidualEstimate]:
    """Estimate how the patterns of a plane deviate from the model; yields progress in tiles of the cutout."""
    _, _, nt, ns = data.model.shape
    tiles = [(t, s) for t in range(0, nt, TILE) for s in range(0, ns, TILE)]
    clock = Clock(note, 1 + len(tiles))
    yield clock.at(0)
    data = sized(data)
    value, variance = np.zeros_like(data.model), np.zeros_like(data.model)
    if not data.sizes:
        yield clock.at(1 + len(tiles))
        return ResidualEstimate(ResidualKind(), value, variance, np.zeros_like(value))
    part = data.window(*_middle(data))
    kind = chosen_kind(part, spot_velocity(part.model, around=data.around), seed)
    shares = _shares(part, kind, seed)
    yield clock.at(1)
    # held-out positions show whether the stated variance is too small; recorded ones show whether it is too large,
    # by at most a factor of two
    grown = np.float32(kind.spread if kind.spread > 1.0 else math.sqrt(kind.spread))
    parts = [one for one in (kind.spots, kind.stray) if one is not None]
    # beyond this distance, neighbouring patterns contain no information about a tile
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
    return ResidualEstimate(kind, value, variance, prior)
