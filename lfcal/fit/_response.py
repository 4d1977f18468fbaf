"""How unevenly pixels respond: what several patterns lack, or have too much, at the same pixel of the sensor."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.fit._weighing import Response, flat, variance
from lfcal.fit.problem import Point, Problem

__all__ = ["response_of"]

F8 = NDArray[np.float64]

SURE = 4.0
"""Standard errors by which a variance must lie above 0 to be taken for more than noise."""


def response_of(problem: Problem, point: Point) -> Response:
    """Return how unevenly pixels respond, by products of the residuals that patterns have at the same pixel.

    Of residuals ``r = g m + noise`` the products of two patterns ``i`` and ``j`` at a pixel have the mean
    ``g² m_i m_j``: noise, which no two of them share, is not in it. Errors of the model are in it as far as they agree
    from pattern to pattern, so that no more is taken than the camera's description has. What is less than surely seen
    is 0, with the standard deviation to which the patterns, or else the description, tell it.
    """
    measured = problem.measured
    described = measured.plan.camera.sensor.prnu**2
    if described == 0:
        return Response()
    data, valid = flat(measured)
    light = point.model * point.levels.factors(problem.planes)[:, None]
    back = point.levels.backgrounds[problem.planes, None]
    noise = variance(measured, light.astype(np.float32), doubtful=False, error=0.0).astype(np.float64)
    good = valid & ~point.seen.wild
    # the best gain of a pixel by one pattern is r / m, of weight m² / v
    lacking = np.where(good, (data - light - back) * light / noise, 0.0)
    weight = np.where(good, np.square(light) / noise, 0.0)
    at, pixels = _pixels(problem)
    total, own, weights, squares = (
        np.bincount(at, np.ravel(values), pixels) for values in (lacking, lacking**2, weight, weight**2)
    )
    products, expected = total**2 - own, weights**2 - squares
    if not expected.any():
        return Response(0.0, described)
    by = np.ones_like(expected)
    scale, found = float(expected.sum()), 0.0
    for _ in range(3):
        scale = float((by * expected).sum())
        found = float((by * products).sum()) / scale
        by = 1.0 / np.square(1.0 + max(0.0, found) * weights)
    spread = math.sqrt(2.0 * float((by**2 * expected).sum())) / scale
    seen = min(found, described) if found > SURE * spread else 0.0
    return Response(seen, min(spread, described))


def _pixels(problem: Problem) -> tuple[NDArray[np.intp], int]:
    """Return which pixel of the sensor each sample of the patterns is, and how many there are."""
    measured = problem.measured
    nt, ns = measured.plan.cutout
    corners = np.zeros((len(measured), 2), np.intp)
    for plan, own, _ in measured.parts():
        where = np.asarray(plan.anchor) + measured.index[own, 1:]
        # as the cutout has it: halves go down
        corners[own] = np.ceil(where - 0.5).astype(np.intp)
    corners -= corners.min(0)
    width = int(corners[:, 1].max()) + ns
    rows = corners[:, :1, None] + np.arange(nt)[:, None]
    columns = corners[:, 1:, None] + np.arange(ns)
    at: NDArray[np.intp] = (rows * width + columns).ravel()
    return at, int(at.max()) + 1
