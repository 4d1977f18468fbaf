"""Positions of the patterns of a plane, from the phase of the lenslet lattice and from their centroids."""

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
"""Fraction of jumping phases above which they do not give positions."""

MISPLACED = 0.5
"""Displacement of a pattern above which its frame is misplaced (pixels)."""


@dataclass(frozen=True, slots=True, eq=False)
class LatticePhases:
    """Displacement of the patterns' lattice from its expected position at each position.

    Attributes
    ----------
    rms
        Scatter of correctly placed frames (pixels); NaN if there are none.
    pitch
        Drift of the lattice over the cell (pixels).
    shift, away
        Displacement, and its part that changes from position to position, ``(ny, nx)`` (pixels).
    wrong
        Misplaced frames, ``(ny, nx)``.
    """

    rms: float
    pitch: float
    shift: NDArray[np.float64]
    away: NDArray[np.float64]
    wrong: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class CentroidPath:
    """Motion of the patterns' centroids over the cell.

    Attributes
    ----------
    jitter
        Scatter about the path, without noise and backlash (px rms); NaN if no frame is in place.
    backlash
        Half the offset between even and odd rows (pixels).
    gain, drift
        Change over the cell along the axis of the scan, and across it (pixels).
    distance, away
        Distance from the median position, and from the smooth path, ``(ny, nx)`` (pixels).
    wrong
        Misplaced frames, ``(ny, nx)``.
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
    """Source positions measured from the patterns; None if they cannot be measured.

    Attributes
    ----------
    spots
        The spots' lattice, if positions can be measured from it.
    locked
        Whether each pattern is the image of a single lenslet, which does not follow the source.
    phases, path
        Positions from the lattice's phases, and from the centroids.
    misplaced
        Used frames that are misplaced by either measure, ``(ny, nx)``.
    turned
        Orientation of the frames for which the image moves as planned.
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
        Number of threads. None: all processors.
    cut_off
        Whether the cutouts contain only a part of the patterns, so that their centroids do not follow the source.
    """
    turned = turned_frames(table, use)
    if turned != AS_IS:
        # steps, drifts and positions in the wrong direction would only report the same fault again
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
    """Return the fraction of neighbours along x whose displacements differ by more than a quarter of the pitch.

    Faults shift frames by a few pixels at most, or few frames by more; phases that jump everywhere are no phases.
    """
    # neighbours along x were recorded one after the other, and a real fault moves few of them so far
    both = use[:, 1:] & use[:, :-1]
    pitch = 2 * math.pi / float(np.hypot(*spots.waves[0]))
    jump = np.hypot(*np.diff(shift, axis=2)) > pitch / 4
    return float(jump[both].mean()) if both.any() else 1.0


def _path(table: PatternTable, use: NDArray[np.bool_]) -> CentroidPath:
    row, column = table.column("row"), table.column("column")
    move = [split(row, use), split(column, use)]
    # error of a centroid from the noise of the lit pixels alone
    noise = table.dark.noise * np.sqrt(table.column("spread")[use]) / table.column("weight")[use]
    away = np.hypot(move[0].residual, move[1].residual)
    swing = max(part.alternation for part in move)
    wrong = _misplaced(away, move)
    placed, jitter = use & ~wrong, math.nan
    if placed.any():
        rms = math.hypot(*(float(np.sqrt(np.mean(p.residual[placed] ** 2))) for p in move))
        # scatter adds in squares, so noise and backlash are subtracted in squares
        jitter = math.sqrt(max(0.0, rms**2 - float(np.mean(noise**2)) - swing**2))
    return CentroidPath(
        jitter,
        swing,
        # a ramp of the centroid along its own axis is a wrong step; across it, it is drift
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
    """Return the positions that are off by more than `MISPLACED`, and by more than the typical scatter explains."""
    wrong: NDArray[np.bool_] = away > max(MISPLACED, 8 * math.hypot(*(p.spread for p in parts)))
    return wrong
