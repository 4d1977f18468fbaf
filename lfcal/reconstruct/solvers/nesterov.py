"""Richardson-Lucy, extrapolated by the iteration number (Beck & Teboulle 2009, equation 4.2)."""

from __future__ import annotations

from numpy.typing import ArrayLike

from lfcal.reconstruct.projectors.projector import Projector
from lfcal.reconstruct.solvers.em import EmOptions, iter_run
from lfcal.reconstruct.solvers.records import SolverWork
from lfcal.reconstruct.solvers.solver import EM, Solver, SolverRun

__all__ = ["SOLVER"]


def iterate(P: Projector, image: ArrayLike, run: SolverRun) -> SolverWork:
    """Run accelerated Richardson-Lucy."""
    return iter_run(P, image, run, EmOptions(acceleration="nesterov"))


SOLVER = Solver("rl-nesterov", "Richardson-Lucy, accelerated (Nesterov)", iterate, EM, rank=50, volumes=(5, 5))
