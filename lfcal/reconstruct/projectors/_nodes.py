"""Positions of a period from which those between are interpolated, and the sums that go with them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["AxisNodes", "Nodes", "source_places"]

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class AxisNodes:
    """Nodes along one axis: whole positions about ``spacing`` apart, the first at 0; the next period goes on alike.

    Attributes
    ----------
    period
        Positions of the axis.
    spacing
        Wanted distance of two nodes (positions).
    """

    period: int
    spacing: float

    @cached_property
    def at(self) -> Ints:
        """Positions of the nodes, ``(m,)``."""
        count = max(1, round(self.period / self.spacing))
        return np.round(np.arange(count) * (self.period / count)).astype(np.int64)

    @cached_property
    def before(self) -> Ints:
        """Number of the node at or before each position, ``(period,)``."""
        return np.searchsorted(self.at, np.arange(self.period), side="right") - 1

    @cached_property
    def after(self) -> Ints:
        """Number of the node after each position, ``(period,)``; 0 is that of the next period."""
        return (self.before + 1) % len(self.at)

    @cached_property
    def back(self) -> Ints:
        """Positions from each to the node before it, at most 0, ``(period,)``."""
        return self.at[self.before] - np.arange(self.period)

    @cached_property
    def ahead(self) -> Ints:
        """Positions from each to the node after it, ``(period,)``."""
        following = np.append(self.at, self.period)
        return following[self.before + 1] - np.arange(self.period)

    @cached_property
    def weight(self) -> NDArray[np.float64]:
        """Share of the node after each position in what is interpolated there, in [0, 1), ``(period,)``."""
        return -self.back / (self.ahead - self.back)

    @cached_property
    def shares(self) -> NDArray[np.float64]:
        """Share of each node in what is interpolated at each position, ``(m + 1, period)``; the last is the next's."""
        found = np.zeros((len(self.at) + 1, self.period))
        everywhere = np.arange(self.period)
        found[self.before, everywhere] = 1 - self.weight
        found[self.before + 1, everywhere] += self.weight
        return found

    @property
    def farthest(self) -> int:
        """Most positions from one to a node that counts there."""
        return int(np.where(self.weight > 0, np.maximum(-self.back, self.ahead), 0).max())


@dataclass(frozen=True)
class Nodes:
    """Nodes of both axes.

    Interpolation is bilinear: a position is a sum of its four nodes' patterns, each where it is on the sensor.
    """

    y: AxisNodes
    x: AxisNodes

    @classmethod
    def of(cls, period: tuple[int, int], spacing: float) -> Nodes:
        """Return those of a period ``(ny, nx)``."""
        return cls(AxisNodes(period[0], spacing), AxisNodes(period[1], spacing))

    @property
    def shape(self) -> tuple[int, int]:
        """Nodes along both axes."""
        return len(self.y.at), len(self.x.at)

    def widened(self, cutout: tuple[int, int]) -> tuple[int, int]:
        """Return the cutout that holds what nodes bring to a position."""
        return cutout[0] + 2 * self.y.farthest, cutout[1] + 2 * self.x.farthest

    def collected(self, packed: NDArray[Any]) -> NDArray[Any]:
        """Return what each node stands for: weighted sums of ``packed`` over the positions about it.

        Parameters
        ----------
        packed
            Values of whole cells, ``(cells_y ny, cells_x nx)``; the last cell of both axes is zero, and takes what
            falls to the first nodes beyond the others.

        Returns
        -------
        numpy.ndarray
            ``(my, cells_y cells_x, mx)``.
        """
        ny, nx = self.y.period, self.x.period
        rows = _carried(np.matmul(self.y.shares.astype(packed.dtype), packed.reshape(-1, ny, packed.shape[1])))
        columns = np.matmul(rows.reshape(-1, packed.shape[1] // nx, nx), self.x.shares.T.astype(packed.dtype))
        both = _carried(columns.swapaxes(0, 1).swapaxes(1, 2)).swapaxes(1, 2)  # (cells_x, cells_y my, mx)
        my, mx = self.shape
        return both.reshape(len(both), -1, my, mx).transpose(2, 1, 0, 3).reshape(my, -1, mx)

    def spread(self, values: NDArray[Any], cells: tuple[int, int]) -> NDArray[Any]:
        """Return ``(cells_y ny, cells_x nx)`` interpolated from nodes ``(my, cells, mx)``: transpose of `collected`."""
        (my, mx), (cells_y, cells_x) = self.shape, cells
        both = values.reshape(my, cells_y, cells_x, mx).transpose(2, 1, 0, 3).reshape(cells_x, cells_y * my, mx)
        columns = _with_next(both.swapaxes(1, 2)).swapaxes(1, 2).swapaxes(0, 1)
        rows = np.matmul(columns, self.x.shares.astype(values.dtype)).reshape(cells_y, my, -1)
        out: NDArray[Any] = np.matmul(self.y.shares.T.astype(values.dtype), _with_next(rows))
        return out.reshape(cells_y * self.y.period, -1)


def source_places(period: tuple[int, int], nodes: Nodes | None) -> tuple[Ints, Ints]:
    """Return rows and columns of the positions that have patterns: those of nodes, or all."""
    return (np.arange(period[0]), np.arange(period[1])) if nodes is None else (nodes.y.at, nodes.x.at)


def _carried(sums: NDArray[Any]) -> NDArray[Any]:
    """Return ``(cells, m, n)`` of sums ``(cells, m + 1, n)``: the last ones belong to the next cell's first node."""
    found = sums[:, :-1].copy()
    found[1:, 0] += sums[:-1, -1]
    return found


def _with_next(values: NDArray[Any]) -> NDArray[Any]:
    """Return values ``(cells, m, n)`` and the next cell's first beside them: the transpose of `_carried`."""
    found = np.zeros((len(values), values.shape[1] + 1, values.shape[2]), values.dtype)
    found[:, :-1] = values
    found[:-1, -1] = values[1:, 0]
    return found
