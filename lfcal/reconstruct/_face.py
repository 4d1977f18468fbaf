"""The public names of `lfcal.reconstruct`, loaded when the first of them is asked for."""

from __future__ import annotations

from lfcal.reconstruct.projectors.field_projector import FieldProjector
from lfcal.reconstruct.projectors.forecast import METHODS, ProjectionForecast
from lfcal.reconstruct.projectors.projector import Projector
from lfcal.reconstruct.resample import Resampling
from lfcal.reconstruct.resolution import TwoPoint, iter_two_point, two_point
from lfcal.reconstruct.series import FrameResult, iter_series
from lfcal.reconstruct.solvers.choice import SOLVERS, SolverChoice, iter_reconstruct, reconstruct
from lfcal.reconstruct.solvers.isra import isra, iter_isra
from lfcal.reconstruct.solvers.least_squares import conjugate_gradient, iter_conjugate_gradient
from lfcal.reconstruct.solvers.penalty import Tikhonov, TotalVariation
from lfcal.reconstruct.solvers.records import Reconstruction, SolverProgress, SolverState
from lfcal.reconstruct.solvers.richardson_lucy import iter_richardson_lucy, richardson_lucy
from lfcal.reconstruct.solvers.smoothing import DepthSmoothing
from lfcal.reconstruct.solvers.solver import Solver, SolverRun
from lfcal.reconstruct.volumes import load_volume, save_volume

__all__ = [
    "METHODS",
    "SOLVERS",
    "DepthSmoothing",
    "FieldProjector",
    "FrameResult",
    "ProjectionForecast",
    "Projector",
    "Reconstruction",
    "Resampling",
    "Solver",
    "SolverChoice",
    "SolverProgress",
    "SolverRun",
    "SolverState",
    "Tikhonov",
    "TotalVariation",
    "TwoPoint",
    "conjugate_gradient",
    "isra",
    "iter_conjugate_gradient",
    "iter_isra",
    "iter_reconstruct",
    "iter_richardson_lucy",
    "iter_series",
    "iter_two_point",
    "load_volume",
    "reconstruct",
    "richardson_lucy",
    "save_volume",
    "two_point",
]
