"""Richardson-Lucy with a low-pass per depth after each iteration (Stefanoiu et al. 2019)."""

from __future__ import annotations

from numpy.typing import ArrayLike

from lfcal.reconstruct.projectors.projector import Projector
from lfcal.reconstruct.solvers.em import EmOptions, iter_run
from lfcal.reconstruct.solvers.records import SolverWork
from lfcal.reconstruct.solvers.smoothing import DepthSmoothing
from lfcal.reconstruct.solvers.solver import EM, Solver, SolverRun

__all__ = ["SOLVER"]


def iterate(P: Projector, image: ArrayLike, run: SolverRun) -> SolverWork:
    """Run Richardson-Lucy with the smoothing that the lenslets of the camera of H call for."""
    return iter_run(P, image, run, EmOptions(smoothing=_smoothing(P)))


def _smoothing(P: Projector) -> DepthSmoothing:
    """Return widths by camera and depths of H; half a period at every depth where H has no camera."""
    if P.camera is None:
        return DepthSmoothing((min(P.period) / 2,) * P.volume_shape[0])
    return DepthSmoothing.for_camera(P.camera, P.depths)


SOLVER = Solver(
    "ems",
    "Richardson-Lucy with depth-dependent smoothing against artefacts (Stefanoiu et al. 2019)",
    iterate,
    EM,
    rank=80,
    volumes=(3, 4),
    settles=True,
)
