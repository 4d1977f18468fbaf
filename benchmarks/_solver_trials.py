"""Trials of solvers: the error of the volume against processor time."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from benchmarks._solver_scenes import BACKGROUND, Problem, Subject
from lfcal.base.threads import one_blas_thread
from lfcal.reconstruct import Projector
from lfcal.reconstruct.phantoms import nrmse
from lfcal.reconstruct.resolution import bead_widths
from lfcal.reconstruct.solvers.choice import SolverChoice, iter_reconstruct, reconstruct
from lfcal.reconstruct.solvers.multiplicative import richardson_lucy

__all__ = ["TIE", "UNITS", "Trial", "trial", "unit_of"]

UNITS = (5, 10, 20)
"""Times at which errors are compared, in iterations of Richardson-Lucy."""

TIE = 1.03
"""Errors within this factor of the smallest one count as a tie."""


@dataclass(frozen=True)
class Trial:
    """One solver on one frame.

    Attributes
    ----------
    camera, scene, solver
        Names of camera, scene and solver.
    unit_s
        Processor time of an iteration of Richardson-Lucy with this camera (s).
    seconds, errors
        Processor time after each iteration (s), and the NRMSE of its volume.
    width
        Full width at half maximum of the beads in their planes at the end, relative to the true width; None: no beads.
    stop
        Processor time (s) and NRMSE of a run that stops with held-out pixels.
    """

    camera: str
    scene: str
    solver: str
    unit_s: float
    seconds: tuple[float, ...]
    errors: tuple[float, ...]
    width: float | None
    stop: tuple[float, float]

    def at(self, units: float) -> float | None:
        """Return the error at a time, in iterations of Richardson-Lucy; None before the end of the first iteration."""
        done = [e for s, e in zip(self.seconds, self.errors, strict=True) if s <= units * self.unit_s * (1 + 1e-9)]
        return done[-1] if done else None


def unit_of(P: Projector, problem: Problem) -> float:
    """Return the processor time of an iteration of Richardson-Lucy (s): the median of some runs."""
    richardson_lucy(P, problem.image, 1, background=BACKGROUND)
    found = []
    for _ in range(5):
        start = time.process_time()
        richardson_lucy(P, problem.image, 5, background=BACKGROUND)
        found.append((time.process_time() - start) / 5)
    return statistics.median(found)


def trial(
    subject: Subject, P: Projector, problem: Problem, names: tuple[str, str], unit: float, longest: float
) -> Trial:
    """Return the trial of a solver on a frame, for the time of ``longest`` iterations of Richardson-Lucy.

    ``names`` are those of scene and solver, and ``unit`` is the processor time of one such iteration (s). The time
    excludes what the solver prepares of H, because this is done once for all frames.
    """
    choice = SolverChoice(names[1], 10 * int(longest), BACKGROUND)
    reconstruct(P, problem.image, SolverChoice(names[1], 1, BACKGROUND))
    seconds: list[float] = []
    volumes: list[NDArray[Any]] = []
    spent = 0.0
    work = iter_reconstruct(P, problem.image, choice)
    while spent < longest * unit:
        start = time.process_time()
        record = next(work, None)
        if record is None:  # the solver ended before the time limit
            break
        spent += time.process_time() - start
        assert record.state is not None  # records that a solver yields have a state
        volumes.append(record.state.volume.copy())
        seconds.append(spent)
    work.close()
    errors = [_error(volume, problem) for volume in volumes]
    width = None
    if len(problem.beads) and volumes:
        width = float(bead_widths(volumes[-1], problem.beads) / bead_widths(problem.truth, problem.beads))
    return Trial(
        subject.name, *names, unit, tuple(seconds), tuple(errors), width, _stopped(P, problem, names[1], longest)
    )


def _stopped(P: Projector, problem: Problem, solver: str, longest: float) -> tuple[float, float]:
    """Return processor time (s) and error of a run that stops automatically, of at most ``longest`` iterations."""
    choice = SolverChoice(solver, int(longest), BACKGROUND, auto=True)
    start = time.process_time()
    found = reconstruct(P, problem.image, choice)
    return time.process_time() - start, _error(found.volume, problem)


def _error(volume: NDArray[Any], problem: Problem) -> float:
    # waiting threads of linear algebra would count as processor time of the next measurement
    with one_blas_thread():
        return nrmse(volume, problem.truth)
