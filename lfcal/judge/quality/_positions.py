"""Where the patterns of a plane are: by the phase of the lenslet lattice, and by their centroids."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.frames import AS_IS
from lfcal.judge.quality._field import Parts, split
from lfcal.judge.quality._lattice import SpotLattice, displacements, find_spots
from lfcal.judge.quality._turned import turned_frames
from lfcal.judge.quality.pattern_table import PatternTable

__all__ = ["CentroidPath", "LatticePhases", "Positions", "measure_positions"]

WILD = 0.1
"""Share of jumping phases beyond which they do not give positions."""

MISPLACED = 0.5
"""Displacement of a frame's pattern that is too much (pixels)."""


@dataclass(frozen=True, slots=True, eq=False)
class LatticePhases:
    """How far the patterns' lattice is from where each position says.

    Attributes
    ----------
    rms
        Scatter over the frames that are in place (pixels); NaN where there are none.
    pitch
        How far the lattice runs away over the cell (pixels).
    shift, away
        Displacement, and what of it changes from position to position, ``(ny, nx)`` (pixels).
    wrong
        Frames that are misplaced, ``(ny, nx)``.
    """

    rms: float
    pitch: float
    shift: NDArray[np.float64]
    away: NDArray[np.float64]
    wrong: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class CentroidPath:
    """How the patterns' centroids move over the cell.

    Attributes
    ----------
    jitter
        Scatter about the path, without noise and backlash (pixels rms); NaN where no frame is in place.
    backlash
        Half the offset between even and odd rows (pixels).
    gain, drift
        Change over the cell along the axis of the scan, and across it (pixels).
    distance, away
        Distance from the median place, and from the smooth path, ``(ny, nx)`` (pixels).
    wrong
        Frames that are misplaced, ``(ny, nx)``.
    """

    jitter: float
    backlash: float
    gain: float
    drift: float
    distance: NDArray[np.float64]
    away: NDArray[np.float64]
    wrong: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Positions:
    """The source's positions as measured from the patterns; None where they cannot be measured.

    Attributes
    ----------
    spots
        The spots' lattice, where positions can be measured from it.
    locked
        Whether each pattern is the image of a single lenslet, which does not follow the source.
    phases, path
        By the lattice's phases and by the centroids.
    misplaced
        Frames in use that are misplaced by either, ``(ny, nx)``.
    turned
        Orientation that the frames need for the image to move as planned.
    """

    spots: SpotLattice | None = None
    locked: bool = False
    phases: LatticePhases | None = None
    path: CentroidPath | None = None
    misplaced: NDArray[np.bool_] | None = None
    turned: str = AS_IS

    @property
    def as_planned(self) -> bool:
        """Whether the scan ran in the planned order, as far as is known."""
        return self.turned == AS_IS and (self.spots is None or self.spots.order == "as planned")


def measure_positions(
    patterns: NDArray[np.float32],
    table: PatternTable,
    use: NDArray[np.bool_],
    waves: NDArray[np.float64],
    diameter_px: float,
    workers: int | None = None,
    *,
    cut_off: bool = False,
) -> Positions:
    """Return the positions measured from a plane's patterns.

    Parameters
    ----------
    patterns, table
        Patterns ``(ny, nx, nt, ns)`` and their table.
    use
        Positions to use ``(ny, nx)``.
    waves
        Wave vectors of the lenslet lattice.
    diameter_px
        Diameter of the depth-plane sum (pixels).
    workers
        Threads.
    cut_off
        Whether the cutouts hold a part of the patterns alone: the centroid of that is not the source's.
    """
    turned = turned_frames(table, use)
    if turned != AS_IS:
        # steps, drifts and places measured against the wrong way would only tell of it again
        return Positions(turned=turned)
    spots = find_spots(patterns, use, table.floor, waves, diameter_px, workers)
    if spots is None:
        return Positions()
    phases = None
    # a lattice that does not follow the source does not show its position
    if spots.usable and spots.order == "as planned":
        shift = displacements(patterns, spots, table.floor, workers)
        if _wild(shift, spots, use) < WILD:
            phases = _phases(shift, use)
    path = _path(table, use) if spots.steady and not cut_off else None
    misplaced = None
    if phases is not None or path is not None or (spots.usable and not cut_off):
        wrong = [part.wrong for part in (phases, path) if part is not None]
        misplaced = use & np.logical_or.reduce([np.zeros_like(use), *wrong])
    return Positions(spots if spots.usable else None, not spots.steady, phases, path, misplaced)


def _wild(shift: NDArray[np.float64], spots: SpotLattice, use: NDArray[np.bool_]) -> float:
    """Return the share of neighbours along x whose displacements differ by more than a quarter of the pitch.

    Faults shift frames by a few pixels at most, or few frames by more; phases that jump everywhere are no phases.
    """
    # neighbours along x were recorded one after the other: a real fault moves few of them so far
    both = use[:, 1:] & use[:, :-1]
    pitch = 2 * math.pi / float(np.hypot(*spots.waves[0]))
    jump = np.hypot(*np.diff(shift, axis=2)) > pitch / 4
    return float(jump[both].mean()) if both.any() else 1.0


def _path(table: PatternTable, use: NDArray[np.bool_]) -> CentroidPath:
    row, column = table.column("row"), table.column("column")
    move = [split(row, use), split(column, use)]
    # what the noise of the lit pixels alone makes of a centroid
    noise = table.dark.noise * np.sqrt(table.column("spread")[use]) / table.column("weight")[use]
    away = np.hypot(move[0].residual, move[1].residual)
    swing = max(part.alternation for part in move)
    wrong = _misplaced(away, move)
    placed, jitter = use & ~wrong, math.nan
    if placed.any():
        rms = math.hypot(*(float(np.sqrt(np.mean(p.residual[placed] ** 2))) for p in move))
        # scatter adds in squares, so noise and backlash are taken off in squares
        jitter = math.sqrt(max(0.0, rms**2 - float(np.mean(noise**2)) - swing**2))
    return CentroidPath(
        jitter,
        swing,
        # along its own axis a centroid's ramp is a wrong step; across it, drift
        gain=max(move[0].sure_ramp(0), move[1].sure_ramp(1)),
        drift=max(move[0].sure_ramp(1), move[1].sure_ramp(0)),
        distance=np.hypot(row - np.median(row[use]), column - np.median(column[use])),
        away=away,
        wrong=wrong,
    )


def _phases(shift: NDArray[np.float64], use: NDArray[np.bool_]) -> LatticePhases:
    parts = [split(s, use) for s in shift]
    away = np.hypot(parts[0].residual, parts[1].residual)
    wrong = _misplaced(away, parts)
    placed = use & ~wrong
    rms = float(np.sqrt(np.mean(away[placed] ** 2))) if placed.any() else math.nan
    pitch = max(p.sure_ramp(axis) for p in parts for axis in (0, 1))
    return LatticePhases(rms, pitch, np.hypot(*shift), away, wrong)


def _misplaced(away: NDArray[np.float64], parts: list[Parts]) -> NDArray[np.bool_]:
    """Return what is away by more than `MISPLACED`, and by more than the usual scatter explains."""
    wrong: NDArray[np.bool_] = away > max(MISPLACED, 8 * math.hypot(*(p.spread for p in parts)))
    return wrong
