"""A series of frames, one volume each."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike, NDArray

from lfcal.errors import InputError
from lfcal.progress import Progress, Work
from lfcal.reconstruct.projectors.projector import Projector
from lfcal.reconstruct.solvers.choice import SOLVERS, SolverChoice, iter_reconstruct
from lfcal.reconstruct.solvers.records import Reconstruction

__all__ = ["FrameResult", "check_warm", "iter_series"]


@dataclass(frozen=True, slots=True)
class FrameResult:
    """How one frame of a series went.

    Attributes
    ----------
    name
        The frame's.
    iterations
        Done.
    residual
        Of the last iteration.
    seconds
        Reading and writing included.
    notes
        What was done to the frame.
    stopped
        Why the solver ended where it did; empty where all iterations were done.
    """

    name: str
    iterations: int
    residual: float
    seconds: float
    notes: tuple[str, ...]
    stopped: str = ""


def check_warm(choice: SolverChoice) -> None:
    """Raise `InputError` unless the solver of ``choice`` can start from a volume."""
    if "initial" not in choice.solver.honours:
        able = " or ".join(solver.name for solver in SOLVERS if "initial" in solver.honours)
        raise InputError.expected("warm start", "a solver that starts from a volume", choice.name, f"choose {able}")


def iter_series(
    P: Projector,
    frames: Iterable[tuple[str, Callable[[], NDArray[Any]]]],
    count: int,
    choice: SolverChoice,
    save: Callable[[str, Reconstruction], None],
    *,
    weights: ArrayLike | None = None,
    warm: bool = False,
) -> Work[tuple[FrameResult, ...]]:
    """Reconstruct each frame and hand it to ``save``; yields progress in iterations over the whole series.

    Parameters
    ----------
    P
        Projector pair; its set-up is shared by all frames.
    frames
        Name and reader of each frame, ``(Y, X)``.
    count
        How many there are.
    choice
        Solver.
    save
        Called with name and result.
    weights
        Weight of each pixel.
    warm
        Start each frame from the last one's volume: fewer iterations where little moves between frames. Voxels
        that became zero stay zero under multiplicative solvers.

    Raises
    ------
    InputError
        If frames, weights and choice do not fit, or ``warm`` is asked of a solver that has no start.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.progress import drain
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
        work = iter_reconstruct(P, read(), choice, weights=weights, initial=previous)
        try:
            while True:
                record = next(work)
                done = k * choice.iterations + record.done
                note = f"{name}: {record.note}"
                yield Progress(done, total, "reconstructing", time.perf_counter() - began, note)
        except StopIteration as stop:
            result: Reconstruction = stop.value
        finally:
            work.close()
        save(name, result)
        # Only the volume: the solver's memory belongs to the frame before.
        previous = result.volume if warm else None
        last = result.history[-1]
        seconds = time.perf_counter() - start
        done = result.state.iteration
        results.append(FrameResult(name, done, last.residual, seconds, result.notes, result.stopped))
    return tuple(results)
