"""Names of `lfcal.reconstruct.solvers` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.reconstruct.solvers.choice import SOLVERS, SolverChoice, iter_reconstruct, iter_solve, reconstruct
from lfcal.reconstruct.solvers.image_space import isra, iter_isra
from lfcal.reconstruct.solvers.least_squares import conjugate_gradient, iter_conjugate_gradient
from lfcal.reconstruct.solvers.measurement import NothingMeasured
from lfcal.reconstruct.solvers.multiplicative import iter_richardson_lucy, richardson_lucy
from lfcal.reconstruct.solvers.penalty import Tikhonov, TotalVariation
from lfcal.reconstruct.solvers.planes import UPDATING, plane_threads
from lfcal.reconstruct.solvers.records import Reconstruction, SolverProgress, SolverState
from lfcal.reconstruct.solvers.smoothing import DepthSmoothing
from lfcal.reconstruct.solvers.solver import OPTIONS, Solver, SolverRun
from lfcal.reconstruct.solvers.stopping import GOALS, STOPS

__all__ = [
    "GOALS",
    "OPTIONS",
    "SOLVERS",
    "STOPS",
    "UPDATING",
    "DepthSmoothing",
    "NothingMeasured",
    "Reconstruction",
    "Solver",
    "SolverChoice",
    "SolverProgress",
    "SolverRun",
    "SolverState",
    "Tikhonov",
    "TotalVariation",
    "conjugate_gradient",
    "isra",
    "iter_conjugate_gradient",
    "iter_isra",
    "iter_reconstruct",
    "iter_richardson_lucy",
    "iter_solve",
    "plane_threads",
    "reconstruct",
    "richardson_lucy",
]
