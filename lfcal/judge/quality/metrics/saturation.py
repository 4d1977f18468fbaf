"""Saturated pixels: counted when the frames were read, or else suspected from the values."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.judge.quality.measure import PlaneMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]

LIMITS = Limits(good=2, bad=10)

NEAR_TOP, RAREST = 0.85, 1.05
"""Fraction of the highest value above which values are counted, and the smallest ratio of this count to the count of
saturated pixels that is used. The ratio shows how quickly values become rarer."""

FARTHEST = 0.35
"""Largest fraction of the top by which light exceeds it on average; exposures are rarely more wrong."""


def _saturation(plane: PlaneMeasures) -> Reading:
    saturated = plane.about.matrix.saturated
    # a negative number marks a position whose saturated pixels were not counted
    counts = None if saturated is None else np.asarray(saturated[plane.about.z], float)
    if counts is None or (counts < 0).all():
        return _suspected(plane)
    found = _counted(np.where(counts < 0, math.nan, counts))
    return replace(found, cost=_lost(plane, np.maximum(counts, 0)))


def _lost(plane: PlaneMeasures, counts: NDArray[np.float64]) -> float:
    """Return the light above the range of the sensor relative to the light of the plane (L2); NaN: unknown.

    Values near the top become exponentially rarer, and the same is assumed for values above it.
    """
    many = counts[counts > 0]
    power = float(plane.table.column("squares").sum())
    if not many.size or not power > 0:
        return math.nan
    top = float(np.median(plane.table.column("top")[counts > 0]))
    total = float(many.sum())
    near = float((plane.patterns >= NEAR_TOP * top).sum())
    step = (1 - NEAR_TOP) * top / math.log(max(near / total, RAREST)) if top > 0 else 0.0
    # for an exponential distribution above the top, the mean square is twice the square of its scale
    return math.sqrt(2 * total * min(step, FARTHEST * top) ** 2 / power)


def _counted(counts: NDArray[np.float64]) -> Reading:
    """Return the number of saturated pixels; unknown instead of good if some positions were not counted."""
    total, known = float(np.nansum(counts)), np.isfinite(counts)
    if known.all():
        return Reading(total, map=counts, positions=counts > 0)
    detail = f"counted at {known.sum()} of {counts.size} positions"
    value = math.nan if LIMITS.merit(total) == "good" else total
    return Reading(value, map=counts, positions=counts > 0, detail=detail)


def _suspected(plane: PlaneMeasures) -> Reading:
    """Return the number of pixels with the highest value of the plane; many such pixels indicate saturation.

    Corrections, rescaling and averaging hide clipping by the sensor. A small number is therefore unknown, and not good.
    """
    table, use = plane.table, plane.use
    if table.computed or plane.edges.cut_off or not use.any():  # also if the noise is unknown
        return UNKNOWN
    top = table.column("top")
    piled = np.where(top >= float(top[use].max()) - table.tolerance, table.column("clipped") - 1, 0.0)
    if LIMITS.merit(float(piled.sum())) == "good":
        return UNKNOWN
    words = "suspected from equal highest values, not counted"
    return Reading(float(piled.sum()), map=piled, positions=piled > 0, detail=words)


METRICS = (
    MetricSpec(
        key="saturation",
        title="Saturated pixels",
        subject="sensor",
        unit="pixels",
        limits=LIMITS,
        cost=CostModel(at_bad=0.03, worst=0.6),
        plot="map",
        meaning="Pixels at the upper limit of the sensor's range.",
        advice="Shorten the exposure or dim the lamp, and record again.",
        overall="sum",
        needs_all=True,
        redo=True,
        of_plane=_saturation,
    ),
)
