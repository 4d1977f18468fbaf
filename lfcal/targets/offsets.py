"""Choose offsets of a target that show all phases with few frames: along lines, by search, or on a display."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, check_number, njit
from lfcal.targets.images import HoleImages, whole_at
from lfcal.targets.phases import Phases

__all__ = ["Covering", "covered_by", "iter_cover", "iter_whole_offsets", "line_offsets"]


@njit()
def add_squares(counts: NDArray[np.int32], corners: NDArray[np.int32], side: int, weight: int) -> None:
    """Add ``weight`` to squares in ``counts``, ``side`` cells wide, whose first cells (row, column) are ``corners``.

    Corners ``(n, 2)`` with a negative row are skipped.
    """
    for k in range(corners.shape[0]):
        row, column = corners[k, 0], corners[k, 1]
        if row < 0:
            continue
        for i in range(side):
            for j in range(side):
                counts[row + i, column + j] += weight


Array = NDArray[np.float64]
Index = NDArray[np.intp]

SIDE = 4
"""Number of search cells along each axis in which a hole shows a phase; steps are half the tolerance."""

TRIED = 16
"""Number of offsets evaluated exactly for each frame, in the order of an upper bound of their count."""


def covered_by(phases: Phases, images: HoleImages, offset_px: Array, tolerance_px: float) -> Index:
    """Return the row-major indices of the positions that a frame with the offset ``offset_px`` shows completely.

    The offset is (rows, columns) in pixels. Only images whose cutouts are completely on the sensor count; their phases
    may deviate by ``tolerance_px``.
    """
    plan = phases.plan
    pixels = images.moved(offset_px)
    return phases.covered(pixels[whole_at(pixels, plan.camera.sensor.shape, plan.cutout)], tolerance_px)


@dataclass(eq=False)
class OffsetSearch:
    """A grid of offsets over one period, with an upper limit for the number of missing phases that each offset shows.

    Each count is the number of pairs of a hole and a missing phase, and therefore an upper limit: several holes may
    show the same phase. The best offsets are evaluated exactly.

    Attributes
    ----------
    phases, images, tolerance_px
        As in `lfcal.targets.offsets.iter_cover`.
    step, first
        Step of the grid, and its first offset (rows, columns) (pixels).
    corner
        First cell of the grid ``(phases, holes, 2)`` in which a hole shows a phase; -1 if its cutout would not be
        completely on the sensor.
    counts
        Number of pairs that each offset of the grid shows, ``(rows, columns)``.
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
        """Return a new search in which all phases are missing."""
        step = 2 * tolerance_px / SIDE
        asked = asked_offsets(phases, images)
        # slightly more than half a period, so that its ends can be reached from either side
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
        """Remove the positions that have been shown, given by their row-major indices, from the counts."""
        self._add(positions, -1)

    def best(self, missing: NDArray[np.bool_]) -> tuple[Array, Index]:
        """Return the offset (rows, columns; pixels) that shows the most missing positions, and the indices of these.

        ``missing`` is a mask of the positions ``(phases,)``. Only the offsets with the highest counts, at most `TRIED`,
        are compared.
        """
        flat = self.counts.reshape(-1)
        best, shown, left = np.zeros(2), np.zeros(0, np.intp), TRIED
        level = int(flat.max())
        while level > len(shown) and left:
            cells = np.flatnonzero(flat == level)
            # adjacent cells give nearly the same frame, so take cells from everywhere
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
    """Return the offsets ``(phases, holes, 2)`` (pixels) with which each hole shows each phase, to first order.

    Each offset changes the phase by at most half a period.
    """
    rates = phases.rates(images.pixels) * images.shift[:, None, None]
    away = phases.wanted()[:, None, :] - phases.at(images.pixels)[None]
    away -= phases.period * np.round(away / phases.period)
    asked: Array = np.einsum("nij,pnj->pni", np.linalg.inv(rates), away)
    return asked


def line_offsets(at: Array, count: int, length: float, tolerance_px: float) -> tuple[Array, bool]:
    """Return offsets along one axis (pixels), chosen greedily, and whether they show all phases.

    Parameters
    ----------
    at
        Phases of the images ``(n,)`` without an offset (pixels).
    count, length
        Number of phases to show (0, 1, …, count - 1), and length of the period (pixels).
    tolerance_px
        Largest deviation of a phase (pixels).
    """
    asked = np.arange(count)[:, None] - at
    asked -= length * np.round(asked / length)
    near = [asked.ravel() + share * tolerance_px for share in (-0.9, -0.45, 0.0, 0.45, 0.9)]
    candidates = np.unique(np.round(np.concatenate(near), 6))
    serves = np.zeros((len(candidates), count), np.bool_)
    # a phase is reached directly, or one period further up or down
    for turn in (-1, 0, 1):
        moved = candidates[:, None] + at - turn * length
        nearest = np.round(moved)
        good = (np.abs(moved - nearest) <= tolerance_px) & (nearest >= 0) & (nearest < count)
        which, hole = np.nonzero(good)
        serves[which, nearest[which, hole].astype(np.intp)] = True
    found: list[float] = []
    missing = np.ones(count, np.bool_)
    while missing.any():
        gain = serves @ missing.astype(np.float32)
        # of equal ones, the shortest move
        best = int(np.lexsort((np.abs(candidates), -1.0 * gain))[0])
        if not gain[best]:
            break
        found.append(float(candidates[best]))
        missing &= ~serves[best]
    return np.array(found), not missing.any()


