"""Positions spread evenly over period and planes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["spread_out"]


def spread_out(
    index: NDArray[np.intp], count: int, period: tuple[int, int], earlier: NDArray[np.intp] | None = None
) -> NDArray[np.intp]:
    """Return which ``count`` of positions ``(n, 3)`` as (z, y, x) lie farthest from each other; planes in turn.

    Each next one is the farthest from all that were taken, around the period's edges; planes have equal shares.
    Positions ``earlier`` ``(m, 3)`` count as taken, without being among those returned.
    """
    there = np.zeros((0, 3), np.intp) if earlier is None else earlier
    planes = np.unique(index[:, 0])
    taken: dict[int, list[int]] = {int(z): [] for z in planes}
    members = {int(z): np.flatnonzero(index[:, 0] == z) for z in planes}
    for turn in range(count):
        order = sorted(taken, key=lambda z: (len(taken[z]) - len(members[z]) >= 0, len(taken[z]) / len(members[z])))
        z = order[0]
        if len(taken[z]) == len(members[z]):
            break
        others = there[there[:, 0] == z, 1:]
        taken[z].append(_farthest(index[members[z], 1:], taken[z], others, period, turn))
    chosen = [int(members[z][k]) for z, own in taken.items() for k in own]
    return np.sort(np.array(chosen, np.intp))


def _farthest(
    places: NDArray[np.intp], taken: list[int], others: NDArray[np.intp], period: tuple[int, int], turn: int
) -> int:
    """Return the place that is farthest from those taken and ``others``; at first one near the middle.

    The first one lies elsewhere in each plane.
    """
    size = np.array(period, np.float64)
    full = np.concatenate([places[np.array(taken, np.intp)], others])
    if not len(full):
        aim = size * (0.5 + 0.23 * (turn % 3 - 1))
        return int(np.argmin(((places - aim) ** 2).sum(1)))
    apart = np.abs(places[:, None, :] - full[None, :, :])
    apart = np.minimum(apart, size - apart)
    nearest = (apart**2).sum(2).min(1)
    nearest[np.array(taken, np.intp)] = -1.0
    return int(np.argmax(nearest))
