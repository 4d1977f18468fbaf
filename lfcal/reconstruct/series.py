"""Reconstruct a series of frames, one volume for each."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike, NDArray

from lfcal.base import FileFormatError, InputError, Progress, Work, any_of
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers import SOLVERS, NothingMeasured, Reconstruction, SolverChoice, SolverProgress, iter_solve

__all__ = ["FrameResult", "check_any", "check_warm", "iter_frame", "iter_series"]


@dataclass(frozen=True, slots=True)
class FrameResult:
    """Result of one frame of a series.

    Attributes
    ----------
    name
        Name of the frame.
    iterations
        Number of iterations done.
    residual
        Relative residual of the last iteration, as in `SolverProgress`.
    seconds
        Duration, including reading and writing (s).
    notes
        Remarks of the solver, as in `Reconstruction`.
    stopped
        Reason why the solver stopped early; empty if all iterations were done.
    failed
        Reason why the frame has no volume; empty if it has one.
    chi2
        Chi-square per pixel, as in `Reconstruction`; NaN without a volume.
    """

    name: str
    iterations: int
    residual: float
    seconds: float
    notes: tuple[str, ...]
    stopped: str = ""
    failed: str = ""
    chi2: float = float("nan")

    @classmethod
    def without_volume(cls, name: str, why: str, seconds: float) -> FrameResult:
        """Return the result for the frame ``name``, which has no volume for the reason ``why``.

        ``seconds`` is the time spent on the frame (s).
        """
        return cls(name, 0, float("nan"), seconds, (), failed=why)


def check_any(results: Sequence[FrameResult]) -> None:
    """Raise `InputError` if no frame of a series has a volume, because all frames may then have a common fault."""
    if results and all(result.failed for result in results):
        others = f"; none of the {len(results)} frames was reconstructed" if len(results) > 1 else ""
        raise InputError(f"{results[0].failed}{others}")


def check_warm(choice: SolverChoice) -> None:
    """Raise `InputError` unless the solver of ``choice`` can start from a volume."""
    if "initial" not in choice.solver.honours:
        able = any_of(solver.name for solver in SOLVERS if "initial" in solver.honours)
        raise InputError.expected("warm start", "a solver that starts from a volume", choice.name, f"choose {able}")


def iter_frame(
    P: Projector,
    read: Callable[[], NDArray[Any]],
    choice: SolverChoice,
    *,
    weights: ArrayLike | None = None,
    initial: ArrayLike | None = None,
) -> Generator[SolverProgress, None, Reconstruction | InputError]:
    """Reconstruct one frame; return a `Reconstruction`, or the error if the frame is damaged or has no valid light.

    Other errors are raised, because they would also occur with the next frame. ``read`` is a function that returns the
    frame ``(Y, X)`` in counts; the other arguments are as in `iter_reconstruct`.
    """
    try:
        image = read()
    except FileFormatError as error:
        return error
    try:
        return (yield from iter_solve(P, image, choice, weights=weights, initial=initial))
    except NothingMeasured as error:
        return error


def iter_series(
    P: Projector,
    frames: Iterable[tuple[str, Callable[[], NDArray[Any]]]],
    count: int,
    choice: SolverChoice,
    save: Callable[[str, Reconstruction], None],
    *,
    weights: ArrayLike | None = None,
    warm: bool = False,
    missing: Callable[[str], None] | None = None,
) -> Work[tuple[FrameResult, ...]]:
    """Reconstruct each frame, pass the result to ``save``, and return a `FrameResult` for each.

    If a frame is damaged or has no light, its `FrameResult` states the reason, and the run continues with the next
    frame. If there is only one frame, its error is raised. Progress is counted in iterations over the entire series.

    Parameters
    ----------
    P
        Projector for the shape of the frames, extended by the margin of ``choice`` on each side.
    frames
        Pairs of the name of a frame and a function that returns it, ``(Y, X)`` in counts.
    count
        Number of frames.
    choice
        Solver and its settings.
    save
        Function that is called with the name and the result of each frame.
    weights
        Weight of each pixel, ``(Y, X)``, not negative, for all frames. None: 1.
    warm
        Whether to start each frame from the last volume, if there is one. Fewer iterations are then needed if the
        object hardly changes between frames. With multiplicative solvers, voxels that became zero stay zero.
    missing
        Function that is called instead of ``save`` with the name of each frame without a volume. None: no function.

    Raises
    ------
    InputError
        If frames, weights and choice do not fit together, the solver cannot use ``warm``, or no frame has a volume.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.base import drain
    >>> from lfcal.reconstruct import FrameResult, Projector, SolverChoice, iter_series, load_volume, save_volume
    >>> P = Projector(np.full((1, 1, 1, 3, 3), 1 / 9), (16, 16))
    >>> frames = [("dim", lambda: np.full((16, 16), 10.0)), ("bright", lambda: np.full((16, 16), 20.0))]
    >>> def save(name, result):
    ...     save_volume(f"{name}.tif", result.volume)
    >>> done: list[FrameResult] = drain(iter_series(P, frames, len(frames), SolverChoice("rl", iterations=3), save))
    >>> print([(one.name, one.iterations) for one in done])
    [('dim', 3), ('bright', 3)]
    >>> print(f"{load_volume('bright.tif').sum() / load_volume('dim.tif').sum():.2f} times the light")
    2.00 times the light
    """
    if warm:
        check_warm(choice)
    began = time.perf_counter()
    total = count * choice.iterations
    results: list[FrameResult] = []
    previous: NDArray[Any] | None = None
    for k, (name, read) in enumerate(frames):
        start = time.perf_counter()
        work = iter_frame(P, read, choice, weights=weights, initial=previous)
        try:
            while True:
                record = next(work)
                done = k * choice.iterations + record.done
                note = f"{name}: {record.note}"
                yield Progress(done, total, "reconstructing", time.perf_counter() - began, note)
        except StopIteration as stop:
            result: Reconstruction | InputError = stop.value
        finally:
            work.close()
        if isinstance(result, InputError):
            if count == 1:
                raise result
            if missing is not None:
                missing(name)
            results.append(FrameResult.without_volume(name, str(result), time.perf_counter() - start))
            continue
        save(name, result)
        # only the volume: the other solver state belongs to the previous frame.
        previous = result.volume if warm else None
        last = result.history[-1]
        seconds = time.perf_counter() - start
        done = result.state.iteration
        results.append(FrameResult(name, done, last.residual, seconds, result.notes, result.stopped, chi2=result.chi2))
    check_any(results)
    return tuple(results)
