"""Which offsets of a target are lit in each frame, where its points are switched."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from lfcal.base import InputError, check_tuple, check_type

__all__ = ["Lit", "checked_lit", "lit_blocks", "lit_by", "lit_matrix"]

Lit = tuple[tuple[tuple[int, ...], ...], ...]
"""Of each plane and frame, the numbers of the offsets."""

MOST = 4096
"""Offsets of a plane that are solved for."""


def lit_by(code: NDArray[Any], count: int) -> tuple[tuple[int, ...], ...]:
    """Return which of ``count`` offsets each frame lights, groups of offsets one after the other by the same code.

    Parameters
    ----------
    code
        Square, of 0 and 1 ``(frames, offsets)``: which offset of a group each of its frames shows.
    count
        Offsets, a multiple of the group's.
    """
    order = len(code)
    if code.shape != (order, order) or count % order:
        raise InputError.expected("offsets that are shown together", f"groups of {order}", count, "fill them up")
    return tuple(tuple(group + int(m) for m in np.flatnonzero(row)) for group in range(0, count, order) for row in code)


def checked_lit(lit: Any, counts: Sequence[int]) -> Lit:
    """Return which offsets the frames of each plane light; raises `InputError` unless each can be solved for."""
    what = "offsets lit in each frame"
    check_type(what, lit, (tuple, list))
    found = []
    if len(lit) != len(counts):
        raise InputError.expected(what, f"a list for each of {len(counts)} planes", len(lit), "correct them")
    for plane, count in zip(lit, counts, strict=True):
        check_type(what, plane, (tuple, list))
        if len(plane) != count or count > MOST:
            raise InputError.expected(what, f"{count} frames, as many as offsets, up to {MOST}", len(plane), "correct")
        for one in plane:
            check_type(what, one, (tuple, list))
        frames = tuple(check_tuple(what, one, len(one), integer=True, at_least=0, at_most=count - 1) for one in plane)
        if not all(frames) or any(len(set(one)) < len(one) for one in frames):
            raise InputError.expected(what, "one or more, each once", "none, or one twice", "correct them")
        if not _solvable(frames, count):
            raise InputError.expected(what, "frames from which every offset comes back", "fewer", "take an S-matrix")
        found.append(frames)
    return tuple(found)


def lit_matrix(frames: Sequence[Sequence[int]], count: int) -> NDArray[np.float64]:
    """Return 1 where a frame lights an offset ``(frames, count)``, else 0."""
    out = np.zeros((len(frames), count))
    for row, one in zip(out, frames, strict=True):
        row[list(one)] = 1.0
    return out


def lit_blocks(frames: Sequence[Sequence[int]], count: int) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return frames and offsets that have to do with each other, group by group."""
    rows = np.repeat(np.arange(len(frames)), [len(one) for one in frames])
    columns = np.concatenate([np.asarray(one, np.intp) for one in frames]) if frames else np.zeros(0, np.intp)
    graph = coo_array((np.ones(len(rows)), (rows, len(frames) + columns)), shape=(len(frames) + count,) * 2)
    number, group = connected_components(graph, directed=False)
    nodes = [np.flatnonzero(group == k) for k in range(number)]
    return [(own[own < len(frames)], own[own >= len(frames)] - len(frames)) for own in nodes]


def _solvable(frames: Sequence[Sequence[int]], count: int) -> bool:
    whole = lit_matrix(frames, count)
    return all(
        len(rows) == len(columns) == np.linalg.matrix_rank(whole[np.ix_(rows, columns)])
        for rows, columns in lit_blocks(frames, count)
    )
