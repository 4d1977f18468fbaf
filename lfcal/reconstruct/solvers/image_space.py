"""Image-space reconstruction algorithm: least squares without negative values."""

from __future__ import annotations

from functools import partial

from numpy.typing import ArrayLike

from lfcal.base import drained
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers._em import EmOptions, IsraSettings, iter_em, iter_run
from lfcal.reconstruct.solvers.records import SolverWork
from lfcal.reconstruct.solvers.solver import COMMON, Solver, with_settings

__all__ = ["SOLVER", "isra", "iter_isra"]


@with_settings(IsraSettings)
def iter_isra(P: Projector, image: ArrayLike, settings: IsraSettings) -> SolverWork:
    """Deconvolve ``image`` ``(Y, X)`` by the image-space reconstruction algorithm (ISRA); return a `Reconstruction`.

    The update of the volume g is ``g <- g * HT(w f) / HT(w (Hg + b))`` (Daube-Witherspoon & Muehllehner 1986). Here f
    is the image, w its weights, b the background, and HT the transpose of H. Parameters and errors are those of
    `richardson_lucy`, except for the read noise, because the algorithm minimises squared differences without a noise
    model.

    Yields
    ------
    SolverProgress
        After each iteration.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import Projector, iter_isra
    >>> P = Projector(np.array([1, 2, 1]).reshape(1, 1, 1, 1, 3) / 4, (1, 7))
    >>> for record in iter_isra(P, [[0, 0, 2, 4, 2, 0, 0]], 3):
    ...     print(record.count, f"residual {record.residual:.1f}")
    1 of 3 residual 0.8
    2 of 3 residual 0.4
    3 of 3 residual 0.3
    """
    data = settings.measurement(P, image)
    options = settings.options("isra")
    return iter_em(P, data, settings.iterations, options, initial=settings.initial, resume=settings.resume)


isra = drained(
    iter_isra,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import Projector, isra
    >>> P = Projector(np.array([1, 2, 1]).reshape(1, 1, 1, 1, 3) / 4, (1, 7))
    >>> for iterations in (5, 100):  # the image of a single voxel of 8
    ...     print(isra(P, [[0, 0, 2, 4, 2, 0, 0]], iterations).volume[0, 0].round(1))
    [0.  0.1 1.9 5.1 1.9 0.1 0. ]
    [0.  0.  0.2 7.7 0.2 0.  0. ]
    """,
)


SOLVER = Solver(
    "isra",
    "least squares without negative values (ISRA)",
    partial(iter_run, options=EmOptions("isra")),
    COMMON | {"initial", "held_out"},
    rank=90,
    volumes=(4, 4),
)
