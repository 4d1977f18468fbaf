"""Richardson-Lucy with total variation, one step late (Dey et al. 2006)."""

from __future__ import annotations

from numpy.typing import ArrayLike

from lfcal.reconstruct.projectors.projector import Projector
from lfcal.reconstruct.solvers.em import EmOptions, iter_run
from lfcal.reconstruct.solvers.penalty import TotalVariation
from lfcal.reconstruct.solvers.records import SolverWork
from lfcal.reconstruct.solvers.solver import EM, Solver, SolverRun

__all__ = ["SOLVER"]


def iterate(P: Projector, image: ArrayLike, run: SolverRun) -> SolverWork:
    """Run Richardson-Lucy with the penalty at the strength asked for."""
    penalty = TotalVariation() if run.strength is None else TotalVariation(run.strength)
    return iter_run(P, image, run, EmOptions(penalty=penalty))


SOLVER = Solver(
    "rl-tv",
    "Richardson-Lucy with total variation: less noise, edges kept",
    iterate,
    EM | {"strength"},
    rank=20,
    volumes=(3, 4),
    settles=True,
)
