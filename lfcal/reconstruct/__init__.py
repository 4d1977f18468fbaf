"""Volume reconstruction: the projector pair and the solvers.

- ``projector``: `Projector`, the pair; ``polyphase``, ``direct``, ``sparse``, ``position_fft`` are the ways it works
- ``grid``, ``tiles``, ``planes``, ``engine``: the lattice of whole periods, overlap-save tiles, H plane by plane
- ``forecast``, ``rates``: what each way costs on this machine
- ``solvers``: all solvers by name; ``em`` (Richardson-Lucy, ISRA), ``least_squares``; ``records`` is what they tell
- ``measurement``, ``penalty``, ``acceleration``, ``subsets``, ``smoothing``: what solvers are made of
- ``metrics``, ``phantoms``, ``resolution``: how good is it?
- ``resample``: light fields onto whole periods; ``series``, ``volumes``: many frames, results as files
"""

from lfcal.reconstruct.projectors.forecast import METHODS, Forecast
from lfcal.reconstruct.projectors.projector import Projector
from lfcal.reconstruct.resample import Resampling
from lfcal.reconstruct.resolution import iter_two_point, two_point
from lfcal.reconstruct.series import iter_series
from lfcal.reconstruct.solvers.choice import SOLVERS, SolverChoice, iter_reconstruct, reconstruct
from lfcal.reconstruct.solvers.em import isra, iter_isra, iter_richardson_lucy, richardson_lucy
from lfcal.reconstruct.solvers.least_squares import conjugate_gradient, iter_conjugate_gradient
from lfcal.reconstruct.solvers.penalty import Tikhonov, TotalVariation
from lfcal.reconstruct.solvers.records import Reconstruction, SolverProgress, SolverState
from lfcal.reconstruct.solvers.smoothing import DepthSmoothing
from lfcal.reconstruct.volumes import load_volume, save_volume

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
