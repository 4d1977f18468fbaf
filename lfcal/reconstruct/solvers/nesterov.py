"""Richardson-Lucy, extrapolated by the iteration number (Beck & Teboulle 2009, equation 4.2)."""

from __future__ import annotations

from functools import partial

from lfcal.reconstruct.solvers._em import EmOptions, iter_run
from lfcal.reconstruct.solvers.solver import EM, Solver

__all__ = ["SOLVER"]

SOLVER = Solver(
    "rl-nesterov",
    "Richardson-Lucy, accelerated (Nesterov)",
    partial(iter_run, options=EmOptions(acceleration="nesterov")),
    EM,
    rank=50,
    volumes=(5, 5),
)
