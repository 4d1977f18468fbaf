"""Iteration of all multiplicative solvers: update rules, penalties, extrapolation, subsets and smoothing."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, any_of, array_words, for_each_chunk, format_pixels, in_order
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers._model_noise import ModelNoise
from lfcal.reconstruct.solvers._repeating import Repeating
from lfcal.reconstruct.solvers._stretch import Stretch, best_share, weaker
from lfcal.reconstruct.solvers._subsets import Masks, check_partition
from lfcal.reconstruct.solvers._update_kernels import update_factors
from lfcal.reconstruct.solvers.measurement import GoodnessOfFit, Measurement, no_light
from lfcal.reconstruct.solvers.penalty import Penalty
from lfcal.reconstruct.solvers.planes import plane_threads
from lfcal.reconstruct.solvers.records import (
    Reconstruction,
    SolverProgress,
    SolverState,
    SolverWork,
    progress_of,
    relative_change,
    without_state,
)
from lfcal.reconstruct.solvers.smoothing import DepthSmoothing
from lfcal.reconstruct.solvers.solver import EM, Solver, SolverRun, SolverSettings

__all__ = ["EmOptions", "EmUpdates", "IsraSettings", "RichardsonLucySettings", "iter_em", "iter_run", "penalised"]

ACCELERATIONS = ("none", "biggs-andrews", "nesterov")
"""Methods of extrapolation."""

FACTOR_S = 5e-9
"""Additional processor time (s) per voxel of update factors by numpy, instead of by `update_factors`."""

SMALLEST_FACTOR = 0.1
"""Smallest factor that extrapolation applies to a voxel. Zero would be final: updates cannot raise it again."""


def _update_factors(
    above: NDArray[Any], share: NDArray[Any], sensitivity: NDArray[Any], least: float, out: NDArray[Any]
) -> None:
    """Write the factors of a plane to ``out`` by `update_factors`, or for little work by numpy."""
    if not update_factors.spared(FACTOR_S * out.size):
        update_factors(above, share, sensitivity, least, out)
        return
    out.fill(1)
    np.divide(np.maximum(above, 0), share, out=out, where=(sensitivity > least) & (share > 0))


def check_acceleration(name: str) -> None:
    """Raise `InputError` unless ``name`` is a method of extrapolation."""
    if name not in ACCELERATIONS:
        raise InputError.expected("acceleration", any_of(ACCELERATIONS), repr(name), "choose one of these")


def extrapolate(state: SolverState, name: str) -> tuple[NDArray[Any], float]:
    """Return the start of the next update, extrapolated along the last change, and the length of the step.

    ``biggs-andrews`` computes the step from two successive updates (Biggs & Andrews 1997, equation 10), ``nesterov``
    from the iteration number (Beck & Teboulle 2009, equation 4.2). A state without memory is returned unchanged. A
    voxel keeps at least `SMALLEST_FACTOR` of its value.
    """
    if name == "none" or not state.arrays:
        return state.volume, 0.0
    previous = state.arrays[0]
    if name == "nesterov":
        t = state.numbers[0]
        step = (t - 1.0) / _next_t(t)
    else:
        step = 0.0
        if len(state.arrays) == 3:
            last, before = state.arrays[1], state.arrays[2]
            power = float(np.vdot(before, before))
            step = float(np.vdot(last, before)) / power if power > 0 else 0.0
            # at 1, the extrapolation would not decay if updates stop shrinking.
            step = min(max(step, 0.0), 0.999)
    if step == 0.0:
        return state.volume, 0.0
    ahead = np.empty_like(state.volume)

    def some(first: int, stop: int) -> None:
        for plane, now, then in zip(ahead[first:stop], state.volume[first:stop], previous[first:stop], strict=True):
            np.subtract(now, then, out=plane)
            plane *= plane.dtype.type(step)
            plane += now
            np.maximum(plane, now * plane.dtype.type(SMALLEST_FACTOR), out=plane)

    for_each_chunk(some, len(ahead), plane_threads(len(ahead), ahead[0].nbytes))
    return ahead, step


def remember(
    state: SolverState,
    start: NDArray[Any],
    updated: NDArray[Any],
    name: str,
    *,
    restart: bool,
    likelihood: float,
) -> tuple[tuple[NDArray[Any], ...], tuple[float, ...]]:
    """Return the memory for the next extrapolation: arrays and numbers of the next state.

    ``restart`` discards the memory, because the likelihood has decreased and the last step was too long. ``likelihood``
    is that of ``start``; it is stored as the last number and compared with the next one.
    """
    if name == "none":
        return (), ()
    if name == "nesterov":
        t = 1.0 if restart or not state.numbers else _next_t(state.numbers[0])
        return (state.volume,), (t, likelihood)
    gradient = updated - start
    if restart or not state.arrays:
        return (state.volume, gradient), (likelihood,)
    return (state.volume, gradient, state.arrays[1]), (likelihood,)


def _next_t(t: float) -> float:
    return (1.0 + math.sqrt(1.0 + 4.0 * t * t)) / 2.0


UNSEEN = 1e-6
"""Voxels whose sensitivity is below this fraction of the largest are not updated."""


@dataclass(frozen=True, eq=False, kw_only=True)
class EmUpdates:
    """Options that can be combined with the updates of a multiplicative solver.

    Attributes
    ----------
    penalty
        `TotalVariation` or `Tikhonov`, applied one step late (Green 1990; Dey et al. 2006). None: no penalty.
    acceleration
        ``"none"``, ``"biggs-andrews"`` or ``"nesterov"``.
    subsets
        Masks of image phases for consecutive updates (`interleaved_subsets`, `angular_subsets`). None: all phases
        together.
    relaxation
        Fraction of each update that is applied, in (0, 1].
    smoothing
        `DepthSmoothing` that is applied after each iteration. None: no smoothing.
    """

    penalty: Penalty | None = None
    acceleration: str = "none"
    subsets: Masks | None = None
    relaxation: float = 1.0
    smoothing: DepthSmoothing | None = None


@dataclass(frozen=True)
class EmOptions(EmUpdates):
    """Update rule, options and stopping criteria of a multiplicative solver.

    Attributes
    ----------
    rule
        ``"richardson-lucy"`` (Poisson likelihood) or ``"isra"`` (least squares, Daube-Witherspoon & Muehllehner 1986).
    tolerance
        Stop when the relative change of the volume falls below this value.
    repeating
        Removal of updates that repeat from lenslet to lenslet. None: no removal.
    stretch
        Lengthening of the first updates, with the acceleration ``"nesterov"``. None: no lengthening.
    model_noise
        Noise of H, for the rule ``"richardson-lucy"``. None: not used.
    """

    rule: str = "richardson-lucy"
    tolerance: float = 0.0
    repeating: Repeating | None = None
    stretch: Stretch | None = None
    model_noise: ModelNoise | None = None

    def __post_init__(self) -> None:
        """Check names and ranges, and refuse options that exclude each other."""
        if self.rule not in ("richardson-lucy", "isra"):
            raise InputError.expected("update rule", "richardson-lucy or isra", repr(self.rule), "choose one of these")
        check_acceleration(self.acceleration)
        if not 0 < self.relaxation <= 1:
            raise InputError.expected(
                "relaxation",
                "a value above 0 and at most 1",
                self.relaxation,
                "choose a value in this range; 1 is usual",
            )
        if self.subsets is not None and self.acceleration != "none":
            raise InputError.expected(
                "solver",
                "subsets or an acceleration",
                "both",
                "choose one of them, because together they extrapolate twice",
            )
        if self.stretch is not None and self.acceleration != "nesterov":
            raise InputError.expected(
                "stretched updates", "the acceleration nesterov", self.acceleration, "choose this acceleration"
            )


@dataclass(frozen=True, eq=False)
class IsraSettings(EmUpdates, SolverSettings):
    """Settings of ISRA: those common to all solvers, and options of the updates.

    Attributes
    ----------
    iterations
        Number of iterations, in addition to those of ``resume``.
    initial
        Non-negative initial volume ``(nz, Y, X)``; by default uniform, with the total light of the image.
    """

    iterations: int = 20
    _: KW_ONLY
    initial: ArrayLike | None = None

    def options(self, rule: str) -> EmOptions:
        """Return the options of the updates for the update rule ``rule``."""
        own = {one.name: getattr(self, one.name) for one in fields(EmUpdates)}
        return EmOptions(rule, self.tolerance, **own)


@dataclass(frozen=True, eq=False)
class RichardsonLucySettings(IsraSettings):
    """Settings of Richardson-Lucy: those of ISRA, and the read noise.

    Attributes
    ----------
    read_noise
        Rms read noise (counts), which is modelled as additional Poisson noise.
    """

    _: KW_ONLY
    read_noise: float = 0.0


@dataclass(frozen=True)
class _Part:
    """One subset: its projector, its pixels, and arrays that all its updates need."""

    projector: Projector
    mask: NDArray[np.bool_] | None
    sensitivity: NDArray[Any]
    matched: NDArray[Any] | None
    """HT(w f), for ISRA only."""


@dataclass
class _Pace:
    """State of the stretching of updates.

    Attributes
    ----------
    strength
        Strength by which updates are stretched.
    model
        Model ``(Y, X)`` at the start of the last update.
    likelihood
        Likelihood of that model.
    """

    strength: float
    model: NDArray[Any] | None = None
    likelihood: float = -np.inf

    def at(self, model: NDArray[Any], data: Measurement, floor: float) -> float:
        """Return the strength of the update that begins with ``model``."""
        if self.strength > 0 and self.model is not None:
            self.strength = weaker(self.strength, self.model, model, data, floor)
        self.model = model
        return self.strength

    def remember(
        self, state: SolverState, done: _Pass, acceleration: str, *, restart: bool
    ) -> tuple[tuple[NDArray[Any], ...], tuple[float, ...]]:
        """Return the memory for the next update: arrays and numbers of the next state."""
        arrays, numbers = remember(
            state, done.start, done.volume, acceleration, restart=restart, likelihood=self.likelihood
        )
        if self.strength > 0 and self.model is not None:
            return (*arrays, self.model), (*numbers, self.strength)
        return arrays, numbers


@dataclass(frozen=True)
class _Pass:
    """One pass over all subsets: the volumes before and after it, and the fit in between.

    ``turned_back`` states that the last update was stretched too far and was shortened before this pass.
    """

    start: NDArray[Any]
    volume: NDArray[Any]
    fit: GoodnessOfFit
    turned_back: bool


def iter_em(
    P: Projector,
    data: Measurement,
    iterations: int,
    options: EmOptions,
    *,
    initial: ArrayLike | None = None,
    resume: SolverState | None = None,
) -> SolverWork:
    """Run ``iterations`` iterations, yield a `SolverProgress` after each, and return the `Reconstruction`.

    Parameters
    ----------
    P
        Projector of H.
    data
        Measurement: image, weights and background.
    iterations
        Number of iterations, in addition to those of ``resume``.
    options
        Update rule, options and stopping criteria.
    initial
        Non-negative initial volume ``(nz, Y, X)``; by default uniform, with the total light of the image.
    resume
        State of a stopped run to continue from; it replaces ``initial``.
    """
    _check(P, data, iterations)
    parts = _parts(P, data, options)
    state = resume if resume is not None else SolverState(_start(P, data, parts, initial))
    if state.volume.shape != P.volume_shape:
        raise InputError.expected("start", f"shape {P.volume_shape}", state.volume.shape, "use the same projector")
    history: list[SolverProgress] = []
    total = state.iteration + iterations
    stopped = ""
    pace = _pace(state, options)
    for _ in range(iterations):
        began = time.perf_counter()
        start, step = extrapolate(state, options.acceleration)
        before = pace.likelihood
        done = _iterate(start, parts, data, options, pace, state.arrays[0] if state.arrays else None)
        volume, fit = done.volume, done.fit
        change = relative_change(volume, state.volume)
        if done.turned_back:
            state = replace(state, volume=done.start)
        # the likelihood is that of the extrapolated start: if it decreased, the last step was too long.
        restart = done.turned_back or (step > 0 and fit.likelihood < before)
        arrays, numbers = pace.remember(state, done, options.acceleration, restart=restart)
        # otherwise the volume at the start of the iteration stays in memory during the next one
        del done, start
        seconds = state.seconds + time.perf_counter() - began
        state = SolverState(volume, state.iteration + 1, seconds, arrays, numbers)
        record = progress_of(
            state,
            total,
            options.rule,
            residual=fit.residual,
            likelihood=fit.likelihood,
            change=change,
            held_out=(fit.held_out, fit.held_out_error),
        )
        history.append(without_state(record))  # otherwise the history would keep a volume per iteration
        yield record
        if stopped := _why_stop(change, state.iteration, options):
            break
    return Reconstruction(state.volume, tuple(history), state, data.notes, stopped)


def iter_run(P: Projector, image: ArrayLike, run: SolverRun, options: EmOptions) -> SolverWork:
    """Iterate as requested in ``run``, with the ``options`` of a particular solver."""
    options = replace(options, tolerance=run.tolerance)
    return iter_em(P, run.measure(P, image), run.iterations, options, initial=run.initial, resume=run.resume)


def penalised(name: str, title: str, penalty: Callable[..., Penalty], rank: int) -> Solver:
    """Return the `Solver` for Richardson-Lucy with a penalty; its option ``strength`` is the weight of the penalty."""
    iterate = partial(_iter_penalised, penalty=penalty)
    return Solver(name, title, iterate, EM | {"strength"}, rank=rank, volumes=(3, 4), settles=True)


def _iter_penalised(P: Projector, image: ArrayLike, run: SolverRun, *, penalty: Callable[..., Penalty]) -> SolverWork:
    weight = {} if run.strength is None else {"weight": run.strength}
    return iter_run(P, image, run, EmOptions(penalty=penalty(**weight)))


def _why_stop(change: float, iteration: int, options: EmOptions) -> str:
    """Return the reason to end after an iteration that changed the volume by ``change``; empty: continue."""
    settled = options.model_noise is not None and options.model_noise.settled()
    if change < options.tolerance:
        return f"changed by less than {options.tolerance:g} in iteration {iteration}"
    return f"only noise of H and of the frame remains after iteration {iteration}" if settled else ""


# -- steps ---------------------------------------------------------------------------------------------
def _check(P: Projector, data: Measurement, iterations: int) -> None:
    if data.image.shape != P.image_shape:
        raise InputError.expected(
            "image", format_pixels(P.image_shape), format_pixels(data.image.shape), "make a projector for this size"
        )
    if iterations < 1:
        raise InputError.expected("iterations", "a number of at least 1", iterations, "choose a number such as 20")


def _parts(P: Projector, data: Measurement, options: EmOptions) -> tuple[_Part, ...]:
    if options.subsets is None:
        return (_part(P, None, data, options),)
    check_partition(options.subsets, P.period)
    return tuple(_part(P.subset(mask), P.grid.tiled(mask), data, options) for mask in options.subsets)


def _part(P: Projector, mask: NDArray[np.bool_] | None, data: Measurement, options: EmOptions) -> _Part:
    sensitivity = P.adjoint(data.ones())
    np.maximum(sensitivity, 0, out=sensitivity)
    matched = P.adjoint(data.weighted(data.image)) if options.rule == "isra" else None
    return _Part(P, mask, sensitivity, matched)


def _start(P: Projector, data: Measurement, parts: tuple[_Part, ...], initial: ArrayLike | None) -> NDArray[Any]:
    sensitivity = parts[0].sensitivity
    if len(parts) > 1:
        sensitivity = sensitivity.copy()
        for part in parts[1:]:
            sensitivity += part.sensitivity
    reach = float(np.sum(sensitivity, dtype=np.float64))
    if not reach > 0 and data.ones().any():
        raise no_light()
    if initial is not None:
        volume = np.array(initial, P.dtype)
        if volume.shape != P.volume_shape or not np.isfinite(volume).all() or (volume < 0).any():
            raise InputError.expected(
                "initial volume",
                f"finite values of 0 or more, with shape {P.volume_shape}",
                array_words(volume),
                "give a volume of this shape without negative values",
            )
        return volume
    light = float(data.weighted(np.maximum(data.image - data.background, 0)).sum(dtype=np.float64))
    level = light / reach if reach > 0 else 0.0
    # a voxel that no pixel sees would keep its start value, so it starts at zero.
    start = np.zeros(P.volume_shape, P.dtype)
    start[sensitivity > UNSEEN * np.max(sensitivity)] = level
    return start


def _pace(state: SolverState, options: EmOptions) -> _Pace:
    """Return the strength of the next update, with the model and the likelihood of the last one, from the state."""
    if state.iteration == 0:
        return _Pace(0.0 if options.stretch is None else options.stretch.first)
    if not state.numbers:
        return _Pace(0.0)
    if options.stretch is None or len(state.arrays) < 2:
        return _Pace(0.0, likelihood=state.numbers[-1])
    return _Pace(state.numbers[-1], state.arrays[1], state.numbers[-2])


def _iterate(
    volume: NDArray[Any],
    parts: tuple[_Part, ...],
    data: Measurement,
    options: EmOptions,
    pace: _Pace,
    previous: NDArray[Any] | None,
) -> _Pass:
    """Return the result of one pass over all subsets that starts from ``volume``.

    If a stretched update has lowered the likelihood, the pass starts at the point of highest likelihood between
    ``previous``, the volume before that update, and ``volume``.
    """
    square, likelihood, held_out, error, norm = 0.0, 0.0, 0.0, 0.0, float(np.linalg.norm(data.weighted(data.image)))
    start, turned_back = volume, False
    for part in parts:
        model, floor, fit = _compared(part, volume, data)
        likelihood += fit.likelihood
        held_out += fit.held_out
        error += fit.held_out_error**2
        # subsets are disjoint, so their squares add up to that of the whole image, each at its own estimate.
        own = data.image if part.mask is None else data.image * part.mask
        square += (fit.residual * float(np.linalg.norm(data.weighted(own)))) ** 2
        stretched, strength = pace.strength > 0, pace.at(model, data, floor)
        reached = fit.likelihood
        if stretched and reached < pace.likelihood and previous is not None:
            start, model, floor = _shortened(part, previous, volume, model, data)
            volume, turned_back, pace.model = start, True, model
            reached = data.fit(model, part.mask, floor).likelihood
        volume = _update(volume, model, floor, part, data, options, strength=strength)
    pace.likelihood = likelihood if len(parts) > 1 else reached
    if options.smoothing is not None:
        volume = options.smoothing.apply(volume)
    residual = fit.residual if len(parts) == 1 else (square**0.5 / norm if norm > 0 else 0.0)
    return _Pass(start, volume, GoodnessOfFit(residual, likelihood, held_out, error**0.5), turned_back)


def _compared(part: _Part, volume: NDArray[Any], data: Measurement) -> tuple[NDArray[Any], float, GoodnessOfFit]:
    """Return the model ``(Y, X)`` of a volume, the value below which it is only rounding error, and the fit."""
    P = part.projector
    model = P.forward(volume) + data.background
    floor = max(P.rounding * float(model.max(initial=0)), float(np.finfo(model.dtype).tiny))
    return model, floor, data.fit(model, part.mask, floor)


def _shortened(
    part: _Part, previous: NDArray[Any], volume: NDArray[Any], model: NDArray[Any], data: Measurement
) -> tuple[NDArray[Any], NDArray[Any], float]:
    """Return the most likely volume between two volumes, its model, and the size of rounding errors of models.

    ``model`` is the model of ``volume``. Because models are linear in the volume, only ``previous`` is projected.
    """
    first, floor, _ = _compared(part, previous, data)
    share = first.dtype.type(best_share(first, model, data, floor))
    between = np.subtract(volume, previous)
    between *= share
    between += previous
    return between, first + share * (model - first), floor


def _ratio(
    volume: NDArray[Any], model: NDArray[Any], floor: float, part: _Part, data: Measurement, options: EmOptions
) -> NDArray[Any]:
    """Return the ratio of the frame to the image of a volume, ``(Y, X)``."""
    if options.model_noise is not None:
        return options.model_noise.ratio(volume, model, part.mask, data, floor)
    found: NDArray[Any] = np.divide(data.image, model, out=np.zeros_like(model), where=model > floor)
    return found


def _update(
    volume: NDArray[Any],
    model: NDArray[Any],
    floor: float,
    part: _Part,
    data: Measurement,
    options: EmOptions,
    *,
    strength: float,
) -> NDArray[Any]:
    """Return the volume after the update of one subset; values of a model below ``floor`` are rounding errors."""
    P = part.projector
    top = part.sensitivity.max(initial=0)
    if options.rule == "isra":
        assert part.matched is not None
        above, below = part.matched, P.adjoint(data.weighted(model))
        updated = below
    else:
        ratio = _ratio(volume, model, floor, part, data, options)
        above, below = P.adjoint(data.weighted(ratio)), part.sensitivity
        updated = above
    scale = below.max(initial=0) if options.rule == "isra" else top
    steep = None if options.penalty is None else options.penalty.gradient(volume)

    def one(z: int) -> tuple[float, float]:
        """Update a plane in an array that is no longer needed; return its light without and with stretching."""
        share = below[z]
        if steep is not None:
            # a steep gradient could make the denominator negative or tiny, so limit the growth to a factor of ten.
            share = np.maximum(below[z] + scale * steep[z], 0.1 * below[z])
        factor = np.empty_like(volume[z])
        _update_factors(above[z], share, part.sensitivity[z], float(UNSEEN * top), factor)
        stretched = options.stretch is not None and strength > 0
        if options.repeating is not None or stretched:
            seen = (part.sensitivity[z] > UNSEEN * top) & (share > 0)
        if options.repeating is not None:
            factor = options.repeating.without(z, factor, seen)
        light = longer = 0.0
        if options.stretch is not None and stretched:
            weight = part.sensitivity[z] * volume[z]
            light = float(np.vdot(weight, factor))
            factor = options.stretch.apply(z, factor, seen, strength)
            longer = float(np.vdot(weight, factor))
        if options.relaxation < 1:
            factor = 1 + options.relaxation * (factor - 1)
        np.multiply(volume[z], factor.astype(volume.dtype, copy=False), out=updated[z])
        return light, longer

    found = list(in_order(one, range(len(volume)), plane_threads(len(volume), volume[0].nbytes)))
    light, longer = (sum(own) for own in zip(*found, strict=True))
    if longer > 0:
        # the same light in the image as with the plain update
        updated *= updated.dtype.type(light / longer)
    return updated
