"""Compute a response on a grid in passes that stay in the caches: product, transforms, transfer function, pixels."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.simulate.engines._fused_llvm import (
    LANES,
    RADICES,
    STEP,
    Pixels,
    ResponseGrid,
    Stages,
    Way,
    Work,
    respond,
)

__all__ = ["FusedResponse", "aligned", "frequency_order", "way_of"]

Reals = NDArray[np.float32]


@lru_cache(maxsize=64)
def way_of(n: int) -> Way:
    """Return the stages of a transform of ``n`` numbers: as few as possible, and of similar sizes.

    Raises
    ------
    ValueError
        If ``n`` has a prime factor above 11, or no two factors.
    """
    radices = _fewest(n, RADICES[-1])
    if radices is None or len(radices) < 2:
        raise ValueError(f"length of a transform: expected a product of two or more primes up to 11, got {n}")
    small_first = radices[::-1]
    return Way(_stages(n, small_first[:1]), _stages(n // small_first[0], small_first[1:]))


def _stages(n: int, radices: tuple[int, ...]) -> Stages:
    starts, factors, block = [], [np.zeros(0)], n
    for radix in radices:
        starts.append(sum(f.size for f in factors))
        apart = block // radix
        if apart > 1:
            turns = np.outer(np.arange(apart), np.arange(1, radix)).ravel()
            w = np.exp(-2j * np.pi * turns / block)
            factors.append(np.stack([w.real, w.imag], axis=1).ravel())
        block = apart
    found = np.concatenate(factors)
    twiddles = aligned(found.size)
    twiddles[:] = found
    return Stages(np.array(radices), np.array(starts), twiddles)


def _fewest(n: int, most: int) -> tuple[int, ...] | None:
    """Return the fewest factors of ``n`` from `RADICES`, in decreasing order from at most ``most``; None: impossible.

    Of several sets, the one with the smallest sum is returned.
    """
    if n == 1:
        return ()
    found = []
    for radix in (r for r in RADICES if r <= most and n % r == 0):
        rest = _fewest(n // radix, radix)
        if rest is not None:
            found.append((radix, *rest))
    return min(found, key=lambda factors: (len(factors), sum(factors)), default=None)


def frequency_order(n: int) -> NDArray[np.int64]:
    """Return the frequencies 0 ... n - 1 in the order in which a transform outputs them."""
    order = np.zeros(1, np.int64)
    way = way_of(n)
    for radix in (*way.then.radices[::-1], *way.first.radices):
        order = (np.arange(radix)[:, None] + radix * order).ravel()
    return order


def aligned(count: int) -> Reals:
    """Return ``count`` zeros aligned to a cache line."""
    raw = np.zeros(count + 16, np.float32)
    first = -(raw.ctypes.data // 4) % 16
    return raw[first : first + count]


class FusedResponse:
    """Propagation of fields to the array and on to the pixels, in single precision.

    Parameters
    ----------
    step
        Transfer function from the array to the sensor (n, n), with frequencies in the order of `numpy.fft.fftfreq`; n
        must have no prime factor above 11.
    """

    def __init__(self, step: NDArray[Any]) -> None:
        n = step.shape[0]
        self._n, self._way, order = n, way_of(n), frequency_order(n)
        rows = np.zeros((-(-n // LANES), LANES, n), np.complex64)
        rows.reshape(-1, n)[:n] = step[order][:, order] / n**2
        # rows on lanes, columns in sequence
        buffers = np.stack([rows.real, rows.imag]).transpose(1, 3, 0, 2)
        self._transfer = aligned(buffers.size)
        self._transfer[:] = buffers.ravel()

    @staticmethod
    def transforms(n: int) -> bool:
        """Return whether grids with sides of ``n`` samples can be transformed."""
        return n >= LANES and _fewest(n, RADICES[-1]) is not None

    def workspace(self, rows: int) -> Work:
        """Return the scratch memory of one thread for cutouts with ``rows`` rows."""
        groups = -(-self._n // LANES)
        buffer = groups * LANES * STEP
        return Work(aligned(groups * buffer), aligned(buffer), aligned(rows * self._n), aligned(LANES))

    def respond(
        self,
        lit: NDArray[Any],
        array: tuple[NDArray[Any], tuple[int, int]],
        weights: Reals,
        place: tuple[int, int, int],
        work: Work,
        out: Reals,
    ) -> float:
        """Fill ``out`` (rows, columns) with the light on pixels and return the power behind the array; see `each`."""
        table, corner = array
        return float(self.each(lit, (table, [corner]), weights, place, work, out[None])[0])

    def each(
        self,
        lit: NDArray[Any],
        array: tuple[NDArray[Any], Sequence[tuple[int, int]]],
        weights: Reals,
        place: tuple[int, int, int],
        work: Work,
        out: Reals,
    ) -> NDArray[np.float64]:
        """Fill ``out`` (positions, rows, columns) with the light on pixels and return the powers behind the array.

        One call handles many positions, without waiting for other threads of the process.

        Parameters
        ----------
        lit
            Field incident on the array (n, n).
        array
            Table of the array's transmission, and the origin (row, column) in it of the grid of each position.
        weights
            Weights of the samples of a pixel along both axes.
        place
            Samples per pixel, and the first sample of the first pixel (row, column).
        work
            Scratch memory from `workspace`, not shared between threads.

        Raises
        ------
        ValueError
            If pixels or a grid exceed the arrays, which compiled code does not check.
        """
        table, corners = array
        n, (per, *starts), (height, width) = self._n, place, table.shape
        ends = [first + (count - 1) * per + weights.size for first, count in zip(starts, out.shape[1:], strict=True)]
        if min(starts) < 0 or max(ends) > n or lit.shape != (n, n):
            raise ValueError(
                f"field: expected samples within {n} x {n}, got {starts} to {ends} of {lit.shape[0]} x {lit.shape[1]}"
            )
        for row, column in corners:
            if min(row, column) < 0 or row + n > height or column + n > width:
                raise ValueError(f"grid at {row}, {column}: expected {n} x {n} samples within {height} x {width}")
        if len(corners) != len(out):
            raise ValueError(f"grids: expected one for each of {len(out)} cutouts, got {len(corners)}")
        first = np.array([row * width + column for row, column in corners], np.int64)
        powers = np.empty(len(out))
        pixels = Pixels(weights, *place, *out.shape[1:])
        respond(
            ResponseGrid(_flat(lit), _flat(table), width, first, n, self._transfer),
            self._way,
            pixels,
            work,
            out,
            powers,
        )
        return powers


def _flat(field: NDArray[Any]) -> Reals:
    return np.ascontiguousarray(field, np.complex64).reshape(-1).view(np.float32)
