"""Compiled loops that hold patterns beside those interpolated from their nodes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["BINS", "Corners", "left_over"]

BINS = 512
"""Of the sizes of entries, by which those that may be left out are told."""


class Corners(NamedTuple):
    """The nodes about a position."""

    which: NDArray[Any]  # their numbers, (k,)
    at: NDArray[Any]  # positions to each, (k, 2)
    shares: NDArray[Any]  # of each in what is interpolated, (k,)


@njit(fastmath={"contract", "reassoc"}, error_model="numpy")
def _add(pattern: NDArray[Any], share: float, onto: NDArray[Any]) -> None:
    """Add ``share`` times a pattern to as large a part of an array."""
    part = onto.dtype.type(share)
    for t in range(pattern.shape[0]):
        line, to = pattern[t], onto[t]
        for s in range(pattern.shape[1]):
            to[s] += part * line[s]


@njit(error_model="numpy")
def left_over(
    pattern: NDArray[Any],
    nodes: NDArray[Any],
    corners: Corners,
    tolerance: float,
    rest: NDArray[Any],
) -> tuple[int, float]:
    """Fill ``rest`` with what ``pattern`` is beside its nodes, the smallest entries left out.

    Parameters
    ----------
    pattern
        ``(nt, ns)``.
    nodes, corners
        Patterns of nodes, ``(any, nt, ns)``, and those about it.
    tolerance
        Largest sum of the sizes that are left out, of the sum of the pattern's.
    rest
        Filled: ``(nt + 2 my, ns + 2 mx)``, zero where nothing is kept; its margins take what nodes bring beside the
        cutout, at most (my, mx) positions away.

    Returns
    -------
    tuple of int and float
        Entries kept, and the share of the pattern that is left out.
    """
    nt, ns = pattern.shape
    which, at, shares = corners.which, corners.at, corners.shares
    my, mx = (rest.shape[0] - nt) // 2, (rest.shape[1] - ns) // 2
    rest[:] = 0
    for k in range(len(which)):
        if shares[k] != 0:
            top, left = my + at[k, 0], mx + at[k, 1]
            _add(nodes[which[k]], -shares[k], rest[top : top + nt, left : left + ns])
    _add(pattern, 1.0, rest[my : my + nt, mx : mx + ns])
    total, largest = 0.0, 0.0
    for t in range(nt):
        for s in range(ns):
            total += abs(pattern[t, s])
    for t in range(rest.shape[0]):
        for s in range(rest.shape[1]):
            largest = max(largest, abs(rest[t, s]))
    if largest == 0:
        return 0, 0.0
    # by size: bins that are narrow where entries are small and many
    sums = np.zeros(BINS)
    scale = (BINS - 1) / np.sqrt(np.sqrt(largest))
    for t in range(rest.shape[0]):
        for s in range(rest.shape[1]):
            size = abs(rest[t, s])
            sums[int(scale * np.sqrt(np.sqrt(size)))] += size
    room, dropped, first = tolerance * total, 0.0, 0
    while first < BINS and dropped + sums[first] <= room:
        dropped += sums[first]
        first += 1
    kept = 0
    for t in range(rest.shape[0]):
        for s in range(rest.shape[1]):
            if int(scale * np.sqrt(np.sqrt(abs(rest[t, s])))) < first:
                rest[t, s] = 0
            elif rest[t, s] != 0:
                kept += 1
    return kept, dropped / total if total > 0 else 0.0
