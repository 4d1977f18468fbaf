"""Search for filter sets and masks with the best gain at a camera's chi^2 (beyond the paper)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Progress, Work, check_number, drained, raise_if_abandoned
from lfcal.multiplex.colour_filters import CFA_PATTERNS, FILTERS, cfa
from lfcal.multiplex.masks import (
    MASKS,
    MAX_EXHAUSTIVE,
    best_binary_mask,
    mask,
    mask_at_distance,
    mask_gain_bound,
    mask_pattern,
    noise_shares,
)
from lfcal.multiplex.modulator import Modulator, modulator_from_matrix
from lfcal.multiplex.noise import amplification, snr_gain

__all__ = [
    "Frontier",
    "SearchProgress",
    "best_filter_set",
    "best_mask",
    "filter_set_frontier",
    "iter_mask_frontier",
    "mask_frontier",
]

Array = NDArray[np.float64]

FREE_LETTERS = "RGBCMYW"

ROUNDING_DB = 1e-9
"""Difference of gains below which they count as equal."""

CHANGES = 6
"""Number of changed masks per random mask, because better masks are more often near a good one."""


@dataclass(frozen=True, eq=False)
class Frontier:
    """Candidate modulators with their SNR gains for additive noise and for photon noise.

    Attributes
    ----------
    modulators
        Compared modulators, n in number.
    reference
        Name of the modulator to which the gains refer.
    additive, photon, chosen
        SNR gain over the reference (dB), ``(n,)``, at chi^2 = 0, at chi^2 = infinity and at `chi2`.
    chi2
        Ratio chi^2 of photon to additive noise variance, for which `chosen` is computed.
    efficient
        Whether no other candidate is as good in both limits and better in one (Pareto-efficient), ``(n,)``.
    bound
        Upper bound on the gain at `chi2` of any modulator of this kind (dB); None if unknown.

    Examples
    --------
    >>> from lfcal.multiplex import Frontier, filter_set_frontier
    >>> found: Frontier = filter_set_frontier(0.01, letters="RGBW")
    >>> print(f"{found.best.name}: {found.chosen.max():.2f} dB over {found.reference}")
    RGBW: 0.23 dB over Bayer
    >>> print([one.name for one, good in zip(found.modulators, found.efficient) if good])
    ['RR/GB', 'Bayer', 'RG/BB', 'RGBW']
    """

    modulators: tuple[Modulator, ...] = field(repr=False)
    reference: str
    additive: Array = field(repr=False)
    photon: Array = field(repr=False)
    chosen: Array = field(repr=False)
    chi2: float
    efficient: NDArray[np.bool_] = field(repr=False)
    bound: float | None = None

    @property
    def best(self) -> Modulator:
        """Candidate with the largest gain at `chi2`; the first of several equal ones."""
        return self.modulators[self.best_index]

    @property
    def best_index(self) -> int:
        """Index of `best` in `modulators`."""
        return int(np.flatnonzero(self.chosen >= self.chosen.max() - ROUNDING_DB)[0])


def _frontier(modulators: Sequence[Modulator], reference: Modulator, chi2: float) -> Frontier:
    gains = np.array([snr_gain(m, reference, [0.0, math.inf, chi2]) for m in modulators])
    additive, photon, chosen = gains.T.copy()
    # a candidate is efficient if no other is as good in both limits and better in one
    over = np.stack([gain[None] - gain[:, None] for gain in (additive, photon)])
    better = np.all(over >= -ROUNDING_DB, axis=0) & np.any(over > ROUNDING_DB, axis=0)
    return Frontier(tuple(modulators), reference.name, additive, photon, chosen, chi2, ~better.any(1))


def filter_set_frontier(
    chi2: float, *, reference: Modulator | None = None, letters: str = FREE_LETTERS, filters: int = 4
) -> Frontier:
    """Return a `Frontier` of all sets of ``filters`` filters that recover red, green and blue.

    Parameters
    ----------
    chi2
        Ratio chi^2 of photon to additive noise variance of the camera (`camera_chi2`), 0 to inf.
    reference
        Modulator to compare with. None: the Bayer pattern.
    letters
        Letters of the filters to choose from (`FILTERS`).
    filters
        Number of filters in the super-pixel, 3 to 6; without crosstalk, their arrangement does not affect the noise.

    Examples
    --------
    >>> from lfcal.multiplex import filter_set_frontier
    >>> for chi2 in (0.01, 100.0):
    ...     found = filter_set_frontier(chi2, letters="GCMY")
    ...     print(f"chi^2 = {chi2:g}: {found.best.name} is best, {found.chosen.max():.2f} dB over {found.reference}")
    chi^2 = 0.01: CYMG is best, 0.64 dB over Bayer
    chi^2 = 100: CYMG is best, -0.54 dB over Bayer
    """
    check_number("number of filters in the super-pixel", filters, at_least=3, at_most=6, integer=True)
    if not letters or not set(letters) <= set(FILTERS):
        raise InputError.expected(
            "filters", f"letters out of {''.join(FILTERS)}", repr(letters), "use only these letters"
        )
    kinds = sorted(set(letters), key=letters.index)
    layout = _layout(filters)
    known = {"".join(sorted(rows.replace("/", ""))): name for name, rows in CFA_PATTERNS.items()}
    sets = (
        "/".join("".join(row) for row in np.reshape(s, layout))
        for s in itertools.combinations_with_replacement(kinds, filters)
    )
    named = (known.get("".join(sorted(s.replace("/", ""))), s) for s in sets)
    candidates = [m for m in map(cfa, named) if math.isfinite(amplification(m))]
    if not candidates:
        raise InputError.expected("filters", "letters that recover red, green and blue", repr(letters), "add filters")
    return _frontier(candidates, reference or cfa("Bayer"), chi2)


def _layout(filters: int) -> tuple[int, int]:
    return (2, filters // 2) if filters % 2 == 0 else (filters, 1)


def best_filter_set(
    chi2: float, *, filters: int = 4, starts: int = 12, rng: np.random.Generator | None = None
) -> Modulator:
    """Search for the filter transmissions for red, green and blue with the largest SNR gain at ``chi2``.

    Transmissions may have any value from 0 to 1. The search minimises the noise of the recovered colours, including the
    shot noise of each pixel, by a projected quasi-Newton method. It starts from the best set of ideal filters and from
    random sets.

    Parameters
    ----------
    chi2
        Ratio chi^2 of photon to additive noise variance of the camera (`camera_chi2`), 0 to inf.
    filters
        Number of filters, that is, of pixels of the super-pixel, 3 to 6.
    starts
        Number of random starting points.
    rng
        Random number generator for the starting points. None: one with a fixed seed.

    Examples
    --------
    >>> from lfcal.multiplex import best_filter_set
    >>> for chi2 in (0.1, 10.0):  # how many colours each pixel lets through
    ...     print(chi2, sorted(best_filter_set(chi2, starts=2).matrix.sum(axis=1).round(2).tolist()))
    0.1 [1.0, 2.0, 2.0, 2.0]
    10.0 [1.0, 1.0, 1.0, 1.0]
    """
    random = rng or np.random.default_rng(0)
    first = filter_set_frontier(chi2, filters=filters).best.matrix
    # the cost has many minima: the best ideal set is one of the starts, so that the result is never worse
    begin = [first] + [random.random(first.shape) for _ in range(starts)]
    found = min((_descend(_filters_cost, a, chi2) for a in begin), key=lambda pair: pair[0])[1]
    return modulator_from_matrix("best filters", _layout(filters), found, colours=("R", "G", "B"))


def _filters_cost(a: Array, chi2: float) -> tuple[float, Array]:
    """Return the log of the samples' variance and its gradient with respect to the transmissions ``a`` ``(K, N)``.

    The shot noise of each pixel follows from the light on it. With the mean of equation 12, a dark pixel would seem to
    be an advantage, because it lowers the transmission.
    """
    additive, photon = noise_shares(chi2)
    size = a.shape[1]
    gram = np.linalg.inv(a.T @ a + 1e-12 * np.eye(size))
    inverse = gram @ a.T
    variance = additive + photon * a.mean(1)
    weighted = inverse * variance
    total = float((weighted * inverse).sum())
    # derivative of a pseudo-inverse: the part along its range, and the part outside of it
    outside = np.eye(len(a)) - a @ inverse
    gradient = 2 * (outside * variance) @ inverse.T @ gram - 2 * inverse.T @ (inverse @ weighted.T)
    gradient += (photon / size) * (inverse**2).sum(0)[:, None]
    return math.log(total), gradient / total


def _mask_cost(m: Array, chi2: float) -> tuple[float, Array]:
    """Return log(alpha^2 s^2) and its gradient with respect to the pattern ``m`` ``(p, p)`` of a mask."""
    additive, photon = noise_shares(chi2)
    spectrum = np.fft.fft2(m)
    power = np.abs(spectrum) ** 2 + 1e-12
    noise = float((1 / power).sum())
    level = additive + photon * float(m.mean()) + 1e-12
    step = np.fft.fft2(spectrum.conj() / power**2).real
    gradient = -2 * step / noise + photon / (m.size * level)
    return math.log(noise) + math.log(level), gradient


def _descend(cost: Any, start: Array, chi2: float) -> tuple[float, Array]:
    from scipy.optimize import minimize

    def flat(x: Array) -> tuple[float, Array]:
        raise_if_abandoned()
        value, gradient = cost(x.reshape(start.shape), chi2)
        return value, gradient.ravel()

    found = minimize(
        flat, start.ravel(), jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * start.size, options={"maxiter": 300}
    )
    return float(found.fun), np.clip(found.x, 0.0, 1.0).reshape(start.shape)


def best_mask(
    size: int,
    chi2: float,
    *,
    starts: int = 24,
    begin: Sequence[Array] = (),
    rng: np.random.Generator | None = None,
) -> Modulator:
    """Search for the attenuation mask of ``size`` x ``size`` px with the largest SNR gain over a pinhole at ``chi2``.

    The search starts from known masks, and from random masks with various fractions of open pixels. It also starts from
    the best mask so far with a few pixels inverted. For small masks (up to `MAX_EXHAUSTIVE` pixels per side), it also
    starts from the best binary mask. The result is at least as good as every starting point; `mask_gain_bound` returns
    an upper bound on its gain.

    Parameters
    ----------
    size
        Side of the mask (px), as in `mask`.
    chi2
        Ratio chi^2 of photon to additive noise variance of the camera (`camera_chi2`), 0 to inf.
    starts
        Number of random starting points; the number of starts from modified masks is `CHANGES` times as large.
    begin
        Additional patterns to start from, each with shape ``(size, size)`` and transmissions from 0 to 1.
    rng
        Random number generator for the starting points. None: one with a fixed seed.

    Examples
    --------
    >>> from lfcal.multiplex import best_mask, mask, mask_gain_bound, snr_gain
    >>> for one in (mask("MURA", 5), best_mask(5, 0.1, starts=1)):
    ...     print(f"{one.name}: {snr_gain(one, mask('pinhole', 5), 0.1):.1f} dB")
    MURA: 3.7 dB
    best mask at chi^2 = 0.1: 4.0 dB
    >>> print(f"no mask above {mask_gain_bound(5, 0.1):.1f} dB")
    no mask above 4.1 dB
    """
    random = rng or np.random.default_rng(0)
    first = [*begin, *(mask_pattern(kind, size) for kind in _known(size))]
    first += [np.clip(m + 0.05 * random.standard_normal(m.shape), 0, 1) for m in first]
    if size <= MAX_EXHAUSTIVE:
        first.append(best_binary_mask(size, chi2))
    for k in range(starts):
        some = random.random((size, size))
        first.append(some if k % 2 else (some < random.uniform(0.05, 0.6)).astype(float))
    least, found = min((_descend(_mask_cost, m, chi2) for m in first), key=lambda pair: pair[0])
    for _ in range(CHANGES * starts):
        # few enough pixels to stay near the mask, but enough to leave its local minimum
        change = random.random(found.shape) < max(random.uniform(0.04, 0.25), 1 / found.size)
        value, other = _descend(_mask_cost, np.where(change, 1 - found, found), chi2)
        if value < least:
            least, found = value, other
    return mask_at_distance(found, 1.0, name=f"best mask at chi^2 = {chi2:.3g}")


def _known(size: int) -> list[str]:
    fits = []
    for kind in MASKS:
        try:
            mask_pattern(kind, size)
        except InputError:
            continue
        if kind != "lenslet":  # a lenslet is not a mask: it collects light, while a mask only absorbs it
            fits.append(kind)
    return fits


@dataclass(frozen=True, slots=True)
class SearchProgress(Progress):
    """Progress of a search, with the result so far; you may stop the search at any time.

    Attributes
    ----------
    found
        Known masks, and the masks that the search has found so far.
    """

    found: Frontier = field(kw_only=True, compare=False, repr=False)


def iter_mask_frontier(
    size: int, chi2: float, *, points: int = 7, starts: int = 6, rng: np.random.Generator | None = None
) -> Work[Frontier]:
    """Return a `Frontier`, relative to a pinhole, of known masks and of masks found for several values of chi^2.

    Parameters
    ----------
    size
        Side of the masks (px).
    chi2
        Ratio chi^2 of photon to additive noise variance of the camera; one mask is searched for at this value.
    points
        Number of other values of chi^2, including 0 and infinity; a mask is searched for at each of them. At least 2.
    starts, rng
        As in `best_mask`.

    Yields
    ------
    SearchProgress
        Counted in masks.
    """
    random = rng or np.random.default_rng(0)
    ratios = [0.0, *np.logspace(-2, 3, max(0, points - 2)), math.inf, chi2]
    clock = Clock("masks", len(ratios))
    found = [mask(kind, size) for kind in _known(size)]

    def so_far() -> Frontier:
        usable = [m for m in found if math.isfinite(amplification(m))]
        return replace(_frontier(usable, mask("pinhole", size), chi2), bound=mask_gain_bound(size, chi2))

    def at(k: int, note: str = "") -> SearchProgress:
        now = clock.at(k, note)
        return SearchProgress(now.done, now.total, now.stage, now.seconds, note, found=so_far())

    known = len(found)
    for k, ratio in enumerate(ratios):
        yield at(k, f"chi^2 = {ratio:.3g}")
        # a mask that is good for one chi^2 is a good start for the next
        begin = [m.matrix[:, 0].reshape(m.side) for m in found[known:]]
        found.append(best_mask(size, float(ratio), starts=starts, begin=begin, rng=random))
    yield at(len(ratios))
    return so_far()


mask_frontier = drained(
    iter_mask_frontier,
    """
    Examples
    --------
    >>> from lfcal.multiplex import mask_frontier
    >>> found = mask_frontier(3, 0.1, points=2, starts=1)
    >>> print(f"best of {len(found.modulators)}: {found.chosen.max():.2f} dB over a hole, bound {found.bound:.2f} dB")
    best of 6: 1.90 dB over a hole, bound 2.16 dB
    """,
)