GOOD = 1.6
"""Number of frames, relative to the fewest possible, up to which both axes are not searched together."""

FINEST_PX = 0.01
"""Smallest tolerance (pixels): stages are not better, and the search table grows with its inverse square."""


@dataclass(frozen=True, eq=False)
class Covering:
    """Offsets of a target, and the positions that they show.

    Attributes
    ----------
    offsets_px
        Displacement of the images in the depth plane, ``(frames, 2)`` as (rows, columns) (pixels).
    shown
        Number of positions ``(frames,)`` that each frame shows and no earlier frame does.
    wanted
        Number of positions of the scan.
    """

    offsets_px: Array
    shown: NDArray[np.intp]
    wanted: int

    @property
    def coverage(self) -> float:
        """Fraction of the positions that are shown."""
        return float(self.shown.sum()) / self.wanted

    def first(self, most: int | None) -> Covering:
        """Return the covering by the first ``most`` frames. None: by all frames."""
        return Covering(self.offsets_px[:most], self.shown[:most], self.wanted)


def iter_cover(phases: Phases, images: HoleImages, tolerance_px: float, *, most: int | None = None) -> Work[Covering]:
    """Return a `Covering` of few offsets, within one period, with which a target shows as many phases as possible.

    If all columns have the same row phases, and all rows the same column phases, the axes are separable. All
    combinations of a few row offsets and column offsets then show all phases. Otherwise, or if this requires many
    frames or leaves phases missing, both axes are searched together. Each new frame is then the one that shows most of
    the missing phases among those tried. Exact greedy covering takes at most 1 + ln(n) times the fewest sets (V.
    Chvatal, "A greedy heuristic for the set-covering problem", 1979).

    Parameters
    ----------
    phases, images
        The scan, and the images of the target without an offset.
    tolerance_px
        Largest deviation of a phase in rows and in columns (pixels).
    most
        Largest number of frames. None: no limit.
    """
    check_number("tolerance of a phase (px)", tolerance_px, at_least=FINEST_PX, at_most=0.5)
    if most is not None:
        check_number("largest number of frames", most, at_least=1, integer=True)
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
    """Return all pairs of row and column offsets, both found separately; None if the axes depend on each other."""
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
    """Return the ``offsets`` that show new positions, and the number of new positions of each."""
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


F8 = NDArray[np.float64]

LOOKED_AT = 8
"""Number of offsets evaluated exactly for each frame: those with the most pairs of a hole and a missing phase."""


def iter_whole_offsets(
    phases: Phases, images: HoleImages, tolerance_px: float, unit_px: float, most: int | None = None
) -> Work[NDArray[np.intp]]:
    """Return offsets ``(frames, 2)`` in display pixels that together show as many phases as possible.

    Each is chosen to show as many missing phases as possible. The search ends when no further phase can be shown.

    Parameters
    ----------
    phases, images
        The scan, and the images of the target without an offset.
    tolerance_px
        Largest deviation of a phase in rows and in columns (pixels).
    unit_px
        Pitch of the display's pixels in the image (sensor pixels).
    most
        Largest number of frames. None: no limit.
    """
    asked = asked_offsets(phases, images)
    cells = np.rint(asked / unit_px).astype(np.intp)
    plan = phases.plan
    pixels = images.pixels + images.shift[:, None] * asked
    served = (np.abs(cells * unit_px - asked) <= tolerance_px).all(-1)
    served &= whole_at(pixels, plan.camera.sensor.shape, plan.cutout)
    low = cells.min(axis=(0, 1))
    size = cells.max(axis=(0, 1)) - low + 1
    flat = np.where(served, (cells[..., 0] - low[0]) * size[1] + cells[..., 1] - low[1], -1)
    missing, found = np.ones(phases.count, np.bool_), list[NDArray[np.intp]]()
    clock = Clock("offsets of the display", phases.count)
    yield clock.at(0)
    while missing.any() and (most is None or len(found) < most):
        left = flat[missing]
        counts = np.bincount(left[left >= 0], minlength=int(size.prod()))
        best, shown = None, np.zeros(0, np.intp)
        for cell in np.argsort(-counts, kind="stable")[:LOOKED_AT].tolist():
            if counts[cell] <= len(shown):
                break
            at = np.array(divmod(cell, int(size[1])), np.intp) + low
            covered = covered_by(phases, images, at * unit_px, tolerance_px)
            new = covered[missing[covered]]
            if len(new) > len(shown):
                best, shown = at, new
        if best is None:
            break
        missing[shown] = False
        found.append(best)
        yield clock.at(int((~missing).sum()))
    return np.array(found, np.intp).reshape(-1, 2)
