"""Richardson-Lucy, the multiplicative solver for Poisson data: plain, with a penalty, or extrapolated.

The penalties, total variation (Dey et al. 2006) and the squared gradient (Tikhonov-Miller), are applied one step late.
The extrapolation depends on the last two updates (Biggs & Andrews 1997) or on the iteration number (Beck & Teboulle
2009, equation 4.2).
"""

from __future__ import annotations

from functools import partial

from numpy.typing import ArrayLike

from lfcal.base import drained
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers._em import EmOptions, RichardsonLucySettings, iter_em, iter_run, penalised
from lfcal.reconstruct.solvers.penalty import Tikhonov, TotalVariation
from lfcal.reconstruct.solvers.records import SolverWork
from lfcal.reconstruct.solvers.solver import EM, Solver, with_settings

__all__ = ["SOLVER", "iter_richardson_lucy", "richardson_lucy"]


@with_settings(RichardsonLucySettings)
def iter_richardson_lucy(P: Projector, image: ArrayLike, settings: RichardsonLucySettings) -> SolverWork:
    """Deconvolve ``image`` ``(Y, X)`` by the Richardson-Lucy algorithm, and return a `Reconstruction`.

    The update of the volume g is ``g <- g / HT1 * HT( f / (Hg + b) )`` (Eberhart et al. 2020, equation 2). Here f is
    the image, b the background, HT the transpose of H, and 1 an image of ones. With weights w, the factor is
    ``HT(w f / (Hg + b)) / HTw``. Where Hg + b is below the rounding error, the ratio is 0. Voxels whose sensitivity HTw
    is below a millionth of the largest are not changed.

    Parameters
    ----------
    P
        Projector of H.
    image
        Image ``(Y, X)`` in counts.
    iterations
        Number of iterations, in addition to those of ``resume``.
    background, weights, saturation, read_noise
        As in `Measurement.of`.
    penalty, acceleration, subsets, relaxation, smoothing, tolerance
        As in `EmOptions`.
    initial
        Non-negative initial volume ``(nz, Y, X)``. None: uniform, with the total light of the image.
    resume
        State of a stopped run to continue from; it replaces ``initial``. None: start a new run.

    Yields
    ------
    SolverProgress
        After each iteration.

    Raises
    ------
    InputError
        If the image does not fit the projector or an argument is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import Projector, iter_richardson_lucy
    >>> P = Projector(np.array([1, 2, 1]).reshape(1, 1, 1, 1, 3) / 4, (1, 7))
    >>> for record in iter_richardson_lucy(P, [[0, 0, 2, 4, 2, 0, 0]], 3):
    ...     print(record.count, f"peak {record.state.volume.max():.2f}")
    1 of 3 peak 3.00
    2 of 3 peak 4.00
    3 of 3 peak 4.76
    """
    data = settings.measurement(P, image, read_noise=settings.read_noise)
    options = settings.options("richardson-lucy")
    return iter_em(P, data, settings.iterations, options, initial=settings.initial, resume=settings.resume)


richardson_lucy = drained(
    iter_richardson_lucy,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import open_psf
    >>> from lfcal.reconstruct import Projector, richardson_lucy
    >>> with open_psf("H.h5") as H:
    ...     P = Projector(H, (64, 64), method="direct")
    ...     beads = np.zeros(P.volume_shape)
    ...     beads[0, 20, 30], beads[1, 40, 45] = 1.0, 2.0
    ...     result = richardson_lucy(P, P.forward(beads), iterations=12)
    >>> print("beads found at", np.argwhere(result.volume > 0.3).tolist())
    beads found at [[0, 20, 30], [1, 40, 45]]
    """,
)


SOLVER = (
    Solver(
        "rl",
        "Richardson-Lucy, as published (Eberhart et al. 2020, equation 2)",
        partial(iter_run, options=EmOptions()),
        EM,
        rank=10,
        volumes=(3, 3),
    ),
    penalised("rl-tv", "Richardson-Lucy with total variation: less noise, sharp edges", TotalVariation, rank=20),
    penalised("rl-tikhonov", "Richardson-Lucy with Tikhonov-Miller: less noise, softer edges", Tikhonov, rank=30),
    Solver(
        "rl-biggs",
        "Richardson-Lucy, accelerated (Biggs & Andrews 1997): 3 to 10 times fewer iterations",
        partial(iter_run, options=EmOptions(acceleration="biggs-andrews")),
        EM,
        rank=40,
        volumes=(7, 8),
    ),
    Solver(
        "rl-nesterov",
        "Richardson-Lucy, accelerated (Nesterov)",
        partial(iter_run, options=EmOptions(acceleration="nesterov")),
        EM,
        rank=50,
        volumes=(5, 5),
    ),
)
"""Solvers for the registry; every module of solvers defines one or a tuple."""
