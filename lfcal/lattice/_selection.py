"""Which form of lattice the measured places call for, by what left-out blocks of the field say."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.lattice._forms import FORMS, DistortionFrame, FittedForm, LatticeForm, design, fit_form
from lfcal.lattice._model import LatticeModel

__all__ = ["Selection", "covariance", "flexible_form", "select_form", "thinned"]

Array = NDArray[np.float64]

BLOCKS = 10
"""Blocks of the field along each side: neighbours err alike, so whole blocks are left out together."""

FOLDS = 5
MIN_SHARE = 4.0
"""Measured coordinates for each free number, at least."""

FLEXIBLE_SHARE = 8.0
"""The same where a form is to run ahead of the places, or to weigh them."""

LEAST_GAIN = 0.01
"""By how much a form must move the lenslets to be worth its numbers (pixels rms)."""

LEAST_SHARE = 0.03
"""Share of what micro-images left out lose that a form must remove: less may be the frame's border, or chance."""

ENOUGH = 10000
"""Lenslets from which forms are compared: more of them would tell nothing new of smooth fields."""


@dataclass(frozen=True, slots=True)
class Blocks:
    """Lenslets sorted by block: ``order`` and the bounds of each block in it, and the block's fold."""

    order: NDArray[np.intp]
    bounds: NDArray[np.intp]
    fold: NDArray[np.intp]

    @classmethod
    def of(cls, places: Array) -> Blocks:
        """Return the blocks of places ``(n, 2)``, equal rectangles of the field they take."""
        low, high = places.min(0), places.max(0)
        # a block of fewer than four lenslets would be a lenslet
        side = int(np.clip(math.sqrt(len(places) / 4), 2, BLOCKS))
        cell = np.minimum(((places - low) / np.maximum(high - low, 1e-9) * side).astype(np.intp), side - 1)
        number = cell[:, 1] * side + cell[:, 0]
        order = np.argsort(number, kind="stable")
        held, start = np.unique(number[order], return_index=True)
        # knight's moves: the blocks of a fold lie over the whole field
        fold = (held % side + 2 * (held // side)) % FOLDS
        return cls(order, np.append(start, len(places)), fold)


@dataclass(frozen=True, slots=True)
class Selection:
    """The form chosen, and why.

    Attributes
    ----------
    fitted
        The form and its fit.
    covariance
        Of the free numbers, in the order of `lfcal.lattice._forms.design`.
    reason
        In words.
    correlation
        By how much the variance of block means exceeds that of independent lenslets.
    """

    fitted: FittedForm
    covariance: Array
    reason: str
    correlation: float


def flexible_form(count: int) -> LatticeForm:
    """Return the most flexible form that ``count`` lenslets determine well."""
    fitting = [form for form in FORMS[1:] if not form.radial and 2 * count >= FLEXIBLE_SHARE * form.size]
    return fitting[-1] if fitting else FORMS[0]


def select_form(model: LatticeModel, index: NDArray[np.intp], places: Array, frame: DistortionFrame) -> Selection:
    """Fit every form and return the one that the places call for.

    A form with more numbers is taken when it foretells left-out blocks better, by more than chance would have it and
    by `LEAST_SHARE`, and moves the lenslets by `LEAST_GAIN` at least.

    Parameters
    ----------
    model
        A lattice near the places.
    index, places
        ``(n, 2)``: lattice indices (q, r) and measured places (x, y) of the lenslets (pixels).
    frame
        Where distortions count from.
    """
    few = thinned(len(index))
    fits, losses, correlation = _compared(model, index[few], places[few], frame)
    unit = correlation * _variance(fits[-1])
    chosen = 0
    for k in range(1, len(fits)):
        extra = fits[k].form.size - fits[chosen].form.size
        chance = 2 * math.sqrt(2 * max(extra, 1)) + 4
        needed = max(chance * unit, LEAST_SHARE * losses[chosen])
        if losses[chosen] - losses[k] > needed and _moves(fits[chosen], fits[k], index[few]) > LEAST_GAIN:
            chosen = k
    # a form that the few determine the many determine too; all the same, no crash over a lattice that was found
    best = fit_form(fits[chosen].model, fits[chosen].form, index, places, frame)
    if best is None:
        index, best = index[few], fits[chosen]
    weight = float(fits[0].weight.sum())
    lost = [math.sqrt(loss / weight) for loss in losses]
    reason = _words(fits, chosen, lost, index)
    return Selection(best, covariance(best, index, frame, correlation), reason, correlation)


def thinned(count: int) -> NDArray[np.intp]:
    """Return which of ``count`` lenslets serve to compare forms: all, or `ENOUGH` of them all over the field."""
    if count <= ENOUGH:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).permutation(count)[:ENOUGH])


