"""Sampling: error of the computation alone, level by level, versus time for the whole H."""

from __future__ import annotations

from dataclasses import replace

from lfcal.accuracy.curves import CostPoint
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Subject
from lfcal.base import plain
from lfcal.simulate import Sampling, iter_ladder, lattice_scene_for, plan_effects, resolve_level
from lfcal.simulate.accuracy import LadderRung, quick_steps

__all__ = ["PART"]

TOLERANCE = 0.03
"""The scene of all samplings includes the effects that matter at this tolerance."""

QUICK_SECONDS, QUICK = 60.0, Sampling(samples_per_px=6)
"""Time limit (s) below which the reference has this sampling; the finest grid may need a minute for a position."""

FIRST = 2
"""Number of samplings measured together at first, then one more each time; if stopped, the current set is lost."""


def measure(subject: Subject, seconds: float) -> Measuring:
    """Yield the error and time of the faster samplings of `lfcal.simulate.ladder`, for a position of the middle plane.

    The error is that of this position. The time is predicted for the whole H.
    """
    plan, z = subject.planned, subject.middle
    effects = plan_effects(plan, TOLERANCE).effects
    scene = lattice_scene_for(plan, z, effects)
    _, level = resolve_level(replace(scene, lenslet_diffraction=True, main_diffraction=True))
    samplings = quick_steps(scene, level)
    reference = QUICK if seconds < QUICK_SECONDS else None
    seen: set[str] = set()
    size = FIRST
    while samplings:
        part, samplings = samplings[:size], samplings[size:]
        size += 1
        yield AccuracyStep(f"{len(part)} samplings")
        found = yield from iter_ladder(
            plan, TOLERANCE, effects=effects, z=z, positions=1, samplings=part, reference=reference
        )
        if not seen:
            names = ", ".join(effect.name for effect in effects) or "none"
            yield Truth(found.reference, (f"one position of plane {z}; effects: {names}",))
        for rung in found.rungs:
            if rung.label not in seen:
                seen.add(rung.label)
                yield _point(rung)


def _point(rung: LadderRung) -> CostPoint:
    settings = {"level": rung.level, "sampling": plain(rung.sampling)}
    others = {"tables (s)": rung.setup_seconds, "position (s)": rung.position_seconds}
    return CostPoint(rung.label, settings, rung.error, rung.whole_seconds, "seconds", others)


PART = AccuracyPart(
    "sampling",
    "Simulation: level and sampling",
    "relative L1 error of the computation, with the same effects for all samplings",
    "processor time for H, predicted from the time of this computation",
    "seconds",
    measure,
    rank=20,
)
