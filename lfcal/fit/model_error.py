"""Quality of a fit: chi² relative to its spread, and the error of the model from patterns that were not fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import format_share
from lfcal.fit._weighing import Weighed, flat, variance
from lfcal.fit.normal import Columns
from lfcal.fit.problem import Point, Problem
from lfcal.fit.solver import shared_of, with_prior

__all__ = ["INCOMPLETE", "ChiSquare", "ModelError", "chi_square", "covariance", "eliminated", "held_out_error"]

INCOMPLETE = 5.0
"""Standard deviations by which chi² exceeds 1 if the model is incomplete."""

SHOWN = 3.0
"""Standard deviations by which the scatter of held-out patterns must exceed their noise to be significant."""

NUISANCE_SHARE = 0.5
"""Fraction of the rms residual of held-out patterns below which effects on single patterns count as error."""

F8 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ChiSquare:
    """Mean square of the residuals in units of their noise; 1 for a correct model.

    Attributes
    ----------
    all_pixels
        Value over all valid pixels, most of which are dark and therefore hardly depend on the model.
    lit
        Value weighted by the fraction of the variance of each pixel that is due to light.
    sigma
        Standard deviation of ``lit`` for a correct model.
    """

    all_pixels: float
    lit: float
    sigma: float

    @property
    def excess(self) -> float:
        """Number of standard deviations by which ``lit`` exceeds 1."""
        return (self.lit - 1.0) / self.sigma

    @property
    def complete(self) -> bool:
        """Whether the model is complete, that is, ``excess`` is below `INCOMPLETE`."""
        return self.excess < INCOMPLETE

    def to_dict(self) -> dict[str, float]:
        """Return the values as plain JSON types."""
        return {"lit": self.lit, "sigma": self.sigma, "excess": self.excess, "all_pixels": self.all_pixels}


@dataclass(frozen=True, slots=True)
class ModelError:
    """Error of the patterns of a model: rms of the error divided by the rms of the light (relative L2).

    Attributes
    ----------
    squared, squared_sigma
        Mean squared residual of the held-out patterns beyond their noise, divided by the mean square of these patterns,
        and its standard deviation. For an incomplete model, all patterns are used.
    statistical
        Contribution of the errors of the unknowns (relative L2).
    patterns
        Number of held-out patterns; of fitted ones if none was held out.
    among
        Additional standard deviation of ``squared``, because some patterns are predicted worse than others.
    skew
        Standardized third moment of ``squared``, which is positive because few bright pixels contribute most.
    """

    squared: float
    squared_sigma: float
    statistical: float
    patterns: int
    among: float = 0.0
    skew: float = 0.0

    @property
    def known(self) -> bool:
        """Whether the error is significant, that is, unlikely to be due to noise alone; if not, use ``limit``."""
        # the quantile of Cornish and Fisher
        rare = SHOWN + self.skew / 6 * (SHOWN**2 - 1)
        return self.squared > rare * self.squared_sigma

    @property
    def value(self) -> float:
        """The error; if it is not `known`, only the contribution of the errors of the unknowns."""
        return math.sqrt(self.squared) if self.known else self.statistical

    @property
    def sigma(self) -> float:
        """Standard deviation of `value`; infinite if the error is not `known`."""
        return 0.5 * math.hypot(self.squared_sigma, self.among) / math.sqrt(self.squared) if self.known else math.inf

    @property
    def limit(self) -> float:
        """Upper limit of the error, at two standard deviations."""
        spread = math.hypot(self.squared_sigma, self.among) if self.known else self.squared_sigma
        return max(self.statistical, math.sqrt(max(0.0, self.squared) + 2.0 * spread))

    def to_dict(self) -> dict[str, float | bool]:
        """Return the values as plain JSON types."""
        return {"known": self.known, "value": self.value, "sigma": self.sigma, "limit": self.limit}

    def __str__(self) -> str:
        """Return the value with its standard deviation, or the limit."""
        if self.known:
            return f"{format_share(self.value)} ± {format_share(self.sigma)}"
        return f"below {format_share(self.limit)}"


def chi_square(point: Point, keep: NDArray[np.bool_], unknowns: int) -> ChiSquare:
    """Return chi² of the patterns that the mask ``keep`` ``(n,)`` selects.

    ``unknowns`` is the number of fitted unknowns. If there are too few lit samples for them, chi² is 1, and its
    standard deviation is infinite.
    """
    seen = point.seen.of(keep)
    good = (seen.inverse > 0) & ~seen.outlying
    size = np.abs(seen.residual[good], dtype=np.float64)
    # as in the loss: single outlying pixels are not errors of the model
    loss = np.where(size <= 4.0, size * size, 4.0 * (2 * size - 4.0))
    weight = seen.bright[good].astype(np.float64)
    total = float(weight.sum())
    n = loss.size
    if n <= unknowns or total <= unknowns:
        return ChiSquare(1.0, 1.0, math.inf)
    spread = math.sqrt(2.0 * float((weight**2).sum())) / total
    return ChiSquare(float(loss.sum()) / (n - unknowns), float((weight * loss).sum()) / (total - unknowns), spread)


def covariance(problem: Problem, point: Point, columns: Columns, which: NDArray[np.intp]) -> tuple[F8, F8]:
    """Return the covariance of some unknowns and of gains and backgrounds, and the information of the data.

    ``which`` are the indices of the ``k`` unknowns. Both matrices are in units of the scales, for the stated noise. The
    covariance includes priors. The information matrix ``(k, k)`` is without priors, and gains and backgrounds are
    eliminated from it.
    """
    normal = problem.normal(columns, point, problem.fitted)
    matrix, _ = with_prior(problem, normal, point.u)
    used, k = shared_of(problem, which), len(which)
    found = _inverse(matrix[np.ix_(used, used)])
    return found, eliminated(normal.matrix[np.ix_(used, used)], k)


def eliminated(matrix: F8, k: int) -> F8:
    """Return the information matrix of the first ``k`` unknowns, with all others eliminated (Schur complement)."""
    found: F8 = matrix[:k, :k] - matrix[:k, k:] @ _inverse(matrix[k:, k:]) @ matrix[k:, :k]
    return found


def _inverse(matrix: F8) -> F8:
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = np.linalg.pinv(matrix / np.outer(size, size), rcond=1e-13, hermitian=True)
    found: F8 = scaled / np.outer(size, size)
    return found


def held_out_error(
    problem: Problem,
    point: Point,
    columns: Columns,
    which: NDArray[np.intp],
    spread: F8,
    among: NDArray[np.bool_] | None = None,
    *,
    complete: bool = True,
) -> ModelError:
    """Return the error of the model at ``point``, estimated from held-out patterns.

    ``which`` contains the indices of the fitted unknowns, and ``columns`` the derivatives of the patterns with respect
    to all unknowns. ``spread`` is the covariance of the fitted unknowns, followed by the gains and then the backgrounds
    of the planes. ``among`` is a mask that selects patterns (None: all).

    If none of these patterns was held out, the fitted ones are used. If the model is not ``complete``, all are used.
    The residuals of the fitted patterns then exceed the noise. They are hardly smaller than those of held-out patterns,
    and usually more numerous. Squared residuals contain the variance of the noise in addition to the error:
    E[(d - m)² - v] = error². Effects on single patterns, such as those of the lamp and of displaced sources, are not
    errors of the model. If they are less than half of the residual, however, they may be part of the error and are
    included.
    """
    measured = problem.measured
    some = np.ones(len(measured), np.bool_) if among is None else among
    held_out = measured.held_out & some
    judged = held_out if held_out.any() else problem.fitted & some
    aside = judged if complete else some
    part, planes = measured.of(aside), problem.planes[aside]
    data, valid = flat(part)
    light = point.model[aside] * point.levels.factors(problem.planes)[aside, None]
    back = point.levels.backgrounds[planes, None]
    response = point.local.response
    noise = variance(part, light.astype(np.float32), doubtful=False, error=response.rms).astype(np.float64)
    good = valid & ~point.seen.outlying[aside]
    noise = np.where(good, noise, 0.0)
    own = np.where(good, light - _ideal(problem, point, columns, aside), 0.0)
    left = np.where(good, data - light - back, 0.0).astype(np.float64)
    power = np.square(np.where(good, light, 0.0), dtype=np.float64).sum(1)
    squares = (np.square(left) - noise).sum(1)
    if np.square(own).sum() < NUISANCE_SHARE**2 * squares.sum():
        left += own
        squares = (np.square(left) - noise).sum(1)
    whole_power, found = float(power.sum()), float(squares.sum() / power.sum())
    scatter = math.sqrt(2.0 * float((noise**2).sum())) / whole_power
    skew = 8.0 * float((noise**3).sum()) / max(1e-300, scatter * whole_power) ** 3
    scatter = math.hypot(scatter, response.sigma)
    beside = 0.0
    if len(power) > 1:
        apart = float(np.square(squares - found * power).sum()) * len(power) / (len(power) - 1)
        beside = math.sqrt(max(0.0, apart / whole_power**2 - scatter**2))
    ones = np.ones_like(point.seen.inverse[aside])
    plain = Weighed(0 * ones, np.where(good, ones, 0).astype(np.float32), ones, ones)
    whole = replace(point, local=replace(point.local, stage_px=0.0, lamp=0.0))
    normal = problem.normal(columns, replace(whole, seen=_placed(point.seen, plain, aside)), aside)
    used = shared_of(problem, which)
    # gain and background of a plane without fitted patterns are found from its held-out ones
    known = np.isin(np.arange(measured.levels), problem.planes[problem.fitted])
    counted = np.r_[np.ones(len(which), np.bool_), known, known]
    inner = np.ix_(counted, counted)
    made = float(np.trace(normal.matrix[np.ix_(used, used)][inner] @ spread[inner])) / whole_power
    return ModelError(found, scatter, math.sqrt(max(0.0, made)), int(judged.sum()), beside, skew)


def _ideal(problem: Problem, point: Point, columns: Columns, keep: NDArray[np.bool_]) -> F8:
    """Return the light of the patterns ``keep`` for sources exactly at their positions and a stable lamp."""
    model = point.model[keep].astype(np.float64)
    if columns.displacements is not None:
        model -= np.einsum(
            "pa,apm->pm", point.local.offsets_px[keep], columns.displacements[:, keep].astype(np.float64)
        )
    found: F8 = model * point.levels.gains[problem.planes[keep], None]
    return found


def _placed(seen: Weighed, part: Weighed, keep: NDArray[np.bool_]) -> Weighed:
    """Return ``seen`` with the patterns ``keep`` replaced by ``part``."""
    values = {}
    for name in ("residual", "inverse", "robust", "bright"):
        values[name] = getattr(seen, name).copy()
        values[name][keep] = getattr(part, name)
    return Weighed(**values)
