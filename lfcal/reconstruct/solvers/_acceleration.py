"""Extrapolation between iterations: the same estimate in fewer of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, for_each_chunk
from lfcal.reconstruct.solvers.planes import plane_threads
from lfcal.reconstruct.solvers.records import SolverState

__all__ = ["ACCELERATIONS", "extrapolate", "remember"]

ACCELERATIONS = ("none", "biggs-andrews", "nesterov")
"""Ways to extrapolate."""

LEAST_LEFT = 0.1
"""Share of a voxel that extrapolation leaves. Zero would be final: multiplicative updates cannot raise it again."""


def check_acceleration(name: str) -> None:
    """Raise `InputError` unless ``name`` is a way to extrapolate."""
    if name not in ACCELERATIONS:
        raise InputError.expected("acceleration", " or ".join(ACCELERATIONS), repr(name), "choose one of these")


def extrapolate(state: SolverState, name: str) -> tuple[NDArray[Any], float]:
    """Return the point the next update starts from, and the step taken along the last change.

    ``biggs-andrews`` takes the step from two successive updates (Biggs & Andrews 1997, equation 10), ``nesterov``
    from the iteration number (Beck & Teboulle 2009, equation 4.2). A state without memory is returned as it is.
    A voxel keeps at least `LEAST_LEFT` of its value.
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
            # at 1 the extrapolation would not die out where updates stop shrinking.
            step = min(max(step, 0.0), 0.999)
    if step == 0.0:
        return state.volume, 0.0
    ahead = np.empty_like(state.volume)

    def some(first: int, stop: int) -> None:
        for plane, now, then in zip(ahead[first:stop], state.volume[first:stop], previous[first:stop], strict=True):
            np.subtract(now, then, out=plane)
            plane *= plane.dtype.type(step)
            plane += now
            np.maximum(plane, now * plane.dtype.type(LEAST_LEFT), out=plane)

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
    """Return what the next extrapolation needs: arrays and numbers of the next state.

    ``restart`` forgets the past: the likelihood had fallen, so the last step was too long. ``likelihood``, that of
    ``start``, is the last of the numbers: the next one is compared with it.
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
