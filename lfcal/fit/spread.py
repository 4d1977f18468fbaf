"""Spread positions evenly over period and planes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan

__all__ = ["held_out_rows", "spread_out"]


def held_out_rows(
    index: NDArray[np.intp], count: int, plan: ScanPlan, earlier: NDArray[np.intp] | None = None
) -> NDArray[np.intp]:
    """Return which ``count`` positions to hold out, as row numbers in ``index`` ``(n, 3)``, in increasing order.

    The positions (z, y, x) are chosen from ``index`` to represent all others. They are also far from the positions
    ``earlier`` ``(m, 3)``, which are not returned. If ``index`` has fewer than ``count`` positions, all are returned.

    Positions that are far apart in the period may differ by an integer number of lenslets. Their patterns are then
    equal, and test a model at only one position relative to a lenslet. The chosen positions are therefore also far
    apart relative to the lenslets.
    """
    cell = plan.camera.periodic.basis_um()[:, ::-1] / plan.camera.sensor.pixel_um if plan.camera.has_lattice else None
    return spread_out(index, count, plan.period, earlier, cell)


def spread_out(
    index: NDArray[np.intp],
    count: int,
    period: tuple[int, int],
    earlier: NDArray[np.intp] | None = None,
    cell: NDArray[np.float64] | None = None,
) -> NDArray[np.intp]:
    """Return ``count`` positions (z, y, x) that are far apart, as row numbers in ``index`` ``(n, 3)``.

    The next plane is always that with the smallest fraction of chosen positions. Its next position is the one farthest
    from those already chosen in the plane, with distances measured across the edges of ``period`` (rows, columns). It
    is also far from the positions ``earlier`` ``(m, 3)``, which are not returned. If ``index`` has fewer than ``count``
    positions, all are returned. ``cell`` contains the vectors ``(2, 2)`` of the unit cell of the array, as (rows,
    columns) in pixels. With it, positions are far apart both in the period and relative to their lenslets.
    """
    there = np.zeros((0, 3), np.intp) if earlier is None else earlier
    planes: dict[int, _Plane] = {}
    for z in np.unique(index[:, 0]).tolist():
        members = np.flatnonzero(index[:, 0] == z)
        planes[z] = _Plane(members, index[members, 1:], period, cell)
        for place in there[there[:, 0] == z, 1:]:
            planes[z].away_from(place)
    for turn in range(count):
        z = min(planes, key=lambda z: (planes[z].full, len(planes[z].taken) / len(planes[z].members)))
        if planes[z].full:
            break
        planes[z].take(turn)
    chosen = [int(plane.members[k]) for plane in planes.values() for k in plane.taken]
    return np.sort(np.array(chosen, np.intp))


class _Plane:
    """Positions of a plane, the chosen ones, and the distance of each other position from the nearest of these."""

    def __init__(
        self,
        members: NDArray[np.intp],
        places: NDArray[np.intp],
        period: tuple[int, int],
        cell: NDArray[np.float64] | None,
    ) -> None:
        self.members, self.taken = members, list[int]()
        self._places, self._cell, self._size = places, cell, np.array(period, np.float64)
        self._nearest = np.full(len(places), np.inf)

    @property
    def full(self) -> bool:
        """Whether all positions have been chosen."""
        return len(self.taken) == len(self.members)

    def take(self, turn: int) -> None:
        """Choose the position farthest from those already chosen; the first is near the middle, and varies by plane."""
        if np.isinf(self._nearest).all():
            aim = self._size * (0.5 + 0.23 * (turn % 3 - 1))
            k = int(np.argmin(((self._places - aim) ** 2).sum(1)))
        else:
            k = int(np.argmax(self._nearest))
        self.taken.append(k)
        self.away_from(self._places[k])
        self._nearest[k] = -1.0

    def away_from(self, place: NDArray[np.intp]) -> None:
        """Update the distance of each position from the nearest chosen one after ``place`` was chosen.

        Distances are periodic in the period of the plan and, if there is one, in the unit cell; the smaller one counts.
        """
        between = self._places - place
        apart = np.minimum(np.abs(between), self._size - np.abs(between))
        squares = (apart**2).sum(1) / self._size.prod()
        if self._cell is not None:
            squares = np.minimum(squares, _folded(between, self._cell) / abs(np.linalg.det(self._cell)))
        self._nearest = np.minimum(self._nearest, squares)


def _folded(between: NDArray[np.intp], cell: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the squared length of the shortest of all vectors that equal ``between`` ``(..., 2)`` modulo the cell."""
    steps = between @ np.linalg.inv(cell)
    steps -= np.rint(steps)
    near = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    ways = (steps[..., None, :] + near) @ cell
    found: NDArray[np.float64] = np.square(ways).sum(-1).min(-1)
    return found
