"""How much of each voxel's light spreads as H of each region of the field says: weights that sum to one.

Patterns change slowly over the field. Between places where H is known each voxel's pattern is taken as the mean of
those of the places around, linear from place to place (the variation in space of Nagy & O'Leary 1998, SIAM J. Sci.
Comput. 19, 1063): the weights belong to the voxel that shines, not to the pixel it is seen in. So what a voxel emits is
the weighted mean of what the regions have it emit, patterns stay as they are where one region alone counts, and the
operator ``sum_r H_r W_r`` has the exact adjoint ``sum_r W_r HT_r``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError

__all__ = ["field_weights", "place_weights"]

F8 = NDArray[np.float64]
Pair = tuple[float, float]

NODES = 257
"""Places per axis at which weights are computed; they are linear between."""

APART_PX = 1.0
"""Regions that are nearer than this are one."""


def place_weights(middles: Sequence[Pair], points: F8) -> F8:
    """Return the weight of each region at ``points`` ``(n, 2)``: ``(regions, n)``, in [0, 1], of sum 1.

    Linear within each triangle of neighbouring regions (Delaunay), or along the line where all lie on one; beyond them
    as at the nearest point between.

    Parameters
    ----------
    middles
        Where each region's H was taken (row, column).
    points
        Places (row, column).

    Raises
    ------
    InputError
        If two regions lie at one place.
    """
    # the window looks at pages without it
    from scipy.spatial import ConvexHull, Delaunay

    places = np.asarray(middles, np.float64)
    _check_apart(places)
    if len(places) == 1:
        return np.ones((1, len(points)))
    centred = places - places.mean(axis=0)
    _, sizes, axes = np.linalg.svd(centred, full_matrices=False)
    if len(places) == 2 or sizes[1] < APART_PX:
        return _along_line(centred @ axes[0], (points - places.mean(axis=0)) @ axes[0])
    mesh = Delaunay(places)
    found = mesh.find_simplex(points)
    weights = np.zeros((len(places), len(points)))
    inside = np.flatnonzero(found >= 0)
    corners, maps = mesh.simplices[found[inside]], mesh.transform[found[inside]]
    first = np.einsum("nij,nj->ni", maps[:, :2], points[inside] - maps[:, 2])
    share = np.column_stack([first, 1 - first.sum(axis=1)]).clip(0, 1)
    weights[corners, inside[:, None]] = share / share.sum(axis=1, keepdims=True)
    outside = np.flatnonzero(found < 0)
    weights[:, outside] = _on_hull(places, ConvexHull(places).simplices, points[outside])
    return weights


def _check_apart(places: F8) -> None:
    for k, place in enumerate(places):
        near = np.flatnonzero(np.hypot(*(places[:k] - place).T) < APART_PX)
        if near.size:
            raise InputError.expected(
                "regions of the field",
                "a place of its own for each",
                f"{near[0] + 1} and {k + 1} at one",
                "leave one out",
            )


def _along_line(at: F8, points: F8) -> F8:
    order = np.argsort(at)
    return np.array([np.interp(points, at[order], (order == k).astype(float)) for k in range(len(at))])


def _on_hull(places: F8, edges: NDArray[Any], points: F8) -> F8:
    """Return the weights at the nearest point of the outline."""
    weights = np.zeros((len(places), len(points)))
    best, every = np.full(len(points), np.inf), np.arange(len(points))
    chosen, along = np.zeros(len(points), np.intp), np.zeros(len(points))
    for k, (a, b) in enumerate(edges):
        side = places[b] - places[a]
        t = ((points - places[a]) @ side / (side @ side)).clip(0, 1)
        away = np.hypot(*(points - places[a] - t[:, None] * side).T)
        nearer = away < best
        best, chosen, along = np.where(nearer, away, best), np.where(nearer, k, chosen), np.where(nearer, t, along)
    weights[edges[chosen, 0], every] = 1 - along
    weights[edges[chosen, 1], every] = along
    return weights


def field_weights(middles: Sequence[Pair], shape: tuple[int, int]) -> list[F8]:
    """Return the weight image ``(rows, columns)`` of each region; they sum to one at every pixel.

    ``middles`` are pixels (row, column) of the image; regions may lie outside of it.
    """
    nodes = [np.linspace(0, n - 1, min(n, NODES)) for n in shape]
    points = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 2)
    coarse = place_weights(middles, points).reshape(len(middles), len(nodes[0]), len(nodes[1]))
    down, across = (_between(n, len(at)) for n, at in zip(shape, nodes, strict=True))
    found = []
    for one in coarse:
        rows = one[down[0]] * (1 - down[1])[:, None] + one[down[0] + down[2]] * down[1][:, None]
        left, right = rows[:, across[0]], rows[:, across[0] + across[2]]
        found.append(left * (1 - across[1]) + right * across[1])
    return found


def _between(pixels: int, nodes: int) -> tuple[NDArray[np.intp], F8, int]:
    """Return for each pixel the node before it, the share of the one after it, and how far on that is."""
    if nodes == 1:
        return np.zeros(pixels, np.intp), np.zeros(pixels), 0
    at: F8 = np.arange(pixels, dtype=np.float64) * ((nodes - 1) / max(1, pixels - 1))
    before: NDArray[np.intp] = np.minimum(at.astype(np.intp), nodes - 2)
    return before, at - before, 1
