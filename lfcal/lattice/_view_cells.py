"""The lenslets about each sample of a view, and their shares in it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

__all__ = ["Cells", "cells_between", "cells_in_rows"]

Array = NDArray[np.float64]

SNAP = 1e-5
"""A sample this close to a lenslet (pitches) is that lenslet's: rounding must not draw in one that may lie outside."""

SQUARE = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
"""Corners (q, r) of a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Lenslets, and which of them make which sample.

    Attributes
    ----------
    lenslets
        ``(n, 2)``: indices (q, r), in the order in which rows of samples need them first.
    near, share
        ``(rows, columns, k)``: a sample's lenslets by their number, and their shares (sum 1).
    """

    lenslets: NDArray[np.intp] = field(repr=False)
    near: NDArray[np.int32] = field(repr=False)
    share: Array = field(repr=False)

    @classmethod
    def none(cls) -> Cells:
        """Return the cells of no samples."""
        return cls(np.zeros((0, 2), np.intp), np.zeros((0, 0, 1), np.int32), np.zeros((0, 0, 1)))

    def cut(self, share: Array, part: tuple[slice, slice]) -> tuple[NDArray[np.bool_], NDArray[np.int32], Array]:
        """Return for a part of the samples, with other shares: which lenslets have one, and `near` and `share`."""
        near, left = self.near[part], np.ascontiguousarray(share[part])
        used = np.zeros(len(self.lenslets), np.bool_)
        used[near[left > 0]] = True
        number = np.cumsum(used, dtype=np.int32) - np.int32(1)
        # what counts for nothing may be any number that exists
        return used, np.maximum(number[near], 0), left


def cells_between(kind: str, place: Array) -> Cells:
    """Return the cells about fractional indices ``place`` ``(rows, columns, 2)`` as (q, r).

    Square: the four corners of a cell, bilinear. Hexagonal: the three of the triangle, by barycentric coordinates; the
    cell's short diagonal, from (1, 0) to (0, 1), parts it into two.
    """
    base = np.floor(place + SNAP)
    q, r = np.moveaxis(np.where(np.abs(place - base) < SNAP, 0.0, place - base), -1, 0)
    corner = base.astype(np.intp)[..., None, :]
    if kind == "square":
        index = corner + SQUARE
        share = np.stack([(1 - q) * (1 - r), q * (1 - r), (1 - q) * r, q * r], axis=-1)
    else:
        upper = (q + r > 1)[..., None]
        # the third corner lies at (0, 0) or, beyond the diagonal, at (1, 1)
        index = np.concatenate([corner + upper[..., None], corner + SQUARE[1:3]], axis=-2)
        lower = np.stack([1 - q - r, q, r], axis=-1)
        share = np.where(upper, np.stack([q + r - 1, 1 - r, 1 - q], axis=-1), lower)
    share[share < SNAP] = 0.0
    share /= share.sum(-1, keepdims=True)
    return Cells(*_numbered(index), share)


def _numbered(index: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """Return the different lenslets ``(n, 2)`` as they come first, and the number of each of ``index``."""
    low = index.min((0, 1, 2))
    span = int(index[..., 1].max() - low[1]) + 1
    code = (index[..., 0] - low[0]) * span + (index[..., 1] - low[1])
    different, first, number = np.unique(code, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    lenslets = np.stack(np.divmod(different[order], span), axis=-1) + low
    return lenslets, rank[number].reshape(index.shape[:-1])


def cells_in_rows(rows: NDArray[np.intp], columns: Array, lean: float) -> Cells:
    """Return the cells of samples at ``columns`` of lattice rows ``rows``, made of neighbours in their row.

    ``columns`` count pitches along the rows; lenslet (q, r) lies at ``q + lean r``.
    """
    place = columns[None, :] - lean * rows[:, None]
    left = np.floor(place + SNAP)
    between = place - left
    between[np.abs(between) < SNAP] = 0.0
    first = left[:, :1]
    most = 2 if between.any() else 1
    count = int((left[:, -1] - first[:, 0]).max()) + most
    q = (first.astype(np.intp) + np.arange(count)).ravel()
    lenslets = np.stack([q, np.repeat(rows, count)], axis=-1)
    near = (left - first + count * np.arange(len(rows))[:, None]).astype(np.int32)
    if most == 1:
        return Cells(lenslets, near[..., None], np.ones((*near.shape, 1)))
    return Cells(lenslets, np.stack([near, near + 1], axis=-1), np.stack([1 - between, between], axis=-1))
