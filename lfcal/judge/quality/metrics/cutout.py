"""Metrics of the cutout: whether it contains the whole pattern, centred."""

from __future__ import annotations

from lfcal.judge.quality._sums import off_centre
from lfcal.judge.quality.measure import PlaneMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]


def _truncation(plane: PlaneMeasures) -> Reading:
    return Reading(plane.edges.truncation)


def _centring(plane: PlaneMeasures) -> Reading:
    if plane.edges.cut_off:  # the middle of the visible part is not that of the aperture
        return UNKNOWN
    shown = plane.about.depth_sum - plane.faulty.missing.size * plane.dark.background
    return Reading(off_centre(shown, plane.about.aperture))


METRICS = (
    MetricSpec(
        key="truncation",
        title="Light at the edge",
        subject="cutout",
        unit="% of plateau",
        limits=Limits(good=1.0, bad=5.0),
        cost=CostModel(at_bad=0.16, worst=1.0),
        plot="sum",
        meaning="Light at the edge of the cutout, relative to the light in the middle of the depth-plane sum.",
        advice="Assemble again with a larger cutout.",
        of_plane=_truncation,
        needs_centre=True,
    ),
    MetricSpec(
        key="centring",
        title="Centring",
        subject="cutout",
        unit="px",
        limits=Limits(good=3.0, bad=8.0),
        cost=CostModel(at_bad=0.02, worst=0.3),
        plot="sum",
        meaning="Distance of the centre of the aperture from the centre of the cutout.",
        advice="Assemble again with the anchor moved by this distance.",
        of_plane=_centring,
        needs_centre=True,
    ),
)
