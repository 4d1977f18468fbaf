"""Search for manufacturable filter layouts and printed masks with the best gain, and bound the gain of better ones."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, check_number, check_tuple, raise_if_abandoned
from lfcal.multiplex.colour_filters import CFA_PATTERNS, FILTERS, cfa
from lfcal.multiplex.masks import mask, mask_at_distance, mask_gain_bound, noise_shares
from lfcal.multiplex.modulator import Modulator
from lfcal.multiplex.noise import snr_gain
from lfcal.multiplex.search import best_mask

__all__ = ["Design", "best_array", "best_printed_mask", "with_crosstalk"]

Array = NDArray[np.float64]

MOST_TRIED = 200_000
"""Largest number of candidates of `best_array`; all of them are tried."""

BATCH = 4096


@dataclass(frozen=True, eq=False)
class Design:
    """Best modulator found by a search, and an upper bound on the gain of any candidate.

    Attributes
    ----------
    modulator
        Best modulator found, stored without crosstalk.
    gain_db
        SNR gain over the reference, with the crosstalk of the search (dB; 10 log10, as in `snr_gain`).
    bound_db
        Upper bound on the gain of any candidate (dB); equal to ``gain_db`` if all were tried.
    tried
        Number of candidates examined, including those that violate a limit of the search.
    exhaustive
        Whether all candidates were tried.

    Examples
    --------
    >>> from lfcal.multiplex import Design, best_array
    >>> found: Design = best_array((2, 2), 1.0, letters="RGB")
    >>> print(found.modulator.name, found.tried, found.exhaustive)
    Bayer 15 True
    >>> print(found.certificate)
    the best of all 15 candidates
    """

    modulator: Modulator = field(repr=False)
    gain_db: float
    bound_db: float
    tried: int
    exhaustive: bool

    @property
    def certificate(self) -> str:
        """Text that states that all candidates were tried, or how far the gain may be below the best possible one."""
        if self.exhaustive:
            return f"the best of all {self.tried} candidates"
        return f"at most {max(0.0, self.bound_db - self.gain_db):.3f} dB below the best possible one"


def with_crosstalk(modulator: Modulator, share: float) -> Modulator:
    """Return a copy of ``modulator`` with crosstalk, by which each pixel loses light to its four neighbours.

    Parameters
    ----------
    modulator
        Modulator; pixels at the border of its super-pixel exchange light with the next super-pixel. With lenslets,
        light from a neighbouring cell is treated as light of the same cell.
    share
        Fraction of a pixel's light or charge that it loses, 0 to 0.5. A quarter of it reaches each of the four
        neighbours.

    Examples
    --------
    >>> from lfcal.multiplex import cfa, with_crosstalk
    >>> print(with_crosstalk(cfa("Bayer"), 0.2).matrix.round(3))
    [[0.8 0.2 0. ]
     [0.1 0.8 0.1]
     [0.1 0.8 0.1]
     [0.  0.2 0.8]]
    """
    check_number("crosstalk", share, at_least=0, at_most=0.5)
    block = np.asarray(modulator.spatial).reshape(*modulator.side, -1)
    near = sum(np.roll(block, step, axis) for axis in (0, 1) for step in (1, -1))
    mixed = (1 - share) * block + share / 4 * near
    return replace(modulator, spatial=mixed.reshape(modulator.pixels, -1))


def best_array(
    side: tuple[int, int],
    chi2: float,
    *,
    letters: str = "RGBCMYW",
    crosstalk: float = 0.0,
    most_kinds: int | None = None,
    least_light: float = 0.0,
    reference: Modulator | None = None,
) -> Design:
    """Search all layouts of the given filters for the largest SNR gain over ``reference``; return a `Design`.

    Parameters
    ----------
    side
        Rows and columns of the super-pixel (px).
    chi2
        Ratio chi^2 of photon to additive noise variance of the camera (`camera_chi2`), 0 to inf.
    letters
        Letters of the filters to choose from: red, green, blue, cyan, magenta, yellow and white by default (`FILTERS`).
    crosstalk
        Fraction of its light that each pixel loses to its neighbours (`with_crosstalk`); if it is not 0, the
        arrangement of the filters matters.
    most_kinds
        Largest number of different filters, each of which requires a lithographic step. None: no limit.
    least_light
        Smallest mean transmission of the layout, 0 to 1.
    reference
        Modulator to compare with, without crosstalk; the same crosstalk is applied to it. None: the Bayer pattern.

    Raises
    ------
    InputError
        If there are too many candidates to try, or none within the limits recovers red, green and blue.

    Examples
    --------
    >>> from lfcal.multiplex import best_array
    >>> for chi2 in (0, float("inf")):
    ...     found = best_array((2, 2), chi2)
    ...     print(found.modulator.name, f"{found.gain_db:.2f} dB:", found.certificate)
    CYMG 0.65 dB: the best of all 210 candidates
    Bayer 0.00 dB: the best of all 210 candidates
    """
    rows, columns = check_tuple("super-pixel (rows, columns)", side, 2, at_least=1, at_most=8, integer=True)
    check_number("smallest fraction of light", least_light, at_least=0, at_most=1)
    check_number("crosstalk", crosstalk, at_least=0, at_most=0.5)
    if most_kinds is not None:
        check_number("number of different filters", most_kinds, at_least=1, integer=True)
    kinds = sorted(set(letters), key=letters.index)
    if not kinds or not set(kinds) <= set(FILTERS):
        raise InputError.expected(
            "filters", f"letters out of {''.join(FILTERS)}", repr(letters), "use only these letters"
        )
    count = rows * columns
    number = len(kinds) ** count if crosstalk else math.comb(len(kinds) + count - 1, count)
    if number > MOST_TRIED:
        remedy = "choose fewer filters or a smaller super-pixel"
        raise InputError.expected("number of candidates", f"at most {MOST_TRIED:,}", f"{number:,}", remedy)
    table = np.array([FILTERS[kind] for kind in kinds], float)
    best, least, tried = None, math.inf, 0
    for batch in _batches(len(kinds), count, places=bool(crosstalk)):
        good = _makeable(batch, table, most_kinds, least_light)
        tried += len(batch)
        noise = _noise(batch[good], table, (rows, columns), chi2, crosstalk)
        if len(noise) and noise.min() < least:
            least, best = float(noise.min()), batch[good][int(np.argmin(noise))]
    if best is None or not math.isfinite(least):
        raise InputError.expected(
            "allowed filters", "filters that recover red, green and blue", repr(letters), "allow more filters"
        )
    best = _known_equal(
        best, least, kinds, (rows, columns), lambda b: _noise(b, table, (rows, columns), chi2, crosstalk)
    )
    found = cfa("/".join("".join(kinds[k] for k in row) for row in best.reshape(rows, columns)))
    base = with_crosstalk(reference or cfa("Bayer"), crosstalk)
    gain = float(snr_gain(with_crosstalk(found, crosstalk), base, chi2))
    return Design(found, gain, gain, tried, True)


def _known_equal(
    best: NDArray[np.intp],
    least: float,
    kinds: list[str],
    side: tuple[int, int],
    noise: Callable[[NDArray[np.intp]], Array],
) -> NDArray[np.intp]:
    """Return a known pattern with no more different filters and no more noise than ``best``; otherwise ``best``."""
    for rows in CFA_PATTERNS.values():
        letters = [letter for row in rows.split("/") for letter in row]
        shape = (rows.count("/") + 1, len(rows.split("/")[0]))
        if shape == side and set(letters) <= set(kinds):
            other = np.array([kinds.index(letter) for letter in letters], np.intp)
            same = len(set(other.tolist())) <= len(set(best.tolist()))
            if same and float(noise(other[None])[0]) <= least * (1 + 1e-12):
                return other
    return best


def _batches(kinds: int, count: int, *, places: bool) -> Iterator[NDArray[np.intp]]:
    """Yield all choices of filters ``(n, count)``; without ``places``, one choice for each set of filters."""
    every = (
        itertools.product(range(kinds), repeat=count)
        if places
        else itertools.combinations_with_replacement(range(kinds), count)
    )
    while part := list(itertools.islice(every, BATCH)):
        yield np.array(part, np.intp)


def _makeable(batch: NDArray[np.intp], table: Array, most_kinds: int | None, least_light: float) -> NDArray[np.bool_]:
    light = table.mean(1)[batch].mean(1)
    ordered = np.sort(batch, axis=1)
    kinds = 1 + (np.diff(ordered, axis=1) != 0).sum(1)
    most = batch.shape[1] if most_kinds is None else most_kinds
    return np.asarray((light >= least_light - 1e-12) & (kinds <= most))


def _noise(batch: NDArray[np.intp], table: Array, side: tuple[int, int], chi2: float, crosstalk: float) -> Array:
    """Return the variance of the samples of each choice (equation 12); infinite if a colour is not recovered."""
    additive, photon = noise_shares(chi2)
    block = table[batch].reshape(len(batch), *side, 3)
    near = sum(np.roll(block, step, axis) for axis in (1, 2) for step in (1, -1))
    a = ((1 - crosstalk) * block + crosstalk / 4 * near).reshape(len(batch), -1, 3)
    gram = np.einsum("bki,bkj->bij", a, a)
    whole = np.linalg.matrix_rank(gram, hermitian=True) == 3
    trace = np.full(len(batch), math.inf)
    trace[whole] = np.trace(np.linalg.inv(gram[whole]), axis1=1, axis2=2)
    return np.asarray(trace * (additive + photon * a.mean((1, 2))))


def best_printed_mask(
    size: int,
    chi2: float,
    *,
    levels: int = 2,
    crosstalk: float = 0.0,
    most_light: float = 1.0,
    least_light: float = 0.0,
    starts: int = 12,
    rng: np.random.Generator | None = None,
) -> Design:
    """Search for the printable mask with the largest SNR gain over a pinhole with equal crosstalk; return a `Design`.

    If there are at most 20 000 candidates, all of them are tried. Otherwise, the best grey mask (`best_mask`), known
    masks and random masks are rounded to the printable levels. They are then changed pixel by pixel as long as this
    increases the gain. The bound is then that for arbitrary masks (`mask_gain_bound`) plus the loss of the pinhole due
    to crosstalk.

    Parameters
    ----------
    size
        Side of the mask (px).
    chi2
        Ratio chi^2 of photon to additive noise variance of the camera (`camera_chi2`), 0 to inf.
    levels
        Number of printable transmissions, equally spaced from 0 to 1; 2 for chrome on glass.
    crosstalk
        Fraction of its light that each pixel loses to its neighbours.
    least_light, most_light
        Smallest and largest mean transmission of the mask, 0 to 1.
    starts
        Number of random starting points.
    rng
        Random number generator for the starting points. None: one with a fixed seed.

    Examples
    --------
    >>> from lfcal.multiplex import best_printed_mask
    >>> found = best_printed_mask(3, 0.1)
    >>> print(f"{found.modulator.matrix[:, 0].sum():.0f} of 9 cells open: {found.gain_db:.2f} dB over a pinhole")
    4 of 9 cells open: 1.18 dB over a pinhole
    >>> print(found.certificate)
    the best of all 512 candidates
    """
    check_number("size of the mask (px)", size, at_least=2, at_most=31, integer=True)
    check_number("levels", levels, at_least=2, at_most=256, integer=True)
    check_number("crosstalk", crosstalk, at_least=0, at_most=0.4)
    if not 0 <= least_light < most_light <= 1:
        got = f"from {least_light} to {most_light}"
        raise InputError.expected(
            "transmitted fraction of light",
            "limits with 0 ≤ least < most ≤ 1",
            got,
            "give fractions, with the smaller limit first",
        )
    random = rng or np.random.default_rng(0)
    limits = (least_light, most_light)
    gains = _MaskGain(size, chi2, crosstalk, limits)
    count = levels ** (size * size)
    if count <= 20_000:
        found, tried = _every_mask(size, levels, gains), count
    else:
        found, tried = _changed_masks(size, chi2, levels, gains, starts, random)
    modulator = mask_at_distance(found / (levels - 1), 1.0, name=f"printed {size} x {size}, {levels} levels")
    gain = gains.of(found[None] / (levels - 1))[0]
    if not math.isfinite(gain):
        raise InputError.expected(
            "mask", "one within the limits of light that recovers all views", "none", "allow less or more light"
        )
    exhaustive = count <= 20_000
    # crosstalk reduces all Fourier weights except the zeroth, and those of the reference too
    bound = float(gain) if exhaustive else mask_gain_bound(size, chi2) + gains.reference_loss
    return Design(modulator, float(gain), bound, tried, exhaustive)


class _MaskGain:
    """Gain over the pinhole (dB) of masks with crosstalk; minus infinity outside the limits of light."""

    def __init__(self, size: int, chi2: float, crosstalk: float, limits: tuple[float, float]) -> None:
        wave = np.cos(2 * np.pi * np.arange(size) / size)
        self.mix = 1 - crosstalk + crosstalk / 2 * (wave[:, None] + wave)
        self.additive, self.photon = noise_shares(chi2)
        self.limits, self.size = limits, size
        hole = np.zeros((1, size, size))
        hole[0, 0, 0] = 1
        self.hole = float(self._log(hole)[0])
        # the loss of the reference by crosstalk increases every gain over it
        self.reference_loss = 5 * math.log10(float((1 / self.mix**2).mean()))

    def of(self, masks: Array) -> Array:
        light = masks.mean((1, 2))
        good = (light >= self.limits[0] - 1e-12) & (light <= self.limits[1] + 1e-12)
        return np.where(good, self.hole - self._log(masks), -math.inf)

    def _log(self, masks: Array) -> Array:
        power = np.abs(np.fft.fft2(masks) * self.mix) ** 2
        lost = (power < 1e-9).any((1, 2))
        total = (1 / np.where(power < 1e-9, 1.0, power)).sum((1, 2))
        return np.where(
            lost, math.inf, 5 * np.log10(total * (self.additive + self.photon * masks.mean((1, 2)) + 1e-300))
        )


def _every_mask(size: int, levels: int, gains: _MaskGain) -> Array:
    every = itertools.product(range(levels), repeat=size * size)
    best, most = np.ones((size, size)) * (levels - 1), -math.inf
    while part := list(itertools.islice(every, BATCH)):
        masks = np.array(part, float).reshape(-1, size, size)
        found = gains.of(masks / (levels - 1))
        k = int(np.argmax(found))
        if found[k] > most:
            best, most = masks[k], float(found[k])
    return best


def _changed_masks(
    size: int, chi2: float, levels: int, gains: _MaskGain, starts: int, rng: np.random.Generator
) -> tuple[Array, int]:
    grey = best_mask(size, chi2, starts=2, rng=rng).matrix[:, 0].reshape(size, size)
    begin = [grey, *_open_masks(size)]
    begin += [(rng.random((size, size)) < rng.uniform(*gains.limits)).astype(float) for _ in range(starts)]
    best, most, tried = np.zeros((size, size)), -math.inf, 0
    for start in begin:
        found, value, looked = _climbed(np.rint(start * (levels - 1)), levels, gains)
        tried += looked
        if value > most:
            best, most = found, value
    return best, tried


def _open_masks(size: int) -> list[Array]:
    found = []
    for kind in ("pinhole", "MURA"):
        try:
            found.append(mask(kind, size).matrix[:, 0].reshape(size, size))
        except InputError:
            continue
    return found


def _climbed(start: Array, levels: int, gains: _MaskGain) -> tuple[Array, float, int]:
    """Repeatedly change the pixel that increases the gain most, until no change increases it.

    Return the mask, its gain (dB), and the number of masks that were tried.
    """
    now, tried = start, 0
    value = float(gains.of(now[None] / (levels - 1))[0])
    while True:
        raise_if_abandoned()
        steps = [
            (k, level) for k in range(now.size) for level in {max(now.flat[k] - 1, 0), min(now.flat[k] + 1, levels - 1)}
        ]
        steps = [(k, level) for k, level in steps if level != now.flat[k]]
        masks = np.repeat(now[None], len(steps), 0)
        for mask_, (k, level) in zip(masks, steps, strict=True):
            mask_.flat[k] = level
        found = gains.of(masks / (levels - 1))
        tried += len(masks)
        k = int(np.argmax(found))
        if not found[k] > value + 1e-12:
            return now, value, tried
        now, value = masks[k], float(found[k])
