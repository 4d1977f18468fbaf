"""Models of a lattice, from five parameters to a quintic distortion; their robust fit, and the choice between them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import LatticeDistortion, monomials, polynomial_powers
from lfcal.lattice._model import LatticeModel

__all__ = [
    "FORMS",
    "DistortionFrame",
    "FittedForm",
    "LatticeForm",
    "Selection",
    "covariance",
    "design",
    "fit_flexible",
    "fit_form",
    "flexible_form",
    "huber",
    "select_form",
    "thinned",
]

Array = NDArray[np.float64]
HUBER = 1.5
"""Residual (standard deviations) above which a lenslet gets a lower weight."""


@dataclass(frozen=True, slots=True)
class LatticeForm:
    """A form of the lattice model, which determines the free parameters.

    Attributes
    ----------
    name
        Name for display.
    sheared
        Whether the shear is a free parameter.
    degree
        Degree of the polynomial distortion; 0: none.
    radial
        Number of terms of the radial distortion, whose centre is free too; 0: none.
    """

    name: str
    sheared: bool = True
    degree: int = 0
    radial: int = 0

    @property
    def size(self) -> int:
        """Number of free parameters."""
        bent = 2 * len(polynomial_powers(self.degree)) if self.degree else 0
        return 5 + self.sheared + bent + (self.radial + 2 if self.radial else 0)


FORMS = (
    LatticeForm("affine", sheared=False),
    LatticeForm("affine with shear"),
    LatticeForm("radial", radial=1),
    LatticeForm("radial of two terms", radial=2),
    LatticeForm("quadratic", degree=2),
    LatticeForm("cubic", degree=3),
    LatticeForm("quartic", degree=4),
    LatticeForm("quintic", degree=5),
)
"""All forms, in the order of their numbers of free parameters."""


@dataclass(frozen=True, slots=True)
class DistortionFrame:
    """Reference of distortions: the middle of the frame (x, y), and half its diagonal (pixels)."""

    middle: tuple[float, float]
    scale: float

    @classmethod
    def of(cls, shape: tuple[int, ...]) -> DistortionFrame:
        """Return the reference for a frame of ``shape`` (rows, columns)."""
        x, y = ((n - 1) / 2 for n in (shape[1], shape[0]))
        return cls((x, y), math.hypot(x, y))

    def outline(self) -> Array:
        """Return points ``(36, 2)`` (x, y) on the frame's border."""
        side = np.linspace(0, 2, 9)
        around = [(a, b) for a in side for b in (0, 2)] + [(a, b) for a in (0, 2) for b in side]
        outline: Array = np.array(around) * self.middle
        return outline


@dataclass(frozen=True, eq=False, slots=True)
class FittedForm:
    """A fitted form: the lattice, residuals ``(n, 2)`` (pixels), their weights, and standard deviation per axis."""

    form: LatticeForm
    model: LatticeModel
    residual: Array
    weight: Array
    sigma: float


def huber(residual: Array) -> tuple[Array, float]:
    """Return weights ``(n,)`` of residuals ``(n, 2)``, and their standard deviation along an axis."""
    distance = np.hypot(*residual.T)
    # the median distance of a two-dimensional Gaussian is sigma sqrt(2 ln 2) = 1.1774 sigma
    sigma = max(float(np.median(distance)) / 1.1774, 1e-6)
    # one weight for both axes: an outlier is a lenslet, not a coordinate
    return np.minimum(1.0, HUBER / np.maximum(distance / sigma, 1e-9)), sigma


