"""Accuracy of the stage, from the phases of the lattice and the patterns' centroids."""

from __future__ import annotations

from lfcal.judge.quality.measure import PlaneMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]


def _gain(plane: PlaneMeasures) -> Reading:
    path = plane.positions.path
    return UNKNOWN if path is None else Reading(path.gain, map=path.distance)


def _drift(plane: PlaneMeasures) -> Reading:
    path = plane.positions.path
    return UNKNOWN if path is None else Reading(path.drift, map=path.distance)


def _jitter(plane: PlaneMeasures) -> Reading:
    path = plane.positions.path
    return UNKNOWN if path is None else Reading(path.jitter, map=path.away)


def _backlash(plane: PlaneMeasures) -> Reading:
    path = plane.positions.path
    return UNKNOWN if path is None else Reading(path.backlash, map=path.away)


def _position(plane: PlaneMeasures) -> Reading:
    phases = plane.positions.phases
    return UNKNOWN if phases is None else Reading(phases.rms, map=phases.away)


def _pitch(plane: PlaneMeasures) -> Reading:
    phases = plane.positions.phases
    return UNKNOWN if phases is None else Reading(phases.pitch, map=phases.shift)


METRICS = (
    MetricSpec(
        key="stage_gain",
        title="Stage step",
        subject="stage",
        unit="px",
        limits=Limits(good=0.35, bad=1.0),
        cost=CostModel(at_bad=0.4, worst=3.5),
        plot="map",
        map_unit="px",
        meaning="Change of the distance between source and cutout from the first position to the last.",
        advice=(
            "Correct the step of the stage (pixel size / magnification, with its sign) or the "
            "magnification, and record again."
        ),
        of_plane=_gain,
    ),
    MetricSpec(
        key="position",
        title="Position error",
        subject="stage",
        unit="px rms",
        limits=Limits(good=0.1, bad=0.3),
        cost=CostModel(at_bad=0.25, worst=1.5),
        plot="map",
        map_unit="px",
        always_shown=True,
        meaning="Scatter of the phase of the lenslet lattice about the value expected from the position.",
        advice="Check that frames belong to their positions, and that the stage settles before each exposure.",
        of_plane=_position,
    ),
    MetricSpec(
        key="jitter",
        title="Stage jitter",
        subject="stage",
        unit="px rms",
        limits=Limits(good=0.15, bad=0.35),
        cost=CostModel(at_bad=0.17, worst=1.0),
        plot="map",
        map_unit="px",
        always_shown=True,
        meaning="Scatter of the source about its path, measured from the centroids of the patterns.",
        advice="Let the stage settle longer, approach positions from one side, or stiffen the mount.",
        of_plane=_jitter,
    ),
    MetricSpec(
        key="backlash",
        title="Backlash",
        subject="stage",
        unit="px",
        limits=Limits(good=0.1, bad=0.3),
        cost=CostModel(at_bad=0.17, worst=1.0),
        plot="map",
        meaning="Half the offset between even and odd rows: play of a stage that scans in both directions.",
        advice=(
            "Scan all rows in the same direction, or compensate the play of the stage (--overshoot). Then record again."
        ),
        of_plane=_backlash,
    ),
    MetricSpec(
        key="drift",
        title="Drift",
        subject="stage",
        unit="px",
        limits=Limits(good=0.5, bad=1.5),
        cost=CostModel(at_bad=0.2, worst=1.5),
        plot="map",
        map_unit="px",
        meaning="Drift of the source across its scan direction from the first row to the last.",
        advice=(
            "Let the lamp and the stage warm up, record faster, or align the axes of the stage with the "
            "rows of the sensor."
        ),
        of_plane=_drift,
    ),
    MetricSpec(
        key="pitch",
        title="Lattice pitch",
        subject="stage",
        unit="px",
        limits=Limits(good=0.5, bad=1.5),
        cost=CostModel(at_bad=0.1, worst=1.0),
        plot="map",
        map_unit="px",
        meaning="Displacement of the lattice in the patterns relative to that of the camera, over one period.",
        advice="Measure the lattice with a white image and use it in the camera, or check the step of the stage.",
        of_plane=_pitch,
    ),
)
