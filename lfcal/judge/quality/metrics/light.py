"""Metrics of signal, background and stray light, and of the lamp over the scan."""

from __future__ import annotations

import math

from lfcal.judge.quality.measure import PlaneMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]


def _snr(plane: PlaneMeasures) -> Reading:
    noise = plane.dark.noise
    if (
        plane.edges.cut_off or not noise > 0
    ):  # the corners are not dark, or are rounded to zero: use the value of the sensor
        noise = plane.sensor_noise or noise
    return Reading(plane.table.peak / noise if noise > 0 else math.inf)


def _background(plane: PlaneMeasures) -> Reading:
    if plane.edges.cut_off or not plane.energy > 0:  # the corners are not dark, or there is no light: unknown
        return UNKNOWN
    # the random error of a mean is not a background
    sure = math.sqrt(max(0.0, plane.background**2 - (2 * plane.dark.chance) ** 2))
    return Reading(100 * sure * plane.table.lit.size / plane.energy)


def _clipped(plane: PlaneMeasures) -> Reading:
    return UNKNOWN if plane.edges.cut_off else Reading(100 * plane.dark.clipped)


def _leak(plane: PlaneMeasures) -> Reading:
    return Reading(plane.edges.leak)


def _flicker(plane: PlaneMeasures) -> Reading:
    # the lattice makes the energy vary, and so does the part of a pattern that is inside a small cutout
    if plane.positions.locked or plane.edges.cut_off:
        return UNKNOWN
    return Reading(plane.shares_split.rms, map=plane.shares_split.residual)


def _lamp(plane: PlaneMeasures) -> Reading:
    parts = plane.shares_split
    if plane.edges.cut_off:
        return UNKNOWN
    return Reading(max(parts.sure_ramp(0), parts.sure_ramp(1)), map=plane.shares)


METRICS = (
    MetricSpec(
        key="snr",
        title="Peak-to-noise ratio",
        subject="light",
        limits=Limits(good=100.0, bad=20.0, higher_is_better=True),
        cost=CostModel(at_bad=0.5, worst=1.0),
        plot="planes",
        meaning="Median peak of the patterns, relative to the noise of a dark pixel.",
        advice="Expose longer, average more frames, or cool the sensor.",
        of_plane=_snr,
    ),
    MetricSpec(
        key="background",
        title="Background",
        subject="light",
        unit="% of energy",
        limits=Limits(good=0.5, bad=2.0),
        cost=CostModel(at_bad=0.046, worst=1.0),
        plot="planes",
        meaning="Energy that a constant background adds to a pattern or removes from it, without diffraction.",
        advice="Record a dark frame of the same exposure and temperature, and assemble again.",
        of_plane=_background,
        needs_centre=True,
    ),
    MetricSpec(
        key="clipped",
        title="Clipped at zero",
        subject="light",
        unit="% of dark pixels",
        limits=Limits(good=2.0, bad=15.0),
        cost=CostModel(at_bad=0.04, worst=0.2),
        meaning=(
            "Dark pixels that are exactly zero while none is negative. The negative noise was cut off, so "
            "the mean of the noise looks like light."
        ),
        advice="Keep values signed when the dark frame is subtracted, and assemble again.",
        of_plane=_clipped,
    ),
    MetricSpec(
        key="leak",
        title="Stray light",
        subject="light",
        unit="% of energy",
        limits=Limits(good=1.5, bad=4.0),
        cost=CostModel(at_bad=0.05, worst=0.8),
        plot="sum",
        meaning="Light outside the pattern, above the background and the diffraction tails of the camera.",
        advice="Find the light leak or the ghost image in the depth-plane sum, block it, and record again.",
        of_plane=_leak,
        needs_centre=True,
    ),
    MetricSpec(
        key="flicker",
        title="Flicker",
        subject="light",
        unit="% rms",
        limits=Limits(good=2.0, bad=5.0),
        cost=CostModel(at_bad=0.002, worst=0.2),
        plot="map",
        map_unit="%",
        always_shown=True,
        meaning="Scatter of the energy of the patterns from position to position.",
        advice="Stabilise the lamp, or record a reference and normalise to it.",
        of_plane=_flicker,
    ),
    MetricSpec(
        key="lamp",
        title="Lamp drift",
        subject="light",
        unit="% over the period",
        limits=Limits(good=3.0, bad=8.0),
        cost=CostModel(at_bad=0.01, worst=0.3),
        plot="map",
        map_unit="%",
        meaning="Change of the energy of the patterns from the first position to the last.",
        advice="Let the lamp warm up, or record a reference and normalise to it.",
        of_plane=_lamp,
    ),
)
