"""Where the patterns of a plane are: by the phase of the lenslet lattice, and by their centroids."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.quality import sums
from lfcal.psf.quality.field import Parts, split
from lfcal.psf.quality.frames import Frames, PlaneMeasures
from lfcal.psf.quality.lattice import ORDERS, SpotLattice, displacements, find_spots

__all__ = ["measure_positions"]

WILD = 0.1
"""Share of jumping phases beyond which they tell no positions."""

MISPLACED = 0.5
"""Displacement of a frame's pattern that is too much (pixels)."""


def measure_positions(
    measures: PlaneMeasures,
    plane: NDArray[np.float32],
    frames: Frames,
    depth_sum: NDArray[np.float64],
    waves: NDArray[np.float64],
    use: NDArray[np.bool_],
    workers: int | None = None,
) -> None:
    """Add scan order, position errors and stage errors to the measures of a plane.

    Parameters
    ----------
    measures
        Of the plane; missing frames and the like are in it already.
    plane, frames
        Patterns ``(ny, nx, nt, ns)`` and their table.
    depth_sum
        Their sum ``(nt, ns)``.
    waves
        Wave vectors of the lenslet lattice.
    use
        Positions to use ``(ny, nx)``.
    workers
        Threads.
    """
    diameter = sums.diameter(depth_sum - use.size * measures.dark.background)
    spots = find_spots(plane, use, frames.floor, waves, diameter, workers)
    if spots is None:
        return
    wrong = np.zeros_like(use)
    if spots.usable:
        measures.spots = spots
        measures.values["scan_order"] = float(spots.order != "as planned")
        measures.details["scan_order"] = ORDERS[spots.order]
        if spots.order == "as planned":
            shift = displacements(plane, spots, frames.floor, workers)
            if _wild(shift, spots, use) < WILD:
                wrong |= _phases(measures, shift, use)
    if spots.steady:
        wrong |= _centroids(measures, frames, use)
    else:
        measures.locked = True
    if spots.usable or spots.steady:
        measures.named["misplaced"] = wrong & use
        measures.values["misplaced"] = float(measures.named["misplaced"].sum())


def _wild(shift: NDArray[np.float64], spots: SpotLattice, use: NDArray[np.bool_]) -> float:
    """Return the share of neighbours along x whose displacements differ by more than a quarter of the pitch.

    Faults shift frames by a few pixels at most, or few frames by more; phases that jump everywhere are no phases.
    """
    both = use[:, 1:] & use[:, :-1]
    pitch = 2 * math.pi / float(np.hypot(*spots.waves[0]))
    jump = np.hypot(*np.diff(shift, axis=2)) > pitch / 4
    return float(jump[both].mean()) if both.any() else 1.0


def _centroids(measures: PlaneMeasures, frames: Frames, use: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Measure how the patterns' centroids move; return which positions are misplaced by them."""
    values, maps = measures.values, measures.maps
    move = [split(frames.column(name), use) for name in ("row", "column")]
    noise = measures.dark.noise * np.sqrt(frames.column("spread")[use]) / frames.column("weight")[use]
    known = float(np.mean(noise**2))
    away = np.hypot(move[0].residual, move[1].residual)
    swing = max(part.alternation for part in move)
    values["backlash"] = swing
    values["stage_gain"] = max(move[0].sure_ramp(0), move[1].sure_ramp(1))
    values["drift"] = max(move[0].sure_ramp(1), move[1].sure_ramp(0))
    maps["jitter"] = maps["backlash"] = away
    path = np.hypot(*(frames.column(name) - np.median(frames.column(name)[use]) for name in ("row", "column")))
    maps["stage_gain"] = maps["drift"] = path
    wrong: NDArray[np.bool_] = away > max(MISPLACED, 8 * math.hypot(*(p.spread for p in move)))
    placed = use & ~wrong
    if placed.any():
        rms = math.hypot(*(float(np.sqrt(np.mean(p.residual[placed] ** 2))) for p in move))
        values["jitter"] = math.sqrt(max(0.0, rms**2 - known - swing**2))
    return wrong


def _phases(measures: PlaneMeasures, shift: NDArray[np.float64], use: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Measure the lattice's phases; return which positions are misplaced by them."""
    parts: list[Parts] = [split(s, use) for s in shift]
    away = np.hypot(parts[0].residual, parts[1].residual)
    wrong: NDArray[np.bool_] = away > max(MISPLACED, 8 * math.hypot(*(p.spread for p in parts)))
    placed = use & ~wrong
    if placed.any():
        measures.values["position"] = float(np.sqrt(np.mean(away[placed] ** 2)))
    measures.values["pitch"] = max(p.sure_ramp(axis) for p in parts for axis in (0, 1))
    measures.maps["position"] = measures.maps["misplaced"] = away
    measures.maps["pitch"] = np.hypot(*shift)
    return wrong
