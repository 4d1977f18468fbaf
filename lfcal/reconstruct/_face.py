"""The public names of `lfcal.reconstruct`: each is loaded when it is asked for."""

from __future__ import annotations

from lfcal.reconstruct.metric_grid import MetricGrid
from lfcal.reconstruct.projectors import METHODS, FieldProjector, ProjectionForecast, Projector
from lfcal.reconstruct.resample import Resampling, resampling_for
from lfcal.reconstruct.resolution import TwoPoint, iter_two_point, two_point
from lfcal.reconstruct.series import FrameResult, iter_series
from lfcal.reconstruct.solvers import (
    SOLVERS,
    DepthSmoothing,
    Reconstruction,
    Solver,
    SolverChoice,
    SolverProgress,
    SolverRun,
    SolverState,
    Tikhonov,
    TotalVariation,
    conjugate_gradient,
    isra,
    iter_conjugate_gradient,
    iter_isra,
    iter_reconstruct,
    iter_richardson_lucy,
    reconstruct,
    richardson_lucy,
)
from lfcal.reconstruct.volumes import load_volume, save_volume

__all__ = [
    "METHODS",
    "SOLVERS",
    "DepthSmoothing",
    "FieldProjector",
    "FrameResult",
    "MetricGrid",
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
    "resampling_for",
    "richardson_lucy",
    "save_volume",
    "two_point",
]
