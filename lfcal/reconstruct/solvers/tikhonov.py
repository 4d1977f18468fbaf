"""Richardson-Lucy with the squared gradient as penalty, one step late (Tikhonov-Miller)."""

from __future__ import annotations

from numpy.typing import ArrayLike

from lfcal.reconstruct.projectors.projector import Projector
from lfcal.reconstruct.solvers.em import EmOptions, iter_run
from lfcal.reconstruct.solvers.penalty import Tikhonov
from lfcal.reconstruct.solvers.records import SolverWork
from lfcal.reconstruct.solvers.solver import EM, Solver, SolverRun

__all__ = ["SOLVER"]


def iterate(P: Projector, image: ArrayLike, run: SolverRun) -> SolverWork:
    """Run Richardson-Lucy with the penalty at the strength asked for."""
    penalty = Tikhonov() if run.strength is None else Tikhonov(run.strength)
    return iter_run(P, image, run, EmOptions(penalty=penalty))


SOLVER = Solver(
    "rl-tikhonov",
    "Richardson-Lucy with Tikhonov-Miller: less noise, softer",
    iterate,
    EM | {"strength"},
    rank=30,
    volumes=(3, 4),
    settles=True,
)
