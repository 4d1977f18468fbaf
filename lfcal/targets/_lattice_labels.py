"""Which spots of a frame stand on which places of one lattice, up to where it begins."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lfcal.base import InputError

__all__ = ["lattice_labels", "refined_basis"]

Array = NDArray[np.float64]
Index = NDArray[np.intp]

REACH = 3.3
"""Pitches over which neighbours are followed: a missing row, or two, part no lattice."""

OFF = 0.22
"""Share of a pitch that a neighbour may lie beside its place."""

NEAR = 0.3
"""The same of the first neighbours, from which the basis is measured."""


def refined_basis(pixels: Array, basis: Array) -> Array:
    """Return the lattice's two vectors ``(2, 2)`` as seen in spots, nearest to those expected.

    Raises
    ------
    InputError
        If no two spots are apart as expected.
    """
    tree = cKDTree(pixels)
    longest = float(np.linalg.norm(basis, axis=1).max())
    pairs = np.array(sorted(tree.query_pairs(1.5 * longest)), np.intp).reshape(-1, 2)
    away = pixels[pairs[:, 1]] - pixels[pairs[:, 0]] if len(pairs) else np.zeros((0, 2))
    away = np.concatenate([away, -away])
    found = basis.copy()
    for _ in range(4):
        for k in range(2):
            close = np.linalg.norm(away - found[k], axis=1) < NEAR * np.linalg.norm(basis[k])
            if close.any():
                found[k] = np.median(away[close], axis=0)
    near = [(np.linalg.norm(away - b, axis=1) < OFF * np.linalg.norm(b)).sum() for b in found]
    if len(pixels) > 1 and not any(near):
        apart = np.linalg.norm(basis, axis=1)
        nearest = np.asarray(tree.query(pixels, 2)[0])[:, 1]
        raise InputError.expected(
            "neighbours in the frame",
            f"points {apart[0]:.1f} or {apart[1]:.1f} px apart, turned by at most 15°",
            f"{np.median(nearest):.1f} px",
            "check pitch, depth and rotation of the target",
        )
    return found


def lattice_labels(pixels: Array, basis: Array) -> tuple[Index, NDArray[np.bool_]]:
    """Return places ``(n, 2)`` of spots in the lattice, and which of them have one.

    Labels grow from spot to spot, the most certain step first, each by its neighbour's place: tilt and distortion are
    followed. What lies between places, or on one that is taken, has none.
    """
    n = len(pixels)
    label, has = np.zeros((n, 2), np.intp), np.zeros(n, np.bool_)
    tree = cKDTree(pixels)
    inverse = np.linalg.inv(basis)
    reach = REACH * float(np.linalg.norm(basis, axis=1).max())
    near = [list(tree.query_ball_point(at, reach)) for at in pixels]

    def steps(k: int) -> list[tuple[float, int, int, tuple[int, int]]]:
        out = []
        for other in near[k]:
            step = (pixels[other] - pixels[k]) @ inverse
            whole = np.rint(step)
            far = float(np.abs(step - whole).max())
            if other != k and whole.any() and far < OFF:
                out.append((far + 0.2 * float(np.abs(whole).sum()), k, other, (int(whole[0]), int(whole[1]))))
        return out

    left = set(range(n))
    best: tuple[Index, NDArray[np.bool_]] = (label, has)
    # the largest connected part is the target; a ghost or dirt may be where growth begins
    while left:
        start = max(left, key=lambda k: sum(1 for s in steps(k) if s[2] in left))
        label, has = np.zeros((n, 2), np.intp), np.zeros(n, np.bool_)
        has[start] = True
        taken = {(0, 0)}
        heap = steps(start)
        heapq.heapify(heap)
        while heap:
            _, k, other, (a, b) = heapq.heappop(heap)
            at = (int(label[k, 0]) + a, int(label[k, 1]) + b)
            if has[other] or at in taken:
                continue
            label[other], has[other] = at, True
            taken.add(at)
            for step in steps(other):
                heapq.heappush(heap, step)
        if has.sum() > best[1].sum():
            best = label, has
        left -= set(np.flatnonzero(has).tolist())
        if len(left) <= best[1].sum():
            break
    return best
