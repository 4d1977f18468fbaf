"""Simulation: error of omitted effects and of the computation together, versus time for the whole H."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfcal.accuracy.curves import CostPoint
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Subject, reference_seconds
from lfcal.base import format_length
from lfcal.camera import ScanPlan
from lfcal.simulate import Budget, PlaneResponse, budgeted, plan_effects
from lfcal.simulate.accuracy import cost_scaling, engine_clock, timed_plane

__all__ = ["PART", "TOLERANCES"]

TOLERANCES = (0.3, 0.15, 0.1, 0.06, 0.04, 0.03, 0.02, 0.01, 0.005)
"""Requested tolerances, from coarse to fine."""

FINEST = 0.01
"""The reference includes the effects that matter at this tolerance."""

FINE, FINE_SECONDS = 0.015, 40.0
"""Tolerance below which the reference method may be used if waves are not accurate enough, and its duration (s)."""

POSITION_SECONDS = 8.0
"""Time limit per compared position (s), for up to `MOST_POSITIONS` positions."""

MOST_POSITIONS = 4


def measure(subject: Subject, seconds: float) -> Measuring:
    """Yield the error of patterns simulated with each of `TOLERANCES`, and the predicted time for the whole H.

    The reference includes the effects that matter at the tolerance `FINEST`.
    """
    plan, z = subject.planned, subject.middle
    count = max(1, min(MOST_POSITIONS, int(seconds / POSITION_SECONDS)))
    positions = _positions(plan.period, count)
    every = plan_effects(plan, FINEST).at(plan.depths_um[z])
    each = reference_seconds(plan, z, FINEST / 2)
    yield AccuracyStep(f"reference at {count} position{'s' * (count > 1)}", each * len(positions))
    finest = PlaneResponse(plan, z, every, level="reference", tolerance=FINEST / 2)
    truth = []
    for position in positions:
        truth.append(_responses(finest, [position]))
        yield AccuracyStep(f"reference, position {position}")
    yield Truth(
        "the reference level with the effects that matter at 1 %: " + ", ".join(e.name for e in every),
        (f"{count} position{'s' * (count > 1)} of plane {z} (z = {format_length(plan.depths_um[z])})",),
    )
    true = np.concatenate(truth)
    for tolerance in TOLERANCES:
        yield AccuracyStep(f"tolerance {100 * tolerance:g} %", FINE_SECONDS if tolerance < FINE else None)
        yield _point(plan, z, tolerance, positions, true)


def _point(
    plan: ScanPlan, z: int, tolerance: float, positions: Sequence[tuple[int, int]], truth: NDArray[np.float64]
) -> CostPoint:
    found = plan_effects(plan, tolerance)
    budget = budgeted(found, plan, tolerance)
    # the computation may use the part of the tolerance that omitted effects leave
    chosen, share = budget.at(plan.depths_um[z])
    response = PlaneResponse(plan, z, chosen, tolerance=share)
    cost = _whole_seconds(plan, z, budget, response)
    values = _responses(response, positions)
    error = float(np.abs(values - truth).sum() / np.abs(truth).sum())
    settings = {
        "tolerance": tolerance,
        "level": response.level,
        "effects": [effect.name for effect in found.effects],
    }
    label = f"tolerance {100 * tolerance:g} %, {response.level}, {len(found.effects)} effects"
    return CostPoint(label, settings, error, cost, "seconds", {"requested error (%)": 100 * tolerance})


def _whole_seconds(plan: ScanPlan, z: int, budget: Budget, response: PlaneResponse) -> float:
    """Return the processor time (s) for the whole H: for the probe of each plane, the tables, and all positions."""
    start = engine_clock()
    response.engine()
    probe = engine_clock() - start
    shares = cost_scaling(plan, z, budget, response.level, response.runs)
    return plan.shape[0] * probe + shares.seconds(*timed_plane(response))


def _responses(response: PlaneResponse, positions: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
    return np.concatenate([response.rows([y], [x], 1)[0] for y, x in positions]).astype(np.float64)


def _positions(period: tuple[int, int], count: int) -> list[tuple[int, int]]:
    """Return positions spread over the period: equally spaced in rows, by the golden ratio in columns."""
    ny, nx = period
    return [(int(ny * (k + 0.5) / count), int(nx * ((k + 1) * 0.6180339887498949 % 1))) for k in range(count)]


PART = AccuracyPart(
    "simulation",
    "Simulation: effects and computation",
    "relative L1 error of the patterns, from omitted effects and from the computation",
    "processor time for H, predicted from the time of this computation",
    "seconds",
    measure,
    rank=10,
)
