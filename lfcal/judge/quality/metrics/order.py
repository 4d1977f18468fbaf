"""Metrics of whether frames and scan have the planned orientation, and of the order in which frames were recorded."""

from __future__ import annotations

from lfcal.frames import AS_IS
from lfcal.judge.quality._lattice import ORDERS
from lfcal.judge.quality.measure import PlaneMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading
from lfcal.psf import either_words

__all__ = ["METRICS"]


def _scan_order(plane: PlaneMeasures) -> Reading:
    turned, spots = plane.positions.turned, plane.positions.spots
    if turned != AS_IS:
        return Reading(1.0, detail=either_words(turned))
    # spots of a mirrored array also move as planned
    if spots is None or spots.order == "as planned":
        return UNKNOWN
    return Reading(1.0, detail=ORDERS[spots.order])


def _misplaced(plane: PlaneMeasures) -> Reading:
    found = plane.positions
    if found.misplaced is None:
        return UNKNOWN
    away = None if found.phases is None else found.phases.away
    return Reading(float(found.misplaced.sum()), map=away, positions=found.misplaced)


METRICS = (
    MetricSpec(
        key="scan_order",
        title="Orientation of frames",
        subject="frames",
        unit="planes",
        limits=Limits(good=0, bad=0),
        cost=CostModel(at_bad=3.6, worst=3.6),
        plot="map",
        meaning=(
            "Planes in which the direction of the image, or the order of the spots on the lattice, "
            "contradicts the positions."
        ),
        advice=(
            "Assemble again with the frames turned upright (--orientation auto), or correct the axes of "
            "the scan. No new recording is needed."
        ),
        overall="sum",
        verdict_detail=True,
        if_unknown="no camera confirms it",
        of_plane=_scan_order,
    ),
    MetricSpec(
        key="misplaced",
        title="Misplaced frames",
        subject="frames",
        unit="frames",
        limits=Limits(good=0, bad=0),
        cost=CostModel(at_bad=0.6, worst=2.0, per_frame=True),
        plot="map",
        map_unit="px",
        meaning="Positions whose pattern belongs to a point at least half a pixel away.",
        advice="Record these positions again; whole rows or columns indicate swapped files or a lost stage step.",
        overall="sum",
        redo=True,
        of_plane=_misplaced,
    ),
)