def _compared(
    model: LatticeModel, index: NDArray[np.intp], places: Array, frame: DistortionFrame
) -> tuple[list[FittedForm], list[float], float]:
    """Return the fits of all forms that can be told, what each loses on left-out blocks, and the correlation."""
    largest = fit_form(model, flexible_form(len(index)), index, places, frame)
    if largest is None:
        largest = fit_form(model, FORMS[0], index, places, frame)
    assert largest is not None  # five numbers are determined by any lattice
    blocks = Blocks.of(places)
    # one set of weights for all, so that what they leave can be compared
    fits = [fit for fit in (_offered(largest, form, index, places, frame) for form in FORMS) if fit is not None]
    return fits, [_left_out(fit, index, frame, blocks) for fit in fits], _correlation(largest, blocks)


def _offered(
    largest: FittedForm, form: LatticeForm, index: NDArray[np.intp], places: Array, frame: DistortionFrame
) -> FittedForm | None:
    if form is not FORMS[0] and 2 * len(index) < MIN_SHARE * form.size:
        return None
    return fit_form(largest.model, form, index, places, frame, weight=largest.weight, rounds=5)


def _variance(fit: FittedForm) -> float:
    """Return the weighted squared residual of a coordinate, freed from what the fit itself took."""
    free = max(2 * len(fit.residual) - fit.form.size, 1)
    return float((fit.weight[:, None] * fit.residual**2).sum()) / free


def _correlation(fit: FittedForm, blocks: Blocks) -> float:
    """Return how many times larger the squared sum over a block is than with independent lenslets; at least 1."""
    values = (fit.weight[:, None] * fit.residual)[blocks.order]
    sums = np.add.reduceat(values, blocks.bounds[:-1], axis=0)
    # what the form has fitted away of the block means
    kept = max(1 - fit.form.size / (2 * len(sums)), 0.2)
    return max(1.0, float((sums**2).sum()) / max(float((values**2).sum()), 1e-300) / kept)


def _left_out(fit: FittedForm, index: NDArray[np.intp], frame: DistortionFrame, blocks: Blocks) -> float:
    """Return the weighted sum of squares of each fold's residuals under a fit to the others (linear about the fit)."""
    columns = design(fit.model, fit.form, index, frame)[:, blocks.order]
    residual, weight = fit.residual[blocks.order], fit.weight[blocks.order]
    size = fit.form.size
    normal, right, square = np.zeros((FOLDS, size, size)), np.zeros((FOLDS, size)), np.zeros(FOLDS)
    for k, fold in enumerate(blocks.fold):
        part = slice(blocks.bounds[k], blocks.bounds[k + 1])
        for axis in (0, 1):
            heavy = columns[axis, part] * weight[part, None]
            normal[fold] += heavy.T @ columns[axis, part]
            right[fold] += heavy.T @ residual[part, axis]
            square[fold] += float(weight[part] @ residual[part, axis] ** 2)
    total, loss = normal.sum(0), 0.0
    for fold in range(FOLDS):
        try:
            step = np.linalg.solve(total - normal[fold], right.sum(0) - right[fold])
        except np.linalg.LinAlgError:
            return math.inf
        loss += float(square[fold] - 2 * step @ right[fold] + step @ normal[fold] @ step)
    return loss


def _moves(old: FittedForm, new: FittedForm, index: NDArray[np.intp]) -> float:
    """Return the distance between two fits' places (pixels rms)."""
    return math.sqrt(float(((old.model.places(index) - new.model.places(index)) ** 2).sum(1).mean()))


def covariance(fit: FittedForm, index: NDArray[np.intp], frame: DistortionFrame, correlation: float) -> Array:
    """Return the covariance of a fit's free numbers under the weights used.

    A^-1 B A^-1 of M-estimators (Huber 1981) with B from the residuals themselves, times ``correlation``.
    """
    columns = design(fit.model, fit.form, index, frame)
    weight = fit.weight
    # of a weight k/d only half acts on a step: along the residual the pull is constant
    slope = np.where(weight < 1, weight / 2, 1.0)
    normal, scatter = (np.zeros((fit.form.size,) * 2) for _ in range(2))
    for axis in (0, 1):
        normal += (columns[axis] * slope[:, None]).T @ columns[axis]
        pull = columns[axis] * (weight * fit.residual[:, axis])[:, None]
        scatter += pull.T @ pull
    inverse = np.linalg.inv(normal)
    lost = 2 * len(index) / max(2 * len(index) - fit.form.size, 1)
    result: Array = correlation * lost * inverse @ scatter @ inverse
    return result


def _words(fits: list[FittedForm], chosen: int, lost: list[float], index: NDArray[np.intp]) -> str:
    """Return why a form was chosen: what it removes, and what a richer one would gain on micro-images left out."""
    best = fits[chosen]
    if chosen:
        away = np.hypot(*(fits[0].model.places(index) - best.model.places(index)).T)
        said = f"{best.form.name}: removes {float(away.max()):.2g} px where it is largest"
    else:
        said = f"{best.form.name}: straight rows, and the rest is scatter"
    richer = range(chosen + 1, len(fits))
    if not richer:
        return said
    next_best = min(richer, key=lambda k: lost[k])
    gain = lost[chosen] - lost[next_best]
    if gain < 1e-4:
        return f"{said}; no richer form foretells left-out micro-images better"
    return f"{said}; {fits[next_best].form.name} would gain {gain:.1g} px"
