"""Volume reconstruction: the projector pair and the solvers.

- ``projector``: `Projector`, the pair; ``polyphase``, ``direct``, ``sparse``, ``position_fft`` are the ways it works
- ``grid``, ``tiles``, ``planes``, ``engine``: the lattice of whole periods, overlap-save tiles, H plane by plane
- ``forecast``, ``rates``: what each way costs on this machine
- ``solvers``: all solvers by name; ``em`` (Richardson-Lucy, ISRA), ``least_squares``; ``records`` is what they tell
- ``measurement``, ``penalty``, ``acceleration``, ``subsets``, ``smoothing``: what solvers are made of
- ``metrics``, ``phantoms``, ``resolution``: how good is it?
- ``resample``: light fields onto whole periods; ``series``, ``volumes``: many frames, results as files
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfcal.reconstruct.em import isra, iter_isra, iter_richardson_lucy, richardson_lucy
    from lfcal.reconstruct.forecast import METHODS, Forecast
    from lfcal.reconstruct.least_squares import conjugate_gradient, iter_conjugate_gradient
    from lfcal.reconstruct.penalty import Tikhonov, TotalVariation
    from lfcal.reconstruct.projector import Projector
    from lfcal.reconstruct.records import Reconstruction, SolverProgress, SolverState
    from lfcal.reconstruct.resample import Resampling
    from lfcal.reconstruct.resolution import iter_two_point, two_point
    from lfcal.reconstruct.series import iter_series
    from lfcal.reconstruct.smoothing import DepthSmoothing
    from lfcal.reconstruct.solvers import SOLVERS, SolverChoice, iter_reconstruct, reconstruct
    from lfcal.reconstruct.volumes import load_volume, save_volume

_HOME = {
    "METHODS": "forecast",
    "SOLVERS": "solvers",
    "DepthSmoothing": "smoothing",
    "Forecast": "forecast",
    "Projector": "projector",
    "Reconstruction": "records",
    "Resampling": "resample",
    "SolverChoice": "solvers",
    "SolverProgress": "records",
    "SolverState": "records",
    "Tikhonov": "penalty",
    "TotalVariation": "penalty",
    "conjugate_gradient": "least_squares",
    "isra": "em",
    "iter_conjugate_gradient": "least_squares",
    "iter_isra": "em",
    "iter_reconstruct": "solvers",
    "iter_richardson_lucy": "em",
    "iter_series": "series",
    "iter_two_point": "resolution",
    "load_volume": "volumes",
    "reconstruct": "solvers",
    "richardson_lucy": "em",
    "save_volume": "volumes",
    "two_point": "resolution",
}

__all__ = [
    "METHODS",
    "SOLVERS",
    "DepthSmoothing",
    "Forecast",
    "Projector",
    "Reconstruction",
    "Resampling",
    "SolverChoice",
    "SolverProgress",
    "SolverState",
    "Tikhonov",
    "TotalVariation",
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


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"lfcal.reconstruct.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
