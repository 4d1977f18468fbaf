"""Which hole of the target each place of a lattice is: a certain one, or a line that says why not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.targets.target import Target

__all__ = ["TURNS", "Match", "holes_of", "matches", "places_of", "turned_absent"]

Index = NDArray[np.intp]

TURNS = {
    "as described": (False, 0),
    "turned by 90°": (False, 1),
    "turned by 180°": (False, 2),
    "turned by 270°": (False, 3),
    "mirrored left to right": (True, 0),
    "mirrored and turned by 90°": (True, 1),
    "mirrored top to bottom": (True, 2),
    "mirrored and turned by 270°": (True, 3),
}
"""Ways in which an array may be put in: mirrored or not, quarter turns after that."""


@dataclass(frozen=True, eq=False)
class Match:
    """A lattice laid on a target.

    Attributes
    ----------
    shift
        What is added to places of the lattice.
    turn
        How the target lies, one of `TURNS`.
    hits, misses, extra
        Spots on holes; holes on the frame without a spot, of a row or column without any counted once; spots where
        there is no hole.
    """

    shift: tuple[int, int]
    turn: str
    hits: int
    misses: int
    extra: int

    @property
    def score(self) -> int:
        """How well they agree."""
        return self.hits - self.misses - 2 * self.extra


def places_of(holes: Index, target: Target) -> Index:
    """Return holes ``(n, 2)`` (row, column) as places in the lattice: rows lean where the array is hexagonal."""
    out = np.array(holes, np.intp)
    if target.kind == "hexagonal":
        out[:, 1] -= out[:, 0] // 2
    return out


def holes_of(places: Index, target: Target) -> Index:
    """Return places ``(n, 2)`` of the lattice as holes (row, column)."""
    out = np.array(places, np.intp)
    if target.kind == "hexagonal":
        out[:, 1] += out[:, 0] // 2
    return out


def turned_absent(target: Target, turn: str) -> Target | None:
    """Return the target with its marks where they are seen when it was put in another way; None: it cannot be so.

    A rectangle that is turned by a quarter is another array, and so is a hexagonal one that is not turned by half.
    """
    mirror, quarters = TURNS[turn]
    if quarters % 2 and (target.shape[0] != target.shape[1] or target.pitch_um[0] != target.pitch_um[1]):
        return None
    if target.kind == "hexagonal" and (quarters % 2 or mirror or (quarters and target.shape[0] % 2)):
        return None
    there = np.ones(target.shape, np.bool_)
    for hole in target.absent:
        there[hole] = False
    seen = np.rot90(there[:, ::-1] if mirror else there, quarters)
    return replace(target, absent=tuple((int(r), int(c)) for r, c in np.argwhere(~seen)))


def matches(
    places: Index,
    target: Target,
    on_frame: NDArray[np.bool_],
    around: tuple[int, int],
    reach: int,
) -> Iterator[Match]:
    """Yield how a lattice may lie on a target as it is described, and as it may have been put in otherwise.

    Parameters
    ----------
    places
        Of spots ``(n, 2)``.
    target
        As described.
    on_frame
        Which places of the lattice ``(rows, columns)`` the frame shows whole, the first of them being `around` less
        than (0, 0) of the lattice: misses are counted there.
    around
        Places of the lattice before its (0, 0).
    reach
        Least number of spots on holes.
    """
    seen = np.zeros(on_frame.shape, np.bool_)
    inside = places + np.array(around)
    seen[tuple(inside.T)] = True
    turns = TURNS if target.absent else ("as described",)
    for turn in turns:
        own = turned_absent(target, turn)
        if own is None:
            continue
        holes = places_of(own.holes, own)
        low, high = holes.min(0) - places.max(0), holes.max(0) - places.min(0)
        for a in range(int(low[0]), int(high[0]) + 1):
            for b in range(int(low[1]), int(high[1]) + 1):
                at = holes - np.array([a, b]) + np.array(around)
                within = ((at >= 0) & (at < np.array(on_frame.shape))).all(1)
                at = at[within]
                shown = seen[tuple(at.T)]
                hits = int(shown.sum())
                if hits < reach:
                    continue
                misses = _misses(holes[within], on_frame[tuple(at.T)], shown)
                yield Match((a, b), turn, hits, misses, len(places) - hits)


def _misses(holes: Index, there: NDArray[np.bool_], shown: NDArray[np.bool_]) -> int:
    """Return how many holes that should be seen are not; a whole row, or column, of them is one mistake."""
    gone, rows = there & ~shown, 0
    for axis in (0, 1):
        for k in np.unique(holes[gone, axis]).tolist():
            own = there & (holes[:, axis] == k)
            if own.sum() > 1 and not (own & shown).any():
                gone, rows = gone & ~own, rows + 1
    return int(gone.sum()) + rows
