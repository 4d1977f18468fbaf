"""How solvers are tried: the error of a volume against the processor time it took."""

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
"""Times at which errors are compared: as long as so many iterations of Richardson-Lucy take."""

TIE = 1.03
"""Errors within this factor of the least are as good."""


@dataclass(frozen=True)
class Trial:
    """One solver on one frame.

    Attributes
    ----------
    camera, scene, solver
        Their names.
    unit_s
        Processor time of an iteration of Richardson-Lucy with this camera (s).
    seconds, errors
        Processor time after each iteration (s), and the NRMSE of its volume.
    width
        Full width at half maximum of the beads in their planes at the end, over that of the truth; None: no beads.
    stop
        Where a run that stops by left-out pixels ends: its processor time (s), and NRMSE.
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
        """Return the error at a time, in iterations of Richardson-Lucy; None: before the first iteration's end."""
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
    """Return what a solver comes to on a frame in as long as ``longest`` iterations of Richardson-Lucy take.

    ``names``: of scene and solver; ``unit``: the processor time of one such iteration (s). What the solver prepares
    of H is not in the time: it is done once for all frames.
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
        if record is None:  # it ended by itself
            break
        spent += time.process_time() - start
        assert record.state is not None  # a solver's own records have it
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
    """Return processor time (s) and error of a run that stops by itself, of at most as many iterations."""
    choice = SolverChoice(solver, int(longest), BACKGROUND, auto=True)
    start = time.process_time()
    found = reconstruct(P, problem.image, choice)
    return time.process_time() - start, _error(found.volume, problem)


def _error(volume: NDArray[Any], problem: Problem) -> float:
    # threads of linear algebra that wait for more would count as processor time of what is measured next
    with one_blas_thread():
        return nrmse(volume, problem.truth)
