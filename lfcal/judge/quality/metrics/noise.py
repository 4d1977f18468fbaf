"""Noise of dark pixels compared with the known noise of the sensor."""

from __future__ import annotations

from lfcal.judge.quality.measure import PlaneMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]


LIMITS = Limits(good=1.5, bad=3.0)


def _over_sensor(plane: PlaneMeasures) -> Reading:
    expected = plane.sensor_noise
    # frames that were computed without noise say nothing about a sensor
    if expected is None or plane.edges.cut_off or not plane.dark.noise > 0 or plane.table.computed:
        return UNKNOWN
    ratio = plane.dark.noise / expected
    if ratio >= 1:
        return Reading(ratio)
    words = "less noise than that of the sensor: frames were smoothed or averaged, or the gain of the camera is wrong"
    return Reading(1 / ratio, detail=words if ratio < 1 / LIMITS.good else "")


METRICS = (
    MetricSpec(
        key="noise",
        title="Noise relative to the sensor",
        subject="sensor",
        unit="x",
        limits=LIMITS,
        cost=CostModel(at_bad=0.02, worst=0.2),
        plot="planes",
        meaning="Noise of a dark pixel divided by the measured or stated noise of the sensor, or the reverse.",
        advice="Look for interference, stray light, a wrong dark frame or another gain; measure the sensor again.",
        of_plane=_over_sensor,
    ),
)
