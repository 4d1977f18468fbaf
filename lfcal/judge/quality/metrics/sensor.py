"""Pixels of the sensor that do not follow the light."""

from __future__ import annotations

import numpy as np

from lfcal.judge.quality._sums import coverage, stuck_pixels
from lfcal.judge.quality.measure import PlaneMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]


def _stuck(plane: PlaneMeasures) -> Reading:
    table = plane.table
    # zeros of a model are not dead pixels, nor are those of only some patterns or of a single position
    if table.computed or plane.edges.cut_off or plane.faulty.missing.size == 1:
        return UNKNOWN
    period, cutout = plane.faulty.missing.shape, table.lit.shape
    # fixed in the cutout; or fixed on the sensor, and therefore moving through the cutouts
    found = stuck_pixels(table.lit, np.full(cutout, plane.faulty.missing.size))
    return Reading(float(found + stuck_pixels(table.sensor, coverage(period, cutout))))


METRICS = (
    MetricSpec(
        key="hot_pixels",
        title="Hot or dead pixels",
        subject="sensor",
        unit="pixels",
        limits=Limits(good=0, bad=0),
        cost=CostModel(at_bad=0.010, worst=0.3),
        plot="sum",
        meaning="Pixels that stay lit or dark at every position.",
        advice="Find the defective pixels of the sensor with dark and white frames, and assemble again.",
        overall="sum",
        of_plane=_stuck,
    ),
)
