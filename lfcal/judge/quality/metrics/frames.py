"""Metrics of single frames (missing, duplicate, not finite, unusual), and of the seam from last to first."""

from __future__ import annotations

import math

import numpy as np

from lfcal.judge.quality.measure import PlaneMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]

ODD = Limits(good=2.5, bad=4.0)
"""Limits of the change of a frame to its neighbours, relative to the typical change; bad frames are listed."""


def _missing(plane: PlaneMeasures) -> Reading:
    flags = plane.faulty.missing
    return Reading(float(flags.sum()), map=flags.astype(float), positions=flags)


def _duplicates(plane: PlaneMeasures) -> Reading:
    flags = plane.faulty.duplicates
    return Reading(float(flags.sum()), map=flags.astype(float), positions=flags)


def _nonfinite(plane: PlaneMeasures) -> Reading:
    pixels = plane.table.column("nonfinite")
    return Reading(float(pixels.sum()), map=pixels, positions=pixels > 0)


def _odd(plane: PlaneMeasures) -> Reading:
    if plane.continuity is None or plane.positions.locked:  # the lattice makes a locked pattern jump
        return UNKNOWN
    odd = plane.continuity.odd
    value = float(np.nanmax(odd)) if np.isfinite(odd).any() else math.nan
    return Reading(value, map=odd, positions=odd > ODD.bad)


def _seam(plane: PlaneMeasures) -> Reading:
    if plane.continuity is None or plane.positions.locked:
        return UNKNOWN
    return Reading(plane.continuity.seam, map=plane.continuity.odd)


METRICS = (
    MetricSpec(
        key="missing",
        title="Missing frames",
        subject="frames",
        unit="frames",
        limits=Limits(good=0, bad=0),
        cost=CostModel(at_bad=1.3, worst=2.0, per_frame=True),
        plot="map",
        map_unit="yes / no",
        meaning="Positions without a frame, or with a dark frame.",
        advice="Record these positions again.",
        overall="sum",
        redo=True,
        needs_light=False,
        of_plane=_missing,
    ),
    MetricSpec(
        key="duplicates",
        title="Duplicate frames",
        subject="frames",
        unit="frames",
        limits=Limits(good=0, bad=0),
        cost=CostModel(at_bad=1.2, worst=2.0, per_frame=True),
        plot="map",
        map_unit="yes / no",
        meaning="Positions with exactly the same frame as another position.",
        advice="Record these positions again: the camera repeated a frame, or a file was copied.",
        overall="sum",
        redo=True,
        of_plane=_duplicates,
    ),
    MetricSpec(
        key="nonfinite",
        title="Not-a-number",
        subject="frames",
        unit="pixels",
        limits=Limits(good=0, bad=0),
        cost=CostModel(at_bad=0.3, worst=3.0),
        plot="map",
        meaning="Pixels that are NaN: a single one makes every voxel of a reconstruction NaN.",
        advice="Record these positions again, or check the corrections and assemble again.",
        overall="sum",
        redo=True,
        needs_light=False,
        of_plane=_nonfinite,
    ),
    MetricSpec(
        key="step",
        title="Unusual frames",
        subject="frames",
        unit="x",
        limits=ODD,
        cost=CostModel(at_bad=0.01, worst=0.1),
        plot="map",
        map_unit="times the typical change",
        meaning="Largest change of a frame to all four neighbours, relative to the typical change around it.",
        advice="Look at these frames, and record them again if they are wrong.",
        redo=True,
        of_plane=_odd,
    ),
    MetricSpec(
        key="seam",
        title="Seam at the period's edge",
        subject="frames",
        unit="x",
        limits=Limits(good=1.5, bad=3.0),
        cost=CostModel(at_bad=0.1, worst=0.8),
        plot="map",
        map_unit="times the typical change",
        always_shown=True,
        meaning=(
            "Change from the last position of a period to the first, relative to the change between "
            "neighbours; 1 if the pattern is periodic."
        ),
        advice=(
            "The patterns do not repeat with this period. Check the period, the step and the drift, and "
            "whether the lens is telecentric."
        ),
        of_plane=_seam,
    ),
)