def design(model: LatticeModel, form: LatticeForm, index: NDArray[np.intp], frame: DistortionFrame) -> Array:
    """Return the derivatives ``(2, n, free parameters)`` of the positions (x, y).

    Order: origin x and y, vector along a row x and y, ratio, shear, then the terms: polynomials along x, then along y;
    radial terms, then their centre x and y. The effect of the terms on the linear part of the lattice is neglected.
    """
    q, r = index[:, 0].astype(float), index[:, 1].astype(float)
    out = np.zeros((2, len(index), form.size))
    across, up = q + (model.lean + model.ratio * model.shear) * r, model.ratio * r
    ax, ay = model.along
    out[0, :, 0] = out[1, :, 1] = 1.0
    out[0, :, 2] = out[1, :, 3] = across
    out[0, :, 3], out[1, :, 2] = -up, up
    out[0, :, 4], out[1, :, 4] = r * (model.shear * ax - ay), r * (model.shear * ay + ax)
    if form.sheared:
        out[0, :, 5], out[1, :, 5] = up * ax, up * ay
    if not (form.degree or form.radial):
        return out
    straight = model.straight(index)
    if form.degree:
        columns = monomials((straight - np.array(frame.middle)) / frame.scale, form.degree)
        count = columns.shape[1]
        out[0, :, 6 : 6 + count] = out[1, :, 6 + count :] = columns
        return out
    bend = model.distortion
    assert bend is not None
    arm = (straight - np.array(bend.centre)) / bend.scale
    square = (arm**2).sum(1, keepdims=True)
    for k in range(form.radial):
        out[:, :, 6 + k] = (square ** (k + 1) * arm).T
    # moving the centre has the effect of moving the points in the opposite direction
    out[:, :, 6 + form.radial :] = np.moveaxis(np.eye(2) - bend.jacobian(straight), 1, 0)
    return out


def _moved(model: LatticeModel, form: LatticeForm, frame: DistortionFrame, step: Array) -> LatticeModel:
    """Return the model after a step of its free parameters."""
    bend = model.distortion
    if form.degree:
        old = np.zeros((2, len(polynomial_powers(form.degree)))) if bend is None else np.array(bend.terms)
        new = old + step[6:].reshape(2, -1)
        bend = LatticeDistortion("polynomial", frame.middle, frame.scale, tuple(map(tuple, new.tolist())))
    elif form.radial:
        assert bend is not None
        terms = np.array(bend.terms[0]) + step[6 : 6 + form.radial]
        x, y = np.array(bend.centre) + step[6 + form.radial :]
        bend = LatticeDistortion("radial", (float(x), float(y)), frame.scale, (tuple(terms.tolist()),))
    shear = model.shear + float(step[5]) if form.sheared else 0.0
    return replace(
        model,
        origin=model.origin + step[:2],
        along=model.along + step[2:4],
        ratio=model.ratio + float(step[4]),
        shear=shear,
        distortion=bend,
    )


def _start(model: LatticeModel, form: LatticeForm, frame: DistortionFrame) -> LatticeModel:
    """Return the start of the fit of a form; a radial one starts from the cubic terms of ``model``."""
    bend = model.distortion
    if form.radial:
        return replace(model, distortion=_radial(bend, frame, form.radial))
    if not form.degree:
        return replace(model, distortion=None, shear=model.shear if form.sheared else 0.0)
    count = len(polynomial_powers(form.degree))
    terms = np.zeros((2, count))
    if bend is not None and bend.model == "polynomial":
        old = np.array(bend.terms)[:, :count]
        terms[:, : old.shape[1]] = old
    bend = LatticeDistortion("polynomial", frame.middle, frame.scale, tuple(map(tuple, terms.tolist())))
    return replace(model, distortion=bend)


