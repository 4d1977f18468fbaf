"""Metrics of whole planes: dark, copied, too bright, or at a wrong depth."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import Camera, MainLens
from lfcal.judge.quality.across import MatrixMeasures
from lfcal.judge.quality.measure import PlaneMeasures, lattice_camera
from lfcal.judge.quality.metric import CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]

FREEDOM = 0.1
"""Error of virtual depth that a shadow may have because of tails of diffraction and the exact place of the sensor."""

NEAR = 0.6
"""Distance from v = 1 within which the shadow is too small to be measured."""

Values = NDArray[np.float64]


def _dark(h: MatrixMeasures) -> tuple[Reading, ...]:
    every = np.ones(h.matrix.period, bool)
    return tuple(Reading(1.0, positions=every) if dark else Reading(0.0) for dark in h.dark)


def _copies(h: MatrixMeasures) -> tuple[Reading, ...]:
    every = np.ones(h.matrix.period, bool)
    return tuple(
        Reading(0.0) if first < 0 else Reading(1.0, positions=every, detail=f"planes {first} and {z} are equal")
        for z, first in enumerate(h.copies)
    )


def _energy(h: MatrixMeasures) -> tuple[Reading, ...]:
    """Return the deviation of each plane from equal energy (per cent), or from 1/distance² if that fits better."""
    out = np.full(h.energy.size, math.nan)
    # if patterns are cut off, a part of the light is unknown
    lit = ~h.dark & ~np.array([plane.edges.cut_off for plane in h.planes], bool)
    if lit.sum() < 2:
        return _readings(out)
    models = [np.ones(h.energy.size)]
    if h.matrix.camera is not None and isinstance(h.matrix.camera.optics, MainLens):
        distance = h.matrix.camera.optics.working_distance_um
        models.append((distance / (distance + h.matrix.depths)) ** 2)
    tried = []
    for model in models:
        share = h.energy[lit] / model[lit]
        tried.append(100 * np.abs(share / np.median(share) - 1))
    out[lit] = min(tried, key=lambda d: float(d.max()))
    return _readings(out)


def _readings(values: Values) -> tuple[Reading, ...]:
    return tuple(Reading(float(v)) for v in values)


def _depth(h: MatrixMeasures) -> tuple[Reading, ...]:
    camera = lattice_camera(h.matrix)
    if camera is None:
        return _readings(np.full(len(h.planes), math.nan))
    off, _ = _at_depth(h, camera)
    return _readings(np.where(h.copies >= 0, math.nan, off))


def _depth_order(h: MatrixMeasures) -> tuple[Reading, ...]:
    camera = lattice_camera(h.matrix)
    order = _in_order(h) if camera is None else _at_depth(h, camera)[1]
    return _readings(np.where(h.copies >= 0, math.nan, order))


def _at_depth(h: MatrixMeasures, camera: Camera) -> tuple[Values, Values]:
    """Return the error of each plane's shadow size, and whether the size fits another plane's depth clearly better.

    The errors are in per cent; the second array is 1 where another depth fits better, else 0. Unknown values are NaN.
    If a size fits another plane better, all errors are NaN, so that a wrong order is not also reported as wrong depths.
    """
    off, order = np.full(len(h.planes), math.nan), np.full(len(h.planes), math.nan)
    try:
        away = np.array([camera.virtual_depth(float(z)) - 1 for z in h.matrix.depths])
    except InputError:  # a depth that this camera cannot image: plane numbers, or depths of another camera
        return off, order
    known = np.flatnonzero(np.isfinite(h.shadows_px) & (np.abs(away) > NEAR))
    if known.size < 2:
        return off, order
    wanted = np.abs(away[known])
    # the f-number may differ from the camera's: one scale for all planes, found in any order
    scale = float(np.median(np.sort(h.shadows_px[known]) / np.sort(wanted)))
    beyond = [_beyond(h.planes[z]) for z in known]
    for k, z in enumerate(known):
        apart = np.abs(h.shadows_px[z] / (scale * wanted) - 1)
        if beyond[k] is not None:  # a plane on the other side of the sensor has a shadow of the same size
            apart = np.where((away[known] > 0) == beyond[k], apart, apart + 1)
        off[z] = 100 * max(0.0, apart[k] - FREEDOM / wanted[k])
        order[z] = float(apart[k] > 3 * apart.min() + 0.05)
    if np.nansum(order):
        off[known] = math.nan
    return off, order


def _beyond(plane: PlaneMeasures) -> bool | None:
    """Return whether the image is beyond the sensor (v > 1), from the spot spacing; None if it cannot be measured."""
    spots = plane.positions.spots
    if spots is None or spots.order != "as planned" or abs(spots.scale - 1) < 0.05:
        return None
    return bool(spots.scale > 1)


def _in_order(h: MatrixMeasures) -> Values:
    """Return a mask of the planes that are out of order: as the source moves away, the image moves in one direction."""
    spots = [p.positions.spots for p in h.planes]
    found = np.array([math.nan if s is None else s.virtual_depth for s in spots])
    order = np.full(found.size, math.nan)
    places = np.flatnonzero(np.isfinite(found))
    if places.size > 2:
        places = places[np.argsort(h.matrix.depths[places], kind="stable")]
        order[places] = _out_of_order(found[places])
    return order


def _out_of_order(values: Values) -> Values:
    """Return a mask of the values outside the longest monotonic subsequence, rising or falling."""
    best: list[int] = []
    for sign in (1.0, -1.0):
        chains: list[list[int]] = []
        for k, v in enumerate(sign * values):
            before = [c for c in chains if sign * values[c[-1]] <= v]
            chains.append([*max(before, key=len, default=[]), k])
        best = max([best, *chains], key=len)
    flags = np.ones(values.size)
    flags[best] = 0
    return flags


METRICS = (
    MetricSpec(
        key="planes_lit",
        title="Dark planes",
        subject="planes",
        unit="planes",
        limits=Limits(good=0, bad=0),
        cost=CostModel(at_bad=0.55, worst=1.0),
        plot="planes",
        meaning="Planes with almost no light.",
        advice="Check the lamp, the shutter and the pinhole, and record these planes again.",
        overall="sum",
        redo=True,
        of_matrix=_dark,
    ),
    MetricSpec(
        key="plane_copies",
        title="Copied planes",
        subject="planes",
        unit="planes",
        limits=Limits(good=0, bad=0),
        cost=CostModel(at_bad=0.5, worst=1.0),
        plot="planes",
        meaning="Planes with the same patterns as another plane.",
        advice="Record these planes again: the stage did not move in depth, or files were copied.",
        overall="sum",
        redo=True,
        of_matrix=_copies,
    ),
    MetricSpec(
        key="plane_energy",
        title="Energy of planes",
        subject="planes",
        unit="%",
        limits=Limits(good=5.0, bad=15.0),
        cost=CostModel(at_bad=0.02, worst=0.5),
        plot="planes",
        meaning="Largest deviation of the energy of a plane from the trend over depth.",
        advice="Record all planes with the same exposure and lamp, or normalise the planes.",
        of_matrix=_energy,
    ),
    MetricSpec(
        key="depth",
        title="Depth of planes",
        subject="planes",
        unit="%",
        limits=Limits(good=3.0, bad=8.0),
        cost=CostModel(at_bad=0.1, worst=1.0),
        plot="planes",
        meaning=(
            "Difference between the measured size of the aperture and the size expected at the depth of "
            "the plane, apart from a common scale."
        ),
        advice="Check the depth of these planes, and the working distance and focal length of the camera.",
        of_matrix=_depth,
    ),
    MetricSpec(
        key="depth_order",
        title="Order of planes",
        subject="planes",
        unit="planes",
        limits=Limits(good=0, bad=0),
        cost=CostModel(at_bad=0.6, worst=2.0),
        plot="planes",
        meaning="Planes whose spots have the spacing of another plane: their depths are wrong.",
        advice="Sort the planes by depth, or correct the list of depths.",
        overall="sum",
        of_matrix=_depth_order,
    ),
)
