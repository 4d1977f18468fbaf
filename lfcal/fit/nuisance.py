"""Nuisance parameters of single patterns and pixels: displaced sources, an unstable lamp, uneven pixel response."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.fit._elemental import Elemental
from lfcal.fit._weighing import Response, flat, variance
from lfcal.fit.normal import Columns, Local
from lfcal.fit.problem import Point, Problem

__all__ = [
    "Spread",
    "nuisance_steps",
    "response_of",
    "spread_of",
]

F8 = NDArray[np.float64]

UNKNOWN = 1e9
"""Variance of a parameter on which a pattern has no information."""

SIGNIFICANCE = 4.0
"""Significance, in standard errors, above which a variance counts as more than noise."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Rms of the nuisance parameters of single patterns; 0 for those that cannot be distinguished from noise.

    Attributes
    ----------
    stage_px
        Rms displacement of the sources along each axis of the sensor (px).
    lamp
        Rms fluctuation of the brightness of the lamp, as a fraction of its mean.
    response
        Rms variation of the response between pixels, as a fraction of its mean. All patterns share it, but it is not
        part of the model.
    """

    stage_px: float = 0.0
    lamp: float = 0.0
    response: float = 0.0


def spread_of(problem: Problem, point: Point, columns: Columns) -> Spread:
    """Return the rms displacement of the sources and the rms fluctuation of the lamp, corrected for fitting errors.

    Both follow from the best-fit values for the fitted patterns: values o with error variances v satisfy
    E[o² - v] = sigma². The response is left at 0.
    """
    free = replace(point, local=replace(point.local, stage_px=1e3, lamp=1e3))
    only = Columns(columns.shared[:0], columns.displacements)
    normal = problem.normal(only, free, problem.fitted)
    own = np.array([ch for _, ch in normal.solved])
    now = np.c_[point.local.offsets_px, point.levels.lamps][problem.fitted]
    errors = _errors(problem, free, only)
    # gains and displacements common to all patterns are not included
    values = own + now
    means = _plane_means(values, errors, problem.planes[problem.fitted])
    if isinstance(problem.measured, Elemental):
        # each plane has a single pattern: its gain is that of the lamp, but its displacement is the stage's
        means[:, :2] = 0.0
    values = values - means
    stage = _excess(values[:, :2], errors[:, :2])
    return Spread(stage, _excess(values[:, 2], errors[:, 2]))


def _errors(problem: Problem, point: Point, columns: Columns) -> F8:
    """Return the variances ``(n, 3)`` of the unknowns of each pattern: displacements, then lamp."""
    assert columns.displacements is not None
    factors, found = point.levels.factors(problem.planes), []
    for p in np.flatnonzero(problem.fitted).tolist():
        weight = point.seen.inverse[p] * point.seen.robust[p]
        gain = point.levels.gains[problem.planes[p]]
        rows = [*(columns.displacements[:, p] * (factors[p] * weight)), point.model[p] * (gain * weight)]
        y = np.stack(rows).astype(np.float64)
        found.append(np.diag(np.linalg.pinv(y @ y.T)))
    # without any information, the spread is unknown
    errors = np.array(found)
    return np.where(errors > 0, errors, UNKNOWN)


def _plane_means(values: F8, errors: F8, planes: NDArray[np.intp]) -> F8:
    out = np.zeros_like(values)
    for z in np.unique(planes).tolist():
        own = planes == z
        weight = 1.0 / errors[own]
        out[own] = (weight * values[own]).sum(0) / weight.sum(0)
    return out


def _excess(values: F8, errors: F8) -> float:
    """Return the square root of the variance in excess of the errors; 0 unless the excess is significant.

    Weights are 1/(v + sigma²)², with sigma from the previous round; with 1/v², only the best patterns would count.
    """
    weight = 1.0 / errors**2
    # for squares of pure noise: their variance is 2 v²
    found, sigma = _moment(values, errors, weight), float(np.sqrt((weight**2 * 2 * errors**2).sum()) / weight.sum())
    if found <= SIGNIFICANCE * sigma:
        return 0.0
    for _ in range(20):
        found = max(0.0, _moment(values, errors, 1.0 / (errors + found) ** 2))
    return float(np.sqrt(found))


def _moment(values: F8, errors: F8, weight: F8) -> float:
    return float((weight * (values**2 - errors)).sum() / weight.sum())


def nuisance_steps(problem: Problem, point: Point, columns: Columns, keep: NDArray[np.bool_]) -> Point:
    """Return the point after one step of the nuisance parameters to their best fit, at fixed shared unknowns.

    Only the patterns selected by the mask ``keep`` change. Displacements are limited to 8 times their prior rms.
    """
    local, lamps = point.local, point.levels.lamps.copy()
    if local.count == 0:
        return point
    normal = problem.normal(Columns(columns.shared[:0], columns.displacements), point, keep)
    offsets = local.offsets_px.copy()
    for p, (_, ch) in zip(np.flatnonzero(keep).tolist(), normal.solved, strict=True):
        if local.stage_px > 0:
            offsets[p] = np.clip(offsets[p] + ch[:2], -8 * local.stage_px, 8 * local.stage_px)
        if local.lamp > 0:
            lamps[p] += ch[-1]
    found: Local = replace(local, offsets_px=offsets)
    return problem.point(point.u, found, point.sampling, lamps=lamps, doubtful=point.doubtful)


def response_of(problem: Problem, point: Point) -> Response:
    """Return the square of the relative rms variation of the pixel response, and its standard deviation.

    They are computed from products of residuals at the same pixel. The residuals are ``r = g m + noise``, where g is
    the relative deviation of the response of the pixel, and m the predicted light. The noise of two patterns ``i`` and
    ``j`` is independent. The product of their residuals at a pixel therefore has the mean ``g² m_i m_j``. Errors of the
    model contribute if they agree between patterns. The result and its standard deviation are therefore limited to the
    value in the description of the camera. A result that is not significant is set to 0; its standard deviation is
    kept.
    """
    measured = problem.measured
    described = measured.plan.camera.sensor.prnu**2
    if described == 0:
        return Response()
    data, valid = flat(measured)
    light = point.model * point.levels.factors(problem.planes)[:, None]
    back = point.levels.backgrounds[problem.planes, None]
    noise = variance(measured, light.astype(np.float32), doubtful=False, error=0.0).astype(np.float64)
    good = valid & ~point.seen.outlying
    # the best gain of a pixel from one pattern is r / m, with weight m² / v
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
    seen = min(found, described) if found > SIGNIFICANCE * spread else 0.0
    return Response(seen, min(spread, described))


def _pixels(problem: Problem) -> tuple[NDArray[np.intp], int]:
    """Return the index of the sensor pixel of each sample of the patterns, and the number of these pixels."""
    measured = problem.measured
    if isinstance(measured, Elemental):
        return measured.pixels.ravel(), math.prod(measured.plan.cutout)
    nt, ns = measured.plan.cutout
    corners = np.zeros((len(measured), 2), np.intp)
    for plan, own, _ in measured.parts():
        where = np.asarray(plan.anchor) + measured.index[own, 1:]
        # as in the cutout: halves are rounded down
        corners[own] = np.ceil(where - 0.5).astype(np.intp)
    corners -= corners.min(0)
    width = int(corners[:, 1].max()) + ns
    rows = corners[:, :1, None] + np.arange(nt)[:, None]
    columns = corners[:, 1:, None] + np.arange(ns)
    at: NDArray[np.intp] = (rows * width + columns).ravel()
    return at, int(at.max()) + 1
