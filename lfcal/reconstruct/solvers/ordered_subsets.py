"""Richardson-Lucy by ordered subsets of image phases (Hudson & Larkin 1994)."""

from __future__ import annotations

from numpy.typing import ArrayLike

from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers._em import EmOptions, iter_run
from lfcal.reconstruct.solvers._subsets import interleaved_subsets
from lfcal.reconstruct.solvers.records import SolverWork
from lfcal.reconstruct.solvers.solver import EM, Solver, SolverRun

__all__ = ["SOLVER"]


def iterate(P: Projector, image: ArrayLike, run: SolverRun) -> SolverWork:
    """Run Richardson-Lucy over the subsets asked for, 4 by default, in turn."""
    count = _parts(run.subsets)
    # a short period has fewer phases than subsets are usual: then each phase is one.
    masks = interleaved_subsets(P.period, min(count, P.grid.phases))
    return iter_run(P, image, run, EmOptions(subsets=masks))


def _parts(subsets: int | None) -> int:
    return 4 if subsets is None else subsets


SOLVER = Solver(
    "osem",
    "ordered subsets of pixels (Hudson & Larkin 1994): fewer iterations",
    iterate,
    EM | {"subsets"},
    rank=60,
    volumes=(4, 4),
    parts=_parts,
)