def _radial(bend: LatticeDistortion | None, frame: DistortionFrame, terms: int) -> LatticeDistortion | None:
    """Return the radial distortion nearest to the first orders of a cubic one, or a radial one with another length.

    k |u - c|² (u - c) has the cubic terms k (u_x³ + u_x u_y², …) and the quadratic ones -k (3 c_x u_x² + 2 c_y u_x u_y
    + c_x u_y², …).
    """
    if bend is not None and bend.model == "radial":
        return replace(bend, terms=((*bend.terms[0], *[0.0] * terms)[:terms],))
    if bend is None or bend.degree < 3:
        return None
    (xx, xy, yy, a, _, b, _), (xx2, xy2, yy2, _, c, _, d) = (line[:7] for line in bend.terms)
    k = (a + b + c + d) / 4
    if abs(k) < 1e-9 * frame.scale:
        return None
    centre = -np.array([3 * xx + yy + 2 * xy2, 3 * yy2 + xx2 + 2 * xy]) / (14 * k)
    if np.hypot(*centre) > 1:
        centre = np.zeros(2)
    x, y = np.array(frame.middle) + frame.scale * centre
    return LatticeDistortion("radial", (float(x), float(y)), frame.scale, ((k, *[0.0] * (terms - 1)),))


def fit_form(
    model: LatticeModel,
    form: LatticeForm,
    index: NDArray[np.intp],
    places: Array,
    frame: DistortionFrame,
    *,
    weight: Array | None = None,
    rounds: int = 8,
) -> FittedForm | None:
    """Fit a form of the lattice to measured ``places`` (x, y) with Huber weights (Gauss-Newton).

    ``weight`` ``(n,)`` replaces the weights from the form's residuals. Returns None if the positions do not determine
    the form over the whole frame.
    """
    try:
        model = _start(model, form, frame)
        if form.radial and model.distortion is None:
            return None
        for _ in range(rounds):
            residual = places - model.places(index)
            heavy = huber(residual)[0] if weight is None else weight
            step = _solved(design(model, form, index, frame), residual, heavy)
            model = _moved(model, form, frame, step)
            if not _near(model.distortion, frame):
                return None
            if np.abs(step[2:4]).max() < 1e-9 * model.pitch:
                break
        # without positions near the border, a distortion may fold over there, which raises an error here
        model.indices(frame.outline())
    except (np.linalg.LinAlgError, InputError):
        return None
    residual = places - model.places(index)
    heavy, sigma = huber(residual)
    return FittedForm(form, model, residual, heavy if weight is None else weight, sigma)


def _near(bend: LatticeDistortion | None, frame: DistortionFrame) -> bool:
    """Return whether a distortion's centre is near the frame; a distant centre is not determined."""
    return bend is None or math.dist(bend.centre, frame.middle) <= 1.5 * frame.scale


def _solved(columns: Array, residual: Array, weight: Array) -> Array:
    normal = np.zeros((columns.shape[2],) * 2)
    right = np.zeros(columns.shape[2])
    for axis in (0, 1):
        heavy = columns[axis] * weight[:, None]
        normal += heavy.T @ columns[axis]
        right += heavy.T @ residual[:, axis]
    # the columns differ strongly in scale: pixels, and pixels times lenslets
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / size / size[:, None]
    if np.linalg.cond(scaled) > 1e12:
        raise np.linalg.LinAlgError
    answer: Array = np.linalg.solve(scaled, right / size) / size
    return answer


BLOCKS = 10
"""Number of blocks along each side of the field: neighbours have similar errors, so whole blocks are held out."""

FOLDS = 5
MIN_SHARE = 4.0
"""Smallest number of measured coordinates per free parameter."""

FLEXIBLE_SHARE = 8.0
"""Smallest number of coordinates per free parameter of a form that is used to extrapolate or to weight positions."""

MIN_GAIN_PX = 0.01
"""Displacement (px rms) by which a form must differ from a simpler one to be chosen."""

MIN_GAIN_SHARE = 0.03
"""Fraction of the error of held-out micro-images that a form must remove; less may be the frame's border, or chance."""

MAX_LENSLETS = 10000
"""Largest number of lenslets for comparing forms: more of them add nothing to smooth fields."""


