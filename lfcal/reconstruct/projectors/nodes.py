"""Positions of a period from which those between are interpolated, and the sums that go with them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["AxisNodes", "Nodes"]

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
        rows = _sums(packed, self.y)
        (my, mx), cells_y = self.shape, packed.shape[0] // self.y.period
        both = np.ascontiguousarray(_sums(rows.T, self.x).T)
        return both.reshape(cells_y, my, -1, mx).swapaxes(0, 1).reshape(my, -1, mx)

    def spread(self, values: NDArray[Any], cells: tuple[int, int]) -> NDArray[Any]:
        """Return ``(cells_y ny, cells_x nx)`` interpolated from nodes ``(my, cells, mx)``: transpose of `collected`."""
        (my, mx), (cells_y, cells_x) = self.shape, cells
        lattice = values.reshape(my, cells_y, cells_x, mx).swapaxes(0, 1).reshape(cells_y * my, cells_x * mx)
        rows = _between(lattice, self.y, cells_y)
        return np.ascontiguousarray(_between(rows.T, self.x, cells_x).T)


def _sums(values: NDArray[Any], nodes: AxisNodes) -> NDArray[Any]:
    """Return the weighted sums over the first axis."""
    cells, rest = values.shape[0] // nodes.period, values.shape[1:]
    weight = np.tile(nodes.weight, cells).astype(values.dtype).reshape(-1, *([1] * len(rest)))
    starts = (np.arange(cells)[:, None] * nodes.period + nodes.at).ravel()
    later = np.add.reduceat(values * weight, starts, axis=0)
    found: NDArray[Any] = np.add.reduceat(values * (1 - weight), starts, axis=0)
    found[1:] += later[:-1]
    return found


def _between(values: NDArray[Any], nodes: AxisNodes, cells: int) -> NDArray[Any]:
    """Return values interpolated along the first axis: the transpose of `_sums`."""
    rest = values.shape[1:]
    weight = np.tile(nodes.weight, cells).astype(values.dtype).reshape(-1, *([1] * len(rest)))
    before = (np.arange(cells)[:, None] * len(nodes.at) + nodes.before).ravel()
    after = np.minimum(before + 1, len(values) - 1)
    found: NDArray[Any] = values[before] * (1 - weight)
    # nothing lies beyond the last node, where `_sums` drops what comes to it
    found += np.where((before + 1 < len(values)).reshape(weight.shape), weight, 0) * values[after]
    return found
