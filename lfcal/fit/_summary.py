"""A fit in numbers: values with their standard deviations, correlations, what the scan does not tell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.fit._stand_ins import StandIns, standing_in
from lfcal.fit._weighing import PatternLevels
from lfcal.fit.judge import chi_square, covariance, left_out_error
from lfcal.fit.normal import Columns
from lfcal.fit.nuisance import Spread
from lfcal.fit.parameters import GROUPS, Unknown
from lfcal.fit.problem import Point, Problem
from lfcal.fit.questions import order_of_types
from lfcal.fit.result import Fit, InRegion, Outlier, Parameter

__all__ = ["summarised", "unidentified"]

F8 = NDArray[np.float64]

VAGUE = 1.0
"""Standard deviation, in scales of the unknowns, from which on a combination is not told: less would not show."""

PART = 0.3
"""Share of a combination from which on an unknown is named."""


def unidentified(unknowns: Sequence[Unknown], data: F8) -> tuple[str, ...]:
    """Return the combinations of unknowns that the data alone do not tell apart, the vaguest first.

    ``data`` ``(k, k)`` is the matrix of the data in scales, all else eliminated: its small singular values.
    """
    values, vectors = np.linalg.eigh(data)
    found = []
    for value, vector in zip(values, vectors.T, strict=True):
        sigma = math.inf if value <= 0 else 1.0 / math.sqrt(value)
        if sigma < VAGUE:
            break
        parts = [(abs(v), one.name) for v, one in zip(vector, unknowns, strict=True) if abs(v) > PART]
        names = [name for _, name in sorted(parts, reverse=True)]
        found.append(" with ".join(names) if len(names) > 1 else names[0] if names else "many together")
    return tuple(found)


def summarised(
    problem: Problem,
    point: Point,
    columns: Columns,
    *,
    groups: Sequence[str],
    tried: Sequence[str],
    outliers: tuple[Outlier, ...],
    beside: StandIns | None = None,
) -> tuple[Fit, ...]:
    """Return the fit at a point, as it is in each region of the field, with the last derivatives that were computed.

    ``beside`` is what else, that was not tried, may have changed in the place of what was found.
    """
    vector = problem.vector
    which = vector.of_groups(groups)
    unknowns = [vector.unknowns[k] for k in which]
    spread, data = covariance(problem, point, columns, which)
    chi2 = chi_square(point, problem.fitted, len(which))
    # where the model does not suffice its unknowns are as much less sure
    grown = math.sqrt(max(1.0, chi2.lit)) if not chi2.complete else 1.0
    alone = grown * np.sqrt(np.maximum(np.diag(spread)[: len(which)], 0.0))
    held = standing_in(problem, point, columns, which)
    if beside is not None:
        held = held.with_others(beside)
    sigmas = np.sqrt(held.variances(spread[: len(which), : len(which)], grown))
    parameters = {
        one.name: Parameter(
            one.name,
            one.group,
            one.unit,
            one.value(float(point.u[k])),
            one.sigma_of(float(point.u[k]), float(sigma)),
            one.start,
            one.sigma_of(float(point.u[k]), float(own)),
        )
        for k, one, sigma, own in zip(which, unknowns, sigmas, alone, strict=True)
    }
    size = np.sqrt(np.maximum(np.diag(spread)[: len(which)], 1e-300))
    nt, ns = problem.measured.plan.cutout
    measured, nz = problem.measured, problem.measured.plan.shape[0]
    images = point.seen.residual.reshape(-1, nt, ns)
    setup = vector.setup_at(point.u)
    order = order_of_types(measured.plan.camera, setup.camera)
    whole = Fit(
        setup=setup,
        planned=measured.plan,
        parameters=parameters,
        groups=tuple(groups),
        unhelpful=tuple(
            name for name in tried if name not in groups and not GROUPS.get(name).held and vector.of_groups([name]).size
        ),
        chi_square=chi2,
        left_out_error=left_out_error(problem, point, columns, which, grown**2 * spread, complete=chi2.complete),
        correlations=spread[: len(which), : len(which)] / np.outer(size, size),
        held=tuple(dict.fromkeys(one.gauge for one in unknowns if one.gauge)),
        unidentified=(*unidentified(unknowns, data), *held.words),
        outliers=outliers,
        answers={"order of lens types": f"{order} of the description"} if order else {},
        spread=Spread(point.local.stage_px, point.local.lamp, point.local.response.rms),
        levels=point.levels,
        residuals={},
    )
    found = []
    for plan, own, k in measured.parts():
        planes = slice(k * nz, (k + 1) * nz)
        light = PatternLevels(point.levels.gains[planes], point.levels.backgrounds[planes], point.levels.lamps[own])
        places = [(int(z), int(y), int(x)) for z, y, x in measured.index[own]]
        here = None
        if len(measured.plans) > 1:
            among = np.zeros(len(measured), np.bool_)
            among[own] = True
            fitted = among & problem.fitted
            # each region has its part of what all of them found
            share = round(len(which) * fitted.sum() / max(1, problem.fitted.sum()))
            chi2 = chi_square(point, fitted, share)
            error = left_out_error(problem, point, columns, which, grown**2 * spread, among, complete=chi2.complete)
            here = InRegion(chi2, error)
        found.append(
            replace(
                whole,
                setup=setup.of_region(k),
                planned=plan,
                outliers=tuple(one for one in outliers if one.region == k),
                levels=light.between(np.unique(measured.index[own, 0]), plan.depths_um),
                residuals=dict(zip(places, images[own], strict=True)),
                here=here,
            )
        )
    return tuple(found)
