"""Represent a plane of H by few patterns with interpolation between them, plus single entries as corrections.

Most entries of H are the weak light around each lenslet's spot, which changes slowly from source to source and
contains little of its light. This light is interpolated between nodes; spots are stored entry by entry.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import for_each_chunk, njit

__all__ = [
    "SPACINGS",
    "AxisNodes",
    "Nodes",
    "quickest_spacing",
    "reduce_plane",
    "relative_work",
    "sampled_share",
    "source_places",
]

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class AxisNodes:
    """Nodes along one axis: whole positions about ``spacing`` apart, the first at 0, repeated in the next period.

    Attributes
    ----------
    period
        Number of positions along the axis.
    spacing
        Requested distance between two nodes (positions).
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
        """Number of the node after each position, ``(period,)``; 0 is the first node of the next period."""
        return (self.before + 1) % len(self.at)

    @cached_property
    def back(self) -> Ints:
        """Offset from each position to the node before it, at most 0, ``(period,)``."""
        return self.at[self.before] - np.arange(self.period)

    @cached_property
    def ahead(self) -> Ints:
        """Offset from each position to the node after it, ``(period,)``."""
        following = np.append(self.at, self.period)
        return following[self.before + 1] - np.arange(self.period)

    @cached_property
    def weight(self) -> NDArray[np.float64]:
        """Weight of the node after each position in its interpolated value, in [0, 1), ``(period,)``."""
        return -self.back / (self.ahead - self.back)

    @cached_property
    def shares(self) -> NDArray[np.float64]:
        """Weight of each node at each position, ``(m + 1, period)``; the last is the first node of the next period."""
        found = np.zeros((len(self.at) + 1, self.period))
        everywhere = np.arange(self.period)
        found[self.before, everywhere] = 1 - self.weight
        found[self.before + 1, everywhere] += self.weight
        return found

    @property
    def farthest(self) -> int:
        """Largest distance from a position to one of its nodes (positions)."""
        return int(np.where(self.weight > 0, np.maximum(-self.back, self.ahead), 0).max())


@dataclass(frozen=True)
class Nodes:
    """Nodes along both axes.

    Interpolation is bilinear: a pattern is a weighted sum of the patterns of four nodes at their positions on the
    sensor.
    """

    y: AxisNodes
    x: AxisNodes

    @classmethod
    def of(cls, period: tuple[int, int], spacing: float) -> Nodes:
        """Return the nodes of a period ``(ny, nx)``."""
        return cls(AxisNodes(period[0], spacing), AxisNodes(period[1], spacing))

    @property
    def shape(self) -> tuple[int, int]:
        """Number of nodes along both axes."""
        return len(self.y.at), len(self.x.at)

    def widened(self, cutout: tuple[int, int]) -> tuple[int, int]:
        """Return the cutout that contains the contributions of nodes to a position."""
        return cutout[0] + 2 * self.y.farthest, cutout[1] + 2 * self.x.farthest

    def collected(self, packed: NDArray[Any]) -> NDArray[Any]:
        """Return the weighted sums of ``packed`` at each node, over the surrounding positions.

        Parameters
        ----------
        packed
            Values of whole cells, ``(cells_y ny, cells_x nx)``. The last cell of both axes is zero, and receives the
            contributions to the first nodes beyond the others.

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
    """Return rows and columns of the positions with patterns: those of nodes, or all."""
    return (np.arange(period[0]), np.arange(period[1])) if nodes is None else (nodes.y.at, nodes.x.at)


def _carried(sums: NDArray[Any]) -> NDArray[Any]:
    """Return ``(cells, m, n)`` of sums ``(cells, m + 1, n)``; the last of each cell goes to the first of the next."""
    found = sums[:, :-1].copy()
    found[1:, 0] += sums[:-1, -1]
    return found


def _with_next(values: NDArray[Any]) -> NDArray[Any]:
    """Return values ``(cells, m, n)`` with the first of the next cell appended: the transpose of `_carried`."""
    found = np.zeros((len(values), values.shape[1] + 1, values.shape[2]), values.dtype)
    found[:, :-1] = values
    found[:-1, -1] = values[1:, 0]
    return found


BINS = 512
"""Number of classes of magnitude, for choosing the entries to omit."""


class Corners(NamedTuple):
    """Nodes around a position."""

    which: NDArray[Any]  # numbers of the nodes, (k,)
    at: NDArray[Any]  # offsets to the nodes (positions), (k, 2)
    shares: NDArray[Any]  # weights in the interpolation, (k,)


@njit(fastmath={"contract", "reassoc"}, error_model="numpy")
def _add(pattern: NDArray[Any], share: float, onto: NDArray[Any]) -> None:
    """Add ``share`` times a pattern to a part of an array that has the same size."""
    part = onto.dtype.type(share)
    for t in range(pattern.shape[0]):
        line, to = pattern[t], onto[t]
        for s in range(pattern.shape[1]):
            to[s] += part * line[s]


@njit(error_model="numpy")
def residual_entries(
    pattern: NDArray[Any],
    nodes: NDArray[Any],
    corners: Corners,
    tolerance: float,
    rest: NDArray[Any],
) -> tuple[int, float]:
    """Write the difference between ``pattern`` and its interpolation to ``rest``, without the smallest entries.

    Parameters
    ----------
    pattern
        ``(nt, ns)``.
    nodes, corners
        Patterns of nodes, ``(any, nt, ns)``, and the nodes around the position.
    tolerance
        Largest sum of omitted magnitudes, relative to that of the pattern.
    rest
        Filled: ``(nt + 2 my, ns + 2 mx)``, zero where nothing is kept; its margins receive contributions of nodes
        outside the cutout, at most (my, mx) positions away.

    Returns
    -------
    tuple of int and float
        Number of kept entries, and the omitted fraction of the pattern.
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
    # by magnitude, in bins that are narrow for the many small entries
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


