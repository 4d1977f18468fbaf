"""Saturated pixels: as counted when the frames were read, else suspected from the values."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.quality.measure import PlaneMeasures
from lfcal.psf.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]

LIMITS = Limits(good=2, bad=10)


def _saturation(plane: PlaneMeasures) -> Reading:
    saturated = plane.about.matrix.saturated
    # below zero marks a position whose saturated pixels were not counted
    counts = None if saturated is None else np.asarray(saturated[plane.about.z], float)
    if counts is None or (counts < 0).all():
        return _suspected(plane)
    return _counted(np.where(counts < 0, math.nan, counts))


def _counted(counts: NDArray[np.float64]) -> Reading:
    """Return what was counted; zero only where every position was."""
    total, known = float(np.nansum(counts)), np.isfinite(counts)
    if known.all():
        return Reading(total, map=counts, positions=counts > 0)
    detail = f"counted at {known.sum()} of {counts.size} positions"
    value = math.nan if LIMITS.merit(total) == "good" else total
    return Reading(value, map=counts, positions=counts > 0, detail=detail)


def _suspected(plane: PlaneMeasures) -> Reading:
    """Return pixels that share the highest value of the plane: many are a sign of saturation, few of nothing.

    Corrections, rescaling and averaging hide what the sensor clipped, so that none is never "no saturation".
    """
    table, use = plane.table, plane.use
    if table.computed or plane.edges.cut_off or not use.any():  # or how much noise there is, is not known
        return UNKNOWN
    top = table.column("top")
    piled = np.where(top >= float(top[use].max()) - table.tolerance, table.column("clipped") - 1, 0.0)
    if LIMITS.merit(float(piled.sum())) == "good":
        return UNKNOWN
    words = "suspected from equal highest values; not counted"
    return Reading(float(piled.sum()), map=piled, positions=piled > 0, detail=words)


METRICS = (
    MetricSpec(
        key="saturation",
        title="Saturated pixels",
        unit="pixels",
        limits=LIMITS,
        cost=CostModel(at_bad=0.03, worst=0.6),
        plot="map",
        meaning="Pixels at the top of the sensor's range.",
        advice="Shorten the exposure or dim the lamp, and record again.",
        overall="sum",
        needs_all=True,
        redo=True,
        of_plane=_saturation,
    ),
)
