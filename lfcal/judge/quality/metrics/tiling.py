"""Metrics of whether the recorded cell represents the whole field."""

from __future__ import annotations

from lfcal.judge.quality.across import MatrixMeasures
from lfcal.judge.quality.measure import PlaneMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]


def _period(h: MatrixMeasures) -> tuple[Reading]:
    """Return the difference between the recorded period and the nearest multiple of the lattice period (pixels)."""
    if h.matrix.camera is None or not h.matrix.camera.has_lattice:
        return (UNKNOWN,)
    errors = []
    for recorded, known, scale in zip(h.matrix.period, h.matrix.camera.period_px, h.matrix.pixel_scale, strict=True):
        lattice = known * scale
        errors.append(abs(recorded - max(1, round(recorded / lattice)) * lattice))
    return (Reading(max(errors)),)


def _tiling(plane: PlaneMeasures) -> Reading:
    found = plane.about.tiling
    if found is None:
        return UNKNOWN
    y, x = found.fitting_period
    detail = f"plane {plane.about.z}: a period of {y:.2f} x {x:.2f} px fits best"
    return Reading(100 * float(found.difference.max()), detail=detail)


METRICS = (
    MetricSpec(
        key="period",
        title="Period",
        subject="optics",
        unit="px",
        limits=Limits(good=0.25, bad=0.5),
        cost=CostModel(at_bad=0.5, worst=2.0),
        meaning="Difference between the recorded period and the period of the camera's lattice.",
        advice="Record a whole number of lattice periods; a plan of this camera states the number of positions.",
        of_matrix=_period,
    ),
    MetricSpec(
        key="tiling",
        title="Tiling over the field",
        subject="optics",
        unit="%",
        limits=Limits(good=5.0, bad=15.0),
        cost=CostModel(at_bad=0.1, worst=1.0),
        plot="map",
        meaning=(
            "Largest difference between control frames, which are whole periods away, and the same "
            "position of the period."
        ),
        advice=(
            "Use the period that fits the whole field best, resample the frames to it, or calibrate separate regions."
        ),
        needs_light=False,
        of_plane=_tiling,
    ),
)
