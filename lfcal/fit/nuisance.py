"""What belongs to single patterns: how far sources were from their places, how steady the lamp was."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.fit.normal import Columns, Local
from lfcal.fit.problem import Point, Problem

__all__ = ["Spread", "own_steps", "spread_of"]

F8 = NDArray[np.float64]

UNKNOWN = 1e9
"""Variance of what a pattern does not show."""

SURE = 4.0
"""Standard errors by which a variance must lie above 0 to be taken for more than noise."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Rms of what belongs to single patterns; 0 where no more than noise shows.

    Attributes
    ----------
    stage_px
        Of sources' displacements along an axis (pixels).
    lamp
        Of the lamp, relative.
    response
        Of the response of pixels, relative: no pattern has it to itself, but nor has the model it.
    """

    stage_px: float = 0.0
    lamp: float = 0.0
    response: float = 0.0


def spread_of(problem: Problem, point: Point, columns: Columns) -> Spread:
    """Return the spread that the patterns show beyond their noise, by the moments of each one's own best values.

    Displacements o with errors v have E[o² - v] = sigma².
    """
    free = replace(point, local=replace(point.local, stage_px=1e3, lamp=1e3))
    only = Columns(columns.shared[:0], columns.own)
    normal = problem.normal(only, free, problem.fitted)
    own = np.array([ch for _, ch in normal.solved])
    now = np.c_[point.local.offsets_px, point.levels.lamps][problem.fitted]
    errors = _errors(problem, free, only)
    # gains and displacements that all share are not theirs
    values = own + now
    values = values - _plane_means(values, errors, problem.planes[problem.fitted])
    stage = _excess(values[:, :2], errors[:, :2])
    return Spread(stage, _excess(values[:, 2], errors[:, 2]))


def _errors(problem: Problem, point: Point, columns: Columns) -> F8:
    """Return the variance of each pattern's own unknowns ``(n, 3)``."""
    assert columns.own is not None
    factors, found = point.levels.factors(problem.planes), []
    for p in np.flatnonzero(problem.fitted).tolist():
        weight = point.seen.inverse[p] * point.seen.robust[p]
        gain = point.levels.gains[problem.planes[p]]
        rows = [*(columns.own[:, p] * (factors[p] * weight)), point.model[p] * (gain * weight)]
        y = np.stack(rows).astype(np.float64)
        found.append(np.diag(np.linalg.pinv(y @ y.T)))
    # what does not show at all is not known at all
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
    """Return the root of the variance beyond the errors', 0 unless it is surely above none.

    Weights are 1/(v + sigma²)², of the sigma of the round before: by 1/v² the best patterns alone would count.
    """
    weight = 1.0 / errors**2
    # of squares of noise alone: their variance is 2 v²
    found, sigma = _moment(values, errors, weight), float(np.sqrt((weight**2 * 2 * errors**2).sum()) / weight.sum())
    if found <= SURE * sigma:
        return 0.0
    for _ in range(20):
        found = max(0.0, _moment(values, errors, 1.0 / (errors + found) ** 2))
    return float(np.sqrt(found))


def _moment(values: F8, errors: F8, weight: F8) -> float:
    return float((weight * (values**2 - errors)).sum() / weight.sum())


def own_steps(problem: Problem, point: Point, columns: Columns, keep: NDArray[np.bool_]) -> Point:
    """Return the point with the patterns ``keep`` at the own values that fit them best, what is shared held."""
    local, lamps = point.local, point.levels.lamps.copy()
    if local.count == 0:
        return point
    normal = problem.normal(Columns(columns.shared[:0], columns.own), point, keep)
    offsets = local.offsets_px.copy()
    for p, (_, ch) in zip(np.flatnonzero(keep).tolist(), normal.solved, strict=True):
        if local.stage_px > 0:
            offsets[p] = np.clip(offsets[p] + ch[:2], -8 * local.stage_px, 8 * local.stage_px)
        if local.lamp > 0:
            lamps[p] += ch[-1]
    found: Local = replace(local, offsets_px=offsets)
    return problem.point(point.u, found, point.sampling, lamps=lamps, doubtful=point.doubtful)
