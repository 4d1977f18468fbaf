"""Progress, resumable state and result of a solver."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Progress, in_order
from lfcal.reconstruct.solvers._update_kernels import squares_of
from lfcal.reconstruct.solvers.planes import plane_threads

__all__ = [
    "Reconstruction",
    "SolverProgress",
    "SolverState",
    "SolverWork",
    "progress_of",
    "relative_change",
    "squares",
    "without_state",
]


SQUARES_S = 3e-9
"""Additional processor time (s) per voxel of sums of squares by numpy, instead of by `squares_of`."""


@dataclass(frozen=True, slots=True)
class SolverState:
    """State of a solver between two iterations, from which a run continues as if it had not been stopped.

    Attributes
    ----------
    volume
        Current volume ``(nz, Y, X)``; it must not be modified.
    iteration
        Number of iterations done.
    seconds
        Duration of the iterations so far (s).
    arrays, numbers
        Further arrays and numbers that the solver needs to continue.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import Projector, SolverState, richardson_lucy
    >>> P = Projector(np.array([1, 2, 1]).reshape(1, 1, 1, 1, 3) / 4, (1, 7))
    >>> image = [[0, 0, 2, 4, 2, 0, 0]]
    >>> state: SolverState = richardson_lucy(P, image, 6).state
    >>> resumed, at_once = richardson_lucy(P, image, 4, resume=state), richardson_lucy(P, image, 10)
    >>> print(state.iteration, resumed.state.iteration, np.abs(resumed.volume - at_once.volume).max())
    6 10 0.0
    """

    volume: NDArray[Any]
    iteration: int = 0
    seconds: float = 0.0
    arrays: tuple[NDArray[Any], ...] = ()
    numbers: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class SolverProgress(Progress):
    """Progress record of one finished iteration.

    Attributes
    ----------
    iteration
        Number of iterations done, including those before a resume.
    residual
        Weighted rms difference between the image and the model (projection plus background) of the volume at the start
        of the iteration, relative to the weighted rms of the image.
    likelihood
        Poisson log-likelihood of the same volume minus the largest possible value; 0 for a perfect fit, otherwise
        negative.
    change
        L2 norm of the change of the volume, relative to the norm of the new volume.
    held_out
        Poisson log-likelihood of the held-out pixels minus the largest possible value; NaN if there are none.
    held_out_error
        Standard deviation of ``held_out`` due to the noise of these pixels.
    state
        State after the iteration; None in the history that a solver returns.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import Projector, SolverProgress, richardson_lucy
    >>> P = Projector(np.array([1, 2, 1]).reshape(1, 1, 1, 1, 3) / 4, (1, 7))
    >>> history: tuple[SolverProgress, ...] = richardson_lucy(P, [[0, 0, 2, 4, 2, 0, 0]], 20).history
    >>> for record in history[::10]:
    ...     print(f"iteration {record.iteration}: residual {record.residual:.3f}, change {record.change:.2f}")
    iteration 1: residual 0.752, change 0.69
    iteration 11: residual 0.036, change 0.02
    """

    iteration: int = 0
    residual: float = float("nan")
    likelihood: float = float("nan")
    change: float = float("nan")
    held_out: float = float("nan")
    held_out_error: float = float("nan")
    state: SolverState | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class Reconstruction:
    """Result of a solver.

    Attributes
    ----------
    volume
        Reconstructed volume ``(nz, Y, X)``.
    history
        One record for each iteration of this run, without its state.
    state
        State from which another run can continue, as the argument ``resume``.
    notes
        Remarks on the input and on the run, such as the number of excluded pixels.
    stopped
        Reason why the solver stopped early; empty if all requested iterations were done.
    chi2
        Chi-square per pixel, the weighted mean of the squared residual divided by the noise variance of the same pixel;
        1 if only noise remains. NaN if the noise is unknown (`SolverChoice.gain`, `SolverChoice.noise`).

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import Projector, Reconstruction, richardson_lucy
    >>> P = Projector(np.array([1, 2, 1]).reshape(1, 1, 1, 1, 3) / 4, (1, 7))
    >>> image = [[0, 0, 2, 4, 2, 0, np.nan]]
    >>> result: Reconstruction = richardson_lucy(P, image, 50, tolerance=0.01)
    >>> print(result.volume.shape, result.notes[0], result.stopped, sep="; ")
    (1, 1, 7); 1 non-finite pixel was left out; changed by less than 0.01 in iteration 14
    """

    volume: NDArray[Any]
    history: tuple[SolverProgress, ...]
    state: SolverState
    notes: tuple[str, ...] = ()
    stopped: str = ""
    chi2: float = float("nan")


SolverWork = Generator[SolverProgress, None, Reconstruction]
"""A running solver: yields `SolverProgress`, returns its `Reconstruction`."""


def progress_of(
    state: SolverState,
    total: int,
    method: str,
    *,
    residual: float,
    likelihood: float,
    change: float,
    held_out: tuple[float, float] = (float("nan"), float("nan")),
) -> SolverProgress:
    """Return the record of the iteration that ended in ``state``, for a run of ``total`` iterations.

    ``held_out`` is the pair (`held_out`, `held_out_error`) of `SolverProgress`, and ``method`` is the ``stage`` of the
    record. The other arguments are the attributes with the same names.
    """
    return SolverProgress(
        done=state.iteration,
        total=total,
        stage=method,
        seconds=state.seconds,
        note=f"residual {residual:.4g}, change {change:.2g}",
        iteration=state.iteration,
        residual=residual,
        likelihood=likelihood,
        change=change,
        held_out=held_out[0],
        held_out_error=held_out[1],
        state=state,
    )


def relative_change(new: NDArray[Any], old: NDArray[Any]) -> float:
    """Return the L2 norm of ``new - old`` relative to that of ``new`` (0 if both are zero, 1 if only ``new`` is)."""
    size, change = _sums(new, old)
    return math.sqrt(change / size) if size > 0 else float(old.any())


def squares(volume: NDArray[Any]) -> float:
    """Return the sum of squares of ``volume`` ``(nz, Y, X)`` in double precision."""
    return _sums(volume, volume)[0]


def _sums(new: NDArray[Any], old: NDArray[Any]) -> tuple[float, float]:
    """Return the sums of squares of ``new`` and of ``new - old``, in double precision, plane by plane."""

    def one(z: int) -> tuple[float, float]:
        if not squares_of.spared(SQUARES_S * new[z].size):
            return squares_of(new[z], old[z])
        value, off = (np.asarray(values, np.float64).ravel() for values in (new[z], new[z] - old[z]))
        return float(value @ value), float(off @ off)

    found = list(in_order(one, range(len(new)), plane_threads(len(new), new[0].nbytes)))
    return math.fsum(size for size, _ in found), math.fsum(change for _, change in found)


def without_state(record: SolverProgress) -> SolverProgress:
    """Return ``record`` without its state, for the history."""
    return replace(record, state=None)
