"""Which offsets of a target show all phases with few frames."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, check_number
from lfcal.targets._lines import line_offsets
from lfcal.targets.images import HoleImages
from lfcal.targets.phases import Phases
from lfcal.targets.search import OffsetSearch, covered_by

__all__ = ["Covering", "iter_cover"]

Array = NDArray[np.float64]

GOOD = 1.6
"""Times the least number of frames that offsets of rows and columns may take without a search over both at once."""

FINEST_PX = 0.01
"""Least tolerance: stages and fitted positions are no better, and the search's table grows with its inverse square."""


@dataclass(frozen=True, eq=False)
class Covering:
    """Offsets of a target and what they show.

    Attributes
    ----------
    offsets_px
        How far images move from where they are without an offset, ``(frames, 2)`` as (rows, columns) of the plane.
    shown
        New positions that each frame shows ``(frames,)``.
    wanted
        Positions of the scan.
    """

    offsets_px: Array
    shown: NDArray[np.intp]
    wanted: int

    @property
    def coverage(self) -> float:
        """Share of the positions that is shown."""
        return float(self.shown.sum()) / self.wanted

    def first(self, most: int | None) -> Covering:
        """Return the covering by the first ``most`` frames; None: by all."""
        return Covering(self.offsets_px[:most], self.shown[:most], self.wanted)


def iter_cover(phases: Phases, images: HoleImages, tolerance_px: float, *, most: int | None = None) -> Work[Covering]:
    """Return offsets within one period that show every phase a target can show, with few frames.

    Where all columns have the same row phases, and all rows the same column phases, axes part: offsets of rows times
    offsets of columns cover the cell. Else, or where that takes many frames, both axes are searched at once: each frame
    is the one that shows most of what is missing. Greedy covering takes at most 1 + ln(n) times the fewest sets
    (V. Chvatal, "A greedy heuristic for the set-covering problem", 1979).

    Parameters
    ----------
    phases, images
        The scan, and the images of the target without an offset.
    tolerance_px
        How far off a phase may be, in rows and in columns.
    most
        End after so many frames.
    """
    check_number("tolerance of a phase (px)", tolerance_px, at_least=FINEST_PX, at_most=0.5)
    if most is not None:
        check_number("most frames", most, at_least=1, integer=True)
    lines = _product(phases, images, tolerance_px)
    found = None if lines is None else _counted(phases, images, lines, tolerance_px).first(most)
    least = math.ceil(phases.count / max(1, len(images)))
    if found is not None and found.coverage == 1.0 and (len(found.shown) <= int(GOOD * least) or len(images) == 1):
        return found
    other = yield from _greedy(phases, images, tolerance_px, most)
    if found is None or (other.shown.sum(), -len(other.shown)) > (found.shown.sum(), -len(found.shown)):
        return other
    return found


def _greedy(phases: Phases, images: HoleImages, tolerance_px: float, most: int | None) -> Work[Covering]:
    clock = Clock("offsets of the target", phases.count)
    yield clock.at(0)
    search = OffsetSearch.of(phases, images, tolerance_px)
    missing = np.ones(phases.count, np.bool_)
    offsets: list[Array] = []
    shown: list[int] = []
    while missing.any() and (most is None or len(offsets) < most):
        offset, new = search.best(missing)
        if not len(new):
            break
        missing[new] = False
        search.remove(new)
        offsets.append(offset)
        shown.append(len(new))
        yield clock.at(int((~missing).sum()))
    return Covering(np.array(offsets).reshape(-1, 2), np.array(shown, np.intp), phases.count)


def _product(phases: Phases, images: HoleImages, tolerance_px: float) -> Array | None:
    """Return all pairs of offsets of rows and of columns that cover each axis alone; None where axes do not part."""
    at = phases.at(images.pixels)
    lines = []
    for axis in (0, 1):
        own = [at[images.holes[:, axis] == k, axis] for k in np.unique(images.holes[:, axis])]
        length = float(phases.period[axis])
        spread = max(float(np.abs((v - v[0] + length / 2) % length - length / 2).max()) for v in own)
        if spread > tolerance_px / 20:
            return None
        firsts = np.array([v[0] for v in own])
        lines.append(line_offsets(firsts, phases.plan.period[axis], length, 0.95 * tolerance_px)[0])
    rows, columns = np.meshgrid(lines[0], lines[1], indexing="ij")
    return np.stack([rows.ravel(), columns.ravel()], axis=-1)


def _counted(phases: Phases, images: HoleImages, offsets: Array, tolerance_px: float) -> Covering:
    """Return those of ``offsets`` that show anything new, and how much."""
    missing = np.ones(phases.count, np.bool_)
    kept, shown = [], []
    for offset in offsets:
        found = covered_by(phases, images, offset, tolerance_px)
        new = int(missing[found].sum())
        missing[found] = False
        if new:
            kept.append(offset)
            shown.append(new)
    return Covering(np.array(kept).reshape(-1, 2), np.array(shown, np.intp), phases.count)
