"""A plane of H as few patterns that stand for those between, and the entries where that is not enough.

What changes slowly from source to source, the weak light around each lenslet's spot, holds most entries of H and
little of its light: it is interpolated between nodes. Spots are not, and are kept entry by entry.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import for_each_chunk
from lfcal.reconstruct.projectors._nodes import Nodes
from lfcal.reconstruct.projectors._reduction_kernels import Corners, left_over

__all__ = ["SPACINGS", "Reduction", "quickest_spacing", "reduce_plane", "relative_work", "sampled_share"]

Array = NDArray[Any]

SPACINGS = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 11.0)
"""Distances of nodes (positions) that are tried."""

NODE_WORK, ENTRY_WORK = 1.2, 2.0
"""Work on a node's pattern and on a single entry beside those of a plane that is projected whole (measured)."""


@dataclass(frozen=True)
class Reduction:
    """A plane of H within a tolerance: interpolated from ``patterns``, plus ``rest``.

    Attributes
    ----------
    nodes
        Where the patterns belong.
    patterns
        ``(my, mx, nt, ns)``.
    rest
        ``(ny, nx, nt + 2 my, ns + 2 mx)``, zero for what is left out; margins hold what nodes bring beside a cutout.
    kept
        Entries of ``rest`` that are not left out.
    error
        ``(ny, nx)``: the sum of the sizes that each position lacks, as a share of its own.
    """

    nodes: Nodes
    patterns: Array
    rest: Array
    kept: int
    error: NDArray[np.float64]

    def plane(self) -> Array:
        """Return the plane that this stands for, ``(ny, nx, nt + 2 my, ns + 2 mx)``."""
        (nt, ns), rest = self.patterns.shape[2:], self.rest
        flat, nothing = self.patterns.reshape(-1, nt, ns), np.zeros((nt, ns), rest.dtype)
        out = np.empty_like(rest)
        for y, x in np.ndindex(*rest.shape[:2]):
            # beside nothing there is minus what is interpolated
            left_over(nothing, flat, _corners(self.nodes, y, x), 0.0, out[y, x])
        return rest - out


def reduce_plane(plane: Array, spacing: float, tolerance: float, workers: int | None = None) -> Reduction:
    """Return ``plane`` ``(ny, nx, nt, ns)`` within ``tolerance``, nodes ``spacing`` positions apart.

    The sum of the sizes that a position lacks is at most ``tolerance`` times that of its pattern.
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
                found = left_over(plane[y, x], flat, _corners(nodes, y, x), tolerance, rest[y, x])
                kept, error[y, x] = kept + found[0], found[1]
        return kept

    return Reduction(nodes, patterns, rest, sum(for_each_chunk(work, plane.shape[0], workers)), error)


def relative_work(spacing: float, kept: float) -> float:
    """Return the work of one projection beside that of the whole plane, with a share ``kept`` of its entries."""
    return 1.0 if spacing == 1 else NODE_WORK / spacing**2 + ENTRY_WORK * kept


def quickest_spacing(kept: Mapping[float, float], work: Callable[[float, float], float] = relative_work) -> float:
    """Return the spacing of least work, by the share of entries kept of each; 1, the plane as it is, where none helps.

    By counts alone, not by times: what is projected is the same on every machine and each time.
    """
    return min((1.0, *kept), key=lambda spacing: work(spacing, kept.get(spacing, 1.0)))


def sampled_share(
    pattern: Callable[[int, int], Array], period: tuple[int, int], spacing: float, tolerance: float, samples: int = 16
) -> float:
    """Return about the share of entries that a reduced plane keeps, from ``samples`` positions.

    ``pattern`` (y, x) gives a position's pattern ``(nt, ns)``.
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
        kept += left_over(own, about, corners._replace(which=np.arange(len(about))), tolerance, rest)[0]
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
