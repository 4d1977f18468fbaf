"""Estimates of effects plane by plane: by formula where it can be trusted, by running the effect where it cannot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

from lfcal.camera import ScanPlan
from lfcal.simulate.accuracy._influence import Influence
from lfcal.simulate.effects import Effect, Estimate, ExactAngles, Outlook

__all__ = ["estimates_of"]

MAX_PLANES = 5
"""Planes at which effects are run; between them what was measured is interpolated."""

RUN = "run with it and without at a few positions"
"""What an estimate that was measured says of its formula."""

CACHED = 4096
"""Measurements kept: a plan is judged again at every turn of a slider, and its measurements stay the same."""


def estimates_of(
    effects: Sequence[Effect], counting: Sequence[Effect], planes: Sequence[Outlook], plan: ScanPlan
) -> list[list[Estimate]]:
    """Return the estimate of every effect at every plane.

    Parameters
    ----------
    effects
        The effects to estimate.
    counting
        Those that act on this camera: they alone are run, beside each other.
    planes
        The depth planes.
    plan
        The plan whose planes they are.
    """
    found = [[effect.estimate(outlook) for outlook in planes] for effect in effects]
    counted = tuple(e for e in counting if e.acts_on.enters_h and not _is_run_without(e, planes))
    names = {effect.name for effect in counted}
    run = measured if _hashable(plan, counted) else measured.__wrapped__
    for effect, row in zip(effects, found, strict=True):
        doubtful = [k for k, outlook in enumerate(planes) if not effect.holds(outlook)]
        if effect.name not in names or not doubtful:
            continue
        known = {k: value for k in _evenly_spaced(doubtful) if (value := run(plan, k, counted, effect)) is not None}
        for k in doubtful if known else ():
            row[k] = replace(row[k], error=_between(k, known), formula=RUN, measured=True)
    return found


def _is_run_without(effect: Effect, planes: Sequence[Outlook]) -> bool:
    """Return whether others are run without it: it takes them off a microscope's quick path, and changes little."""
    return isinstance(effect, ExactAngles) and not planes[0].has_lens and all(map(effect.holds, planes))


def _hashable(*values: object) -> bool:
    """Return whether measurements can be kept under these: effects of other distributions may hold arrays."""
    try:
        hash(values)
    except TypeError:
        return False
    return True


def _evenly_spaced(numbers: Sequence[int]) -> list[int]:
    """Return up to `MAX_PLANES` of the numbers, the first and the last among them."""
    if len(numbers) <= MAX_PLANES:
        return list(numbers)
    step = (len(numbers) - 1) / (MAX_PLANES - 1)
    return [numbers[round(k * step)] for k in range(MAX_PLANES)]


def _between(plane: int, known: dict[int, float]) -> float:
    """Return the error at a plane between those measured: errors span decades, so their logarithm is interpolated."""
    below = max((k for k in known if k <= plane), default=min(known))
    above = min((k for k in known if k >= plane), default=max(known))
    if below == above:
        return known[below]
    share = (plane - below) / (above - below)
    low, high = (max(known[k], 1e-9) for k in (below, above))
    return math.exp((1 - share) * math.log(low) + share * math.log(high))


@lru_cache(maxsize=CACHED)
def measured(plan: ScanPlan, z: int, counting: tuple[Effect, ...], effect: Effect) -> float | None:
    """Return what leaving an effect out costs at a plane, or None where it cannot be run."""
    made = influence if _hashable(plan, counting) else influence.__wrapped__
    return made(plan, z, counting).of(effect)


@lru_cache(maxsize=2)
def influence(plan: ScanPlan, z: int, counting: tuple[Effect, ...]) -> Influence:
    """Return what measures a plane; its undisturbed responses are shared by the effects asked for."""
    return Influence(plan, z, counting)
