"""A series of frames, one volume each."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike, NDArray

from lfcal.progress import Progress, Work, drain
from lfcal.reconstruct.projectors.projector import Projector
from lfcal.reconstruct.solvers.choice import SolverChoice, iter_reconstruct
from lfcal.reconstruct.solvers.records import Reconstruction

__all__ = ["FrameResult", "iter_series"]


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
    """

    name: str
    iterations: int
    residual: float
    seconds: float
    notes: tuple[str, ...]


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
        Trust in each pixel.
    warm
        Start each frame from the last one's volume: fewer iterations where little moves between frames. Voxels
        that became zero stay zero under multiplicative solvers.
    """
    began = time.perf_counter()
    total = count * choice.iterations
    results: list[FrameResult] = []
    previous: NDArray[Any] | None = None
    for k, (name, read) in enumerate(frames):
        start = time.perf_counter()
        multiplicative = choice.name != "cg"
        work = iter_reconstruct(P, read(), choice, weights=weights, initial=previous if multiplicative else None)
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
        previous = result.volume if warm else None
        last = result.history[-1]
        results.append(FrameResult(name, last.iteration, last.residual, time.perf_counter() - start, result.notes))
    return tuple(results)


def series(
    P: Projector,
    frames: Iterable[tuple[str, Callable[[], NDArray[Any]]]],
    count: int,
    choice: SolverChoice,
    save: Callable[[str, Reconstruction], None],
    **options: Any,
) -> tuple[FrameResult, ...]:
    """Reconstruct each frame: `iter_series`, drained."""
    return drain(iter_series(P, frames, count, choice, save, **options))