@dataclass(frozen=True, slots=True)
class Blocks:
    """Lenslets sorted by block: ``order``, the bounds of each block in it, and the fold of each block."""

    order: NDArray[np.intp]
    bounds: NDArray[np.intp]
    fold: NDArray[np.intp]

    @classmethod
    def of(cls, places: Array) -> Blocks:
        """Return the blocks of positions ``(n, 2)``, equal rectangles of the occupied field."""
        low, high = places.min(0), places.max(0)
        # a block should contain at least four lenslets
        side = int(np.clip(math.sqrt(len(places) / 4), 2, BLOCKS))
        cell = np.minimum(((places - low) / np.maximum(high - low, 1e-9) * side).astype(np.intp), side - 1)
        number = cell[:, 1] * side + cell[:, 0]
        order = np.argsort(number, kind="stable")
        held, start = np.unique(number[order], return_index=True)
        # knight's moves distribute the blocks of a fold over the whole field
        fold = (held % side + 2 * (held // side)) % FOLDS
        return cls(order, np.append(start, len(places)), fold)


@dataclass(frozen=True, slots=True)
class Selection:
    """The chosen form, and the reason.

    Attributes
    ----------
    fitted
        The form and its fit.
    covariance
        Covariance of the free parameters, in the order of `lfcal.lattice._forms.design`.
    reason
        Reason in words.
    correlation
        Ratio of the variance of block means to the variance that independent lenslets would give.
    """

    fitted: FittedForm
    covariance: Array
    reason: str
    correlation: float


def flexible_form(count: int) -> LatticeForm:
    """Return the most flexible form that ``count`` lenslets determine well."""
    fitting = [form for form in FORMS[1:] if not form.radial and 2 * count >= FLEXIBLE_SHARE * form.size]
    return fitting[-1] if fitting else FORMS[0]


def fit_flexible(
    model: LatticeModel, form: LatticeForm, index: NDArray[np.intp], places: Array, frame: DistortionFrame
) -> FittedForm | None:
    """Return the fit of ``form``, or of the next simpler one that the positions determine over the whole frame."""
    simpler = [other for other in FORMS if not other.radial and other.size <= form.size]
    fits = (fit_form(model, other, index, places, frame) for other in reversed(simpler))
    return next((fit for fit in fits if fit is not None), None)


def select_form(
    model: LatticeModel, index: NDArray[np.intp], places: Array, frame: DistortionFrame, *, straight: bool = False
) -> Selection:
    """Fit every form and return the best-supported one.

    A form with more parameters is chosen if it predicts held-out blocks better, by more than chance and by
    `MIN_GAIN_SHARE`. It must also move the lenslets by at least `MIN_GAIN_PX`.

    Parameters
    ----------
    model
        A lattice near the measured positions.
    index, places
        ``(n, 2)``: lattice indices (q, r) and measured positions (x, y) of the lenslets (pixels).
    frame
        Reference of distortions.
    straight
        Whether to leave out forms with a distortion.
    """
    few = thinned(len(index))
    fits, losses, correlation = _compared(model, index[few], places[few], frame, FORMS[:2] if straight else FORMS)
    unit = correlation * _variance(fits[-1])
    chosen = 0
    for k in range(1, len(fits)):
        extra = fits[k].form.size - fits[chosen].form.size
        chance = 2 * math.sqrt(2 * max(extra, 1)) + 4
        needed = max(chance * unit, MIN_GAIN_SHARE * losses[chosen])
        if losses[chosen] - losses[k] > needed and _moves(fits[chosen], fits[k], index[few]) > MIN_GAIN_PX:
            chosen = k
    # a form determined by few lenslets is also determined by many; still, do not fail for a lattice that was found
    best = fit_form(fits[chosen].model, fits[chosen].form, index, places, frame)
    if best is None:
        index, best = index[few], fits[chosen]
    weight = float(fits[0].weight.sum())
    lost = [math.sqrt(loss / weight) for loss in losses]
    reason = _words(fits, chosen, lost, index)
    return Selection(best, covariance(best, index, frame, correlation), reason, correlation)


def thinned(count: int) -> NDArray[np.intp]:
    """Return which of ``count`` lenslets are used to compare forms: all, or `MAX_LENSLETS` spread over the field."""
    if count <= MAX_LENSLETS:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).permutation(count)[:MAX_LENSLETS])


