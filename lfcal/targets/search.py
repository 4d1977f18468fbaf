"""A search among all offsets of a period for those that show most phases."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.targets._kernels import add_squares
from lfcal.targets.images import HoleImages, whole_at
from lfcal.targets.phases import Phases

__all__ = ["OffsetSearch", "asked_offsets", "covered_by"]

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SIDE = 4
"""Cells of the search in which a hole shows a phase, along each axis: steps of half the tolerance."""

TRIED = 16
"""Offsets that are looked at exactly for each frame, in the order of what they could show at most."""


def covered_by(phases: Phases, images: HoleImages, offset_px: Array, tolerance_px: float) -> Index:
    """Return the positions that one frame shows with whole cutouts, numbered row by row."""
    plan = phases.plan
    pixels = images.moved(offset_px)
    return phases.covered(pixels[whole_at(pixels, plan.camera.sensor.shape, plan.cutout)], tolerance_px)


@dataclass(eq=False)
class OffsetSearch:
    """A grid of offsets over one period, and how many pairs of a hole and a missing phase each of them serves.

    Several holes on one phase are counted each: a count is a limit, and the best of those are looked at exactly.

    Attributes
    ----------
    phases, images, tolerance_px
        As of `lfcal.targets._covering.iter_cover`.
    step, first
        Of the grid, and its first offset (rows, columns) (pixels).
    corner
        First cells ``(phases, holes, 2)`` of the grid that serve a pair; -1 where none does.
    counts
        Pairs that each offset of the grid serves.
    """

    phases: Phases
    images: HoleImages
    tolerance_px: float
    step: float
    first: Array
    corner: NDArray[np.int32]
    counts: NDArray[np.int32]

    @classmethod
    def of(cls, phases: Phases, images: HoleImages, tolerance_px: float) -> OffsetSearch:
        """Return the search when nothing has been shown."""
        step = 2 * tolerance_px / SIDE
        asked = asked_offsets(phases, images)
        # half a period and a little: what is asked at its very end is met from either side
        first = -(np.abs(asked).max(axis=(0, 1)) + 2 * tolerance_px)
        size = np.ceil(-2 * first / step).astype(int) + SIDE
        corner = np.ceil((asked - first - tolerance_px) / step).astype(np.int32)
        plan = phases.plan
        pixels = images.pixels + images.shift[:, None] * asked
        usable = whole_at(pixels, plan.camera.sensor.shape, plan.cutout)
        corner[~usable] = -1
        search = cls(phases, images, tolerance_px, step, first, corner, np.zeros(tuple(size), np.int32))
        search._add(np.arange(phases.count), 1)
        return search

    def _add(self, positions: Index, weight: int) -> None:
        add_squares(self.counts, self.corner[positions].reshape(-1, 2), SIDE, weight)

    def remove(self, positions: Index) -> None:
        """Count what was shown no more."""
        self._add(positions, -1)

    def best(self, missing: NDArray[np.bool_]) -> tuple[Array, Index]:
        """Return the offset that shows most of what is missing, and those positions."""
        flat = self.counts.reshape(-1)
        best, shown, left = np.zeros(2), np.zeros(0, np.intp), TRIED
        level = int(flat.max())
        while level > len(shown) and left:
            cells = np.flatnonzero(flat == level)
            # cells side by side are the same frame: some from all over
            chosen = cells[np.linspace(0, len(cells) - 1, min(left, len(cells))).astype(np.intp)]
            for cell in chosen.tolist():
                offset = np.array(divmod(cell, self.counts.shape[1])) * self.step + self.first
                found = covered_by(self.phases, self.images, offset, self.tolerance_px)
                new = found[missing[found]]
                left -= 1
                if len(new) > len(shown):
                    best, shown = offset, new
                if len(shown) >= level:
                    break
            level = int(flat.max(where=flat < level, initial=0))
        return best, shown


def asked_offsets(phases: Phases, images: HoleImages) -> Array:
    """Return the offset ``(phases, holes, 2)`` that puts each hole on each phase, within half a period either way."""
    rates = phases.rates(images.pixels) * images.shift[:, None, None]
    away = phases.wanted()[:, None, :] - phases.at(images.pixels)[None]
    away -= phases.period * np.round(away / phases.period)
    asked: Array = np.einsum("nij,pnj->pni", np.linalg.inv(rates), away)
    return asked
