"""Accelerated Richardson-Lucy within a sieve: few artefacts near the native plane, no rings.

Near the native plane, the patterns of all points behind a lenslet are almost identical, and their differences are
mostly errors of H. In these planes, Richardson-Lucy reconstructs the lenslets. The method of sieves (Snyder & Miller
1985) seeks ``g = S s`` with non-negative s and a Gaussian S, ``s <- s / (S HT1) * S HT(f / (H S s + b))``. The
likelihood is that of H, and the volume fits the image; with smoothing after each iteration, it does not. A Gaussian
does not cause ringing, and details below its width are not reconstructed. In other planes, the Gaussian is
half a voxel wide and rejects noise finer than the grid. Near the native plane, the part of the updates that repeats
from lenslet to lenslet is removed (`repeating`), because a wrong H has the same effect.

All views are used together, extrapolated by the iteration number (Beck & Teboulle 2009) as in `rl-nesterov`, and the
first updates are longer (`stretch`). Updates with one block of views after another, brightest first, need even fewer
iterations. However, if H differs slightly from the camera, they reconstruct lenslets in planes near the native one.

If the noise of a recorded H is known, it is included and determines the end of the run (`model_noise`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers._em import EmOptions, iter_run
from lfcal.reconstruct.solvers._model_noise import ModelNoise
from lfcal.reconstruct.solvers._repeating import Repeating
from lfcal.reconstruct.solvers._stretch import Stretch
from lfcal.reconstruct.solvers._subsets import Masks, interleaved_subsets
from lfcal.reconstruct.solvers.ordered_subsets import views_of
from lfcal.reconstruct.solvers.records import Reconstruction, SolverState, SolverWork
from lfcal.reconstruct.solvers.smoothing import Sieve, coarseness
from lfcal.reconstruct.solvers.solver import EM, Solver, SolverRun

__all__ = ["SOLVER", "repeating_of", "sieve_of", "stretch_of"]


def sieve_of(P: Projector) -> Sieve:
    """Return the sieve for the camera and the depths of H; without a camera, a sieve that changes nothing."""
    if P.camera is None:
        return Sieve((0.0,) * P.volume_shape[0])
    return Sieve.for_camera(P.camera, P.depths)


def repeating_of(P: Projector) -> Repeating | None:
    """Return the filter that removes patterns with the period of H from updates of coarsely sampled planes.

    None: no plane of H needs it, or H has no camera.
    """
    if P.camera is None:
        return None
    shares = coarseness(P.camera, P.depths)
    return Repeating(P.period, shares) if any(shares) else None


def stretch_of(P: Projector) -> Stretch:
    """Return the settings for stretching updates.

    In coarsely sampled planes, details finer than a period are not stretched, because they may be artefacts.
    """
    repeating = repeating_of(P)
    return Stretch(P.grid.cutout, P.period, () if repeating is None else repeating.shares)


@dataclass(frozen=True, eq=False)
class _Sieved:
    """Projector combined with a sieve: ``H S``, and its transpose ``S HT``."""

    projector: Projector
    sieve: Sieve

    def forward(self, volume: NDArray[Any]) -> NDArray[Any]:
        return self.projector.forward(self.sieve.apply(volume))

    def adjoint(self, image: NDArray[Any]) -> NDArray[Any]:
        return self.sieve.apply(self.projector.adjoint(image))

    def subset(self, phases: NDArray[np.bool_]) -> _Sieved:
        return _Sieved(self.projector.subset(phases), self.sieve)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.projector, name)


def iterate(P: Projector, image: ArrayLike, run: SolverRun) -> SolverWork:
    """Run Richardson-Lucy with a sieve S, on all pixels or over ``subsets`` x ``subsets`` blocks of views.

    ``subsets`` is that of ``run`` (None: all pixels). If a period contains several lenslets, pixels are distributed
    evenly instead of by views. Records and result contain the volume S s, where s is the estimate before the sieve. The
    arguments are those of `Solver.iterate`.
    """
    sieve = sieve_of(P)
    if run.resume is not None and run.resume.arrays:
        own = replace(run.resume, volume=run.resume.arrays[0], arrays=run.resume.arrays[1:])
        run = replace(run, resume=own)
    parts = _parts_of(P, image, run.subsets)
    repeating = repeating_of(P)
    # subsets already extrapolate
    options = EmOptions(subsets=parts, repeating=repeating, model_noise=ModelNoise.of(P, sieve, run))
    if parts is None:
        options = replace(options, acceleration="nesterov", stretch=stretch_of(P))
    work = iter_run(cast(Projector, _Sieved(P, sieve)), image, run, options)

    def seen(state: SolverState) -> SolverState:
        return replace(state, volume=sieve.apply(state.volume), arrays=(state.volume, *state.arrays))

    while True:
        try:
            record = next(work)
        except StopIteration as end:
            result: Reconstruction = end.value
            state = seen(result.state)
            return replace(result, volume=state.volume, state=state)
        assert record.state is not None  # records of a running solver have a state
        yield replace(record, state=seen(record.state))


def _blocks(subsets: int | None) -> int:
    return 1 if subsets is None else subsets


def _parts_of(P: Projector, image: ArrayLike, subsets: int | None) -> Masks | None:
    """Return blocks of views; None if all views are used together.

    If a period has several lenslets with separate views, pixels are distributed evenly instead.
    """
    blocks = _blocks(subsets)
    if blocks == 1:
        return None
    if P.camera is not None and P.camera.has_lattice and P.grid.phases > 1.5 * P.camera.pitch_px**2:
        return interleaved_subsets(P.period, min(blocks**2, P.grid.phases))
    return views_of(P, image, blocks)


SOLVER = Solver(
    "sieve",
    "accelerated Richardson-Lucy with a sieve (Snyder & Miller 1985): fewer lenslet artefacts in the native "
    "plane, no rings",
    iterate,
    EM | {"subsets"},
    rank=85,
    volumes=(6, 6),
    parts=lambda subsets: _blocks(subsets) ** 2,
)