def _compared(
    model: LatticeModel,
    index: NDArray[np.intp],
    places: Array,
    frame: DistortionFrame,
    forms: tuple[LatticeForm, ...],
) -> tuple[list[FittedForm], list[float], float]:
    """Return the fits of all determined forms, the error of each on held-out blocks, and the correlation."""
    flexible = min(flexible_form(len(index)), forms[-1], key=lambda form: form.size)
    largest = fit_form(model, flexible, index, places, frame)
    if largest is None:
        largest = fit_form(model, FORMS[0], index, places, frame)
    assert largest is not None  # any lattice determines five parameters
    blocks = Blocks.of(places)
    # one set of weights for all, so that residuals can be compared
    fits = [fit for fit in (_offered(largest, form, index, places, frame) for form in forms) if fit is not None]
    return fits, [_held_out_error(fit, index, frame, blocks) for fit in fits], _correlation(largest, blocks)


def _offered(
    largest: FittedForm, form: LatticeForm, index: NDArray[np.intp], places: Array, frame: DistortionFrame
) -> FittedForm | None:
    if form is not FORMS[0] and 2 * len(index) < MIN_SHARE * form.size:
        return None
    return fit_form(largest.model, form, index, places, frame, weight=largest.weight, rounds=5)


def _variance(fit: FittedForm) -> float:
    """Return the weighted squared residual of a coordinate, corrected for the fitted degrees of freedom."""
    free = max(2 * len(fit.residual) - fit.form.size, 1)
    return float((fit.weight[:, None] * fit.residual**2).sum()) / free


def _correlation(fit: FittedForm, blocks: Blocks) -> float:
    """Return the ratio of the squared sum over a block to the one of independent lenslets; at least 1."""
    values = (fit.weight[:, None] * fit.residual)[blocks.order]
    sums = np.add.reduceat(values, blocks.bounds[:-1], axis=0)
    # the part of the block means that the form has absorbed
    kept = max(1 - fit.form.size / (2 * len(sums)), 0.2)
    return max(1.0, float((sums**2).sum()) / max(float((values**2).sum()), 1e-300) / kept)


def _held_out_error(fit: FittedForm, index: NDArray[np.intp], frame: DistortionFrame, blocks: Blocks) -> float:
    """Return the weighted sum of squares of each fold's residuals under a fit to the others (linearised)."""
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
    """Return the distance between the lenslet positions of two fits (px rms)."""
    return math.sqrt(float(((old.model.places(index) - new.model.places(index)) ** 2).sum(1).mean()))


def covariance(fit: FittedForm, index: NDArray[np.intp], frame: DistortionFrame, correlation: float) -> Array:
    """Return the covariance of a fit's free parameters under the weights used.

    Uses A^-1 B A^-1 of M-estimators (Huber 1981), with B from the residuals themselves, times ``correlation``.
    """
    columns = design(fit.model, fit.form, index, frame)
    weight = fit.weight
    # a weight k/d acts only half on a step: along the residual, the influence is constant
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
    """Return why a form was chosen: its effect, and the gain of a richer one on held-out micro-images."""
    best = fits[chosen]
    if chosen:
        away = np.hypot(*(fits[0].model.places(index) - best.model.places(index)).T)
        said = f"{best.form.name}: removes up to {float(away.max()):.2g} px"
    else:
        said = f"{best.form.name}: the rows are straight, and the residuals are random"
    richer = range(chosen + 1, len(fits))
    if not richer:
        return said
    next_best = min(richer, key=lambda k: lost[k])
    gain = lost[chosen] - lost[next_best]
    if gain < 1e-4:
        return f"{said}; no form with more terms predicts held-out micro-images better"
    return f"{said}; {fits[next_best].form.name} would reduce the error by {gain:.1g} px"