Array = NDArray[Any]

SPACINGS = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 11.0)
"""Distances of nodes (positions) that are tried."""

NODE_WORK, ENTRY_WORK = 1.2, 2.0
"""Cost of a node's pattern and of a single entry, relative to those of a plane projected completely (measured)."""


@dataclass(frozen=True)
class Reduction:
    """Plane of H within a tolerance: interpolated from ``patterns``, plus ``rest``.

    Attributes
    ----------
    nodes
        Positions of the patterns.
    patterns
        ``(my, mx, nt, ns)``.
    rest
        ``(ny, nx, nt + 2 my, ns + 2 mx)``, zero for omitted entries; margins contain contributions of nodes outside a
        cutout.
    kept
        Number of kept entries of ``rest``.
    error
        Sum of the omitted magnitudes at each position, as a fraction of the sum of all, ``(ny, nx)``.
    """

    nodes: Nodes
    patterns: Array
    rest: Array
    kept: int
    error: NDArray[np.float64]

    def plane(self) -> Array:
        """Return the represented plane, ``(ny, nx, nt + 2 my, ns + 2 mx)``."""
        (nt, ns), rest = self.patterns.shape[2:], self.rest
        flat, nothing = self.patterns.reshape(-1, nt, ns), np.zeros((nt, ns), rest.dtype)
        out = np.empty_like(rest)
        for y, x in np.ndindex(*rest.shape[:2]):
            # outside the cutout, the residual is minus the interpolated value
            residual_entries(nothing, flat, _corners(self.nodes, y, x), 0.0, out[y, x])
        return rest - out


def reduce_plane(plane: Array, spacing: float, tolerance: float, workers: int | None = None) -> Reduction:
    """Reduce ``plane`` ``(ny, nx, nt, ns)`` within ``tolerance``, with nodes ``spacing`` positions apart.

    The sum of omitted magnitudes at a position is at most ``tolerance`` times that of its pattern.
    """
    nodes = Nodes.of((plane.shape[0], plane.shape[1]), spacing)
    patterns = np.ascontiguousarray(plane[np.ix_(nodes.y.at, nodes.x.at)])
    flat = patterns.reshape(-1, *plane.shape[2:])
    rest = np.empty((*plane.shape[:2], *nodes.widened((plane.shape[2], plane.shape[3]))), plane.dtype)
    error = np.zeros(plane.shape[:2])

    def work(start: int, stop: int) -> int:
        kept = 0
        for y in range(start, stop):
            for x in range(plane.shape[1]):
                found = residual_entries(plane[y, x], flat, _corners(nodes, y, x), tolerance, rest[y, x])
                kept, error[y, x] = kept + found[0], found[1]
        return kept

    return Reduction(nodes, patterns, rest, sum(for_each_chunk(work, plane.shape[0], workers)), error)


def relative_work(spacing: float, kept: float) -> float:
    """Return the cost of a projection relative to the complete plane, with a fraction ``kept`` of its entries."""
    return 1.0 if spacing == 1 else NODE_WORK / spacing**2 + ENTRY_WORK * kept


def quickest_spacing(kept: Mapping[float, float], work: Callable[[float, float], float] = relative_work) -> float:
    """Return the spacing with the lowest cost, given the fraction of kept entries for each; 1 if none is lower.

    The choice depends on counts and not on times, so that projections are the same on every computer.
    """
    return min((1.0, *kept), key=lambda spacing: work(spacing, kept.get(spacing, 1.0)))


def sampled_share(
    pattern: Callable[[int, int], Array], period: tuple[int, int], spacing: float, tolerance: float, samples: int = 16
) -> float:
    """Return an estimate of the fraction of entries that a reduced plane keeps, from ``samples`` positions.

    ``pattern`` is a function that returns the pattern ``(nt, ns)`` of position (y, x).
    """
    nodes = Nodes.of(period, spacing)
    rng = np.random.default_rng(0)
    chosen = rng.choice(period[0] * period[1], min(samples, period[0] * period[1]), replace=False)
    kept = entries = 0
    for position in chosen.tolist():
        y, x = divmod(position, period[1])
        own = pattern(y, x)
        corners = _corners(nodes, y, x)
        places = [divmod(int(k), nodes.shape[1]) for k in corners.which]
        about = np.stack([pattern(int(nodes.y.at[j]), int(nodes.x.at[i])) for j, i in places])
        rest = np.empty(nodes.widened((own.shape[0], own.shape[1])), own.dtype)
        kept += residual_entries(own, about, corners._replace(which=np.arange(len(about))), tolerance, rest)[0]
        entries += own.size
    return kept / entries


def _corners(nodes: Nodes, y: int, x: int) -> Corners:
    """Return the four nodes about (y, x)."""
    down, across, mx = nodes.y, nodes.x, nodes.shape[1]
    rows = ((down.before[y], down.back[y], 1 - down.weight[y]), (down.after[y], down.ahead[y], down.weight[y]))
    columns = (
        (across.before[x], across.back[x], 1 - across.weight[x]),
        (across.after[x], across.ahead[x], across.weight[x]),
    )
    both = [(j * mx + i, dy, dx, a * b) for j, dy, a in rows for i, dx, b in columns]
    which, dy, dx, shares = zip(*both, strict=True)
    return Corners(np.array(which, np.int64), np.array([dy, dx], np.int64).T.copy(), np.array(shares, np.float64))
