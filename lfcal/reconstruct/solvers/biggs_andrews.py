"""Richardson-Lucy, extrapolated along its last two updates (Biggs & Andrews 1997)."""

from __future__ import annotations

from functools import partial

from lfcal.reconstruct.solvers._em import EmOptions, iter_run
from lfcal.reconstruct.solvers.solver import EM, Solver

__all__ = ["SOLVER"]

SOLVER = Solver(
    "rl-biggs",
    "Richardson-Lucy, accelerated (Biggs & Andrews 1997): 3 to 10 times fewer iterations",
    partial(iter_run, options=EmOptions(acceleration="biggs-andrews")),
    EM,
    rank=40,
    volumes=(7, 8),
)
