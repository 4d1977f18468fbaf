"""Richardson-Lucy that updates with one subset of image phases after another.

Subsets are pixels spread evenly (Hudson & Larkin 1994), or blocks of views, brightest first (the order of Lu et al.
2019).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers._em import EmOptions, iter_run
from lfcal.reconstruct.solvers._subsets import Masks, angular_subsets, by_energy, interleaved_subsets
from lfcal.reconstruct.solvers.records import SolverWork
from lfcal.reconstruct.solvers.solver import EM, Solver, SolverRun

__all__ = ["SOLVER", "views_of"]


def iterate_pixels(P: Projector, image: ArrayLike, run: SolverRun) -> SolverWork:
    """Run Richardson-Lucy over one subset of the pixels after another; the default is 4 subsets.

    There are at most as many subsets as pixels in a period of H. The arguments are those of `Solver.iterate`.
    """
    count = _pixel_parts(run.subsets)
    # a short period may have fewer phases than the default; each phase is then a subset.
    masks = interleaved_subsets(P.period, min(count, P.grid.phases))
    return iter_run(P, image, run, EmOptions(subsets=masks))


def _pixel_parts(subsets: int | None) -> int:
    return 4 if subsets is None else subsets


def iterate_views(P: Projector, image: ArrayLike, run: SolverRun) -> SolverWork:
    """Run Richardson-Lucy over one block of views after another; the default is 3 x 3 blocks.

    The arguments are those of `Solver.iterate`.
    """
    return iter_run(P, image, run, EmOptions(subsets=views_of(P, image, _blocks(run.subsets))))


def _blocks(subsets: int | None) -> int:
    return 3 if subsets is None else subsets


def _view_parts(subsets: int | None) -> int:
    return _blocks(subsets) ** 2


def views_of(P: Projector, image: ArrayLike, blocks: int) -> Masks:
    """Return a mask ``(ny, nx)`` of the period for each block of views, the brightest in ``image`` ``(Y, X)`` first.

    There are ``blocks`` x ``blocks`` blocks, but at most one per row and column of the period.
    """
    views = min(blocks, P.period[0]), min(blocks, P.period[1])
    masks = angular_subsets(P.period, views, lenslet_phase(P))
    # pixels without a value get weight 0 later; here they must not affect the brightness of views.
    return by_energy(masks, np.nan_to_num(np.asarray(image, float), posinf=0.0, neginf=0.0), P.grid)


def lenslet_phase(P: Projector) -> tuple[float, float]:
    """Return the position (row, column) of a lenslet's centre in the period of H (px), from the camera of H.

    It is the middle of the period if H has no camera, or the camera has no lattice.
    """
    (ny, nx), camera = P.period, P.camera
    if camera is None or not camera.has_lattice:
        return (ny - 1) / 2, (nx - 1) / 2
    row, column = P.grid.anchor
    point = camera.sensor_um((float(row), float(column)))
    q, r = np.round(camera.lattice.lenslet_at(point))
    x, y = camera.lattice.centres_um(q, r) - point
    pixel = camera.sensor.pixel_um
    return float(y / pixel % ny), float(x / pixel % nx)


SOLVER = (
    Solver(
        "osem",
        "ordered subsets of pixels (Hudson & Larkin 1994): fewer iterations",
        iterate_pixels,
        EM | {"subsets"},
        rank=60,
        volumes=(4, 4),
        parts=_pixel_parts,
    ),
    Solver(
        "phase-space",
        "one view after the other, brightest first (ordering of Lu et al. 2019)",
        iterate_views,
        EM | {"subsets"},
        rank=70,
        volumes=(4, 4),
        parts=_view_parts,
    ),
)
