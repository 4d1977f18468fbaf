"""Solvers by name, with the settings the literature gives them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lfcal.errors import InputError
from lfcal.progress import drain
from lfcal.reconstruct.projectors.projector import Projector
from lfcal.reconstruct.solvers.em import iter_isra, iter_richardson_lucy
from lfcal.reconstruct.solvers.least_squares import iter_conjugate_gradient
from lfcal.reconstruct.solvers.penalty import Tikhonov, TotalVariation
from lfcal.reconstruct.solvers.records import Reconstruction, SolverState, SolverWork
from lfcal.reconstruct.solvers.smoothing import DepthSmoothing
from lfcal.reconstruct.solvers.subsets import Masks, angular_subsets, by_energy, interleaved_subsets

__all__ = ["SOLVERS", "SolverChoice", "iter_reconstruct", "lenslet_phase", "reconstruct"]

SOLVERS: dict[str, str] = {
    "rl": "Richardson-Lucy, as published (Eberhart et al. 2020, equation 2)",
    "rl-tv": "Richardson-Lucy with total variation: less noise, edges kept",
    "rl-tikhonov": "Richardson-Lucy with Tikhonov-Miller: less noise, softer",
    "rl-biggs": "Richardson-Lucy, accelerated (Biggs & Andrews 1997): 3 to 10 times fewer iterations",
    "rl-nesterov": "Richardson-Lucy, accelerated (Nesterov)",
    "osem": "ordered subsets of pixels (Hudson & Larkin 1994): fewer iterations",
    "phase-space": "view by view, brightest first (ordering of Lu et al. 2019)",
    "ems": "Richardson-Lucy with depth-dependent smoothing against artefacts (Stefanoiu et al. 2019)",
    "isra": "least squares without negative values (ISRA)",
    "cg": "linear least squares by conjugate gradients; may become negative",
}
"""Name and description of each solver."""


@dataclass(frozen=True, slots=True)
class SolverChoice:
    """A solver and its settings.

    Attributes
    ----------
    name
        One of `SOLVERS`.
    iterations
        How many.
    background
        Expected value of a pixel without any source (counts).
    read_noise
        Rms read noise (counts); Richardson-Lucy variants alone.
    saturation
        Pixels at or above are left out; None: none.
    strength
        Weight of the penalty of ``rl-tv`` and ``rl-tikhonov``, damping of ``cg``; None: the default of each.
    subsets
        Number of subsets for ``osem``, blocks of views along each axis for ``phase-space``; None: 4 and 3.
    tolerance
        Stop when the relative change falls below.
    """

    name: str = "rl"
    iterations: int = 20
    background: float = 0.0
    read_noise: float = 0.0
    saturation: float | None = None
    strength: float | None = None
    subsets: int | None = None
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        """Check the name; the solvers check the rest."""
        if self.name not in SOLVERS:
            raise InputError.expected("solver", " or ".join(SOLVERS), repr(self.name), "choose one of these")


def iter_reconstruct(
    P: Projector,
    image: ArrayLike,
    choice: SolverChoice | None = None,
    *,
    weights: ArrayLike | None = None,
    initial: ArrayLike | None = None,
    resume: SolverState | None = None,
) -> SolverWork:
    """Reconstruct ``image`` by the solver of ``choice``, one `SolverProgress` per iteration.

    ``ems`` takes its widths from the camera and depths of H, else from the period at every depth.
    """
    c = SolverChoice() if choice is None else choice
    common: dict[str, Any] = {
        "background": c.background,
        "weights": weights,
        "saturation": c.saturation,
        "tolerance": c.tolerance,
        "resume": resume,
    }
    if c.name == "cg":
        return iter_conjugate_gradient(P, image, c.iterations, damping=c.strength or 0.0, **common)
    if c.name == "isra":
        return iter_isra(P, image, c.iterations, initial=initial, **common)
    common |= {"read_noise": c.read_noise, "initial": initial}
    extra: dict[str, Any] = {}
    if c.name == "rl-tv":
        extra["penalty"] = TotalVariation() if c.strength is None else TotalVariation(c.strength)
    elif c.name == "rl-tikhonov":
        extra["penalty"] = Tikhonov() if c.strength is None else Tikhonov(c.strength)
    elif c.name in ("rl-biggs", "rl-nesterov"):
        extra["acceleration"] = {"rl-biggs": "biggs-andrews", "rl-nesterov": "nesterov"}[c.name]
    elif c.name == "osem":
        extra["subsets"] = interleaved_subsets(P.period, min(c.subsets or 4, P.grid.phases))
    elif c.name == "phase-space":
        extra["subsets"] = _views(P, image, c.subsets or 3)
    elif c.name == "ems":
        extra["smoothing"] = _smoothing(P)
    return iter_richardson_lucy(P, image, c.iterations, **common, **extra)


def reconstruct(P: Projector, image: ArrayLike, choice: SolverChoice | None = None, **options: Any) -> Reconstruction:
    """Reconstruct ``image``: `iter_reconstruct`, drained."""
    return drain(iter_reconstruct(P, image, choice, **options))


def lenslet_phase(P: Projector) -> tuple[float, float]:
    """Return the phase (row, column) of a lenslet's centre: from the camera of H, else the middle of the period."""
    (ny, nx), camera = P.period, P.camera
    if camera is None:
        return (ny - 1) / 2, (nx - 1) / 2
    row, column = P.grid.anchor
    x, y = camera.sensor_um((float(row), float(column)))
    a, b = camera.lattice.basis_um()
    index = np.linalg.solve(np.stack([a, b], axis=1), np.array([x, y]) - np.array(camera.lattice.offset_um))
    near = np.stack([a, b], axis=1) @ np.round(index) + np.array(camera.lattice.offset_um)
    pixel = camera.sensor.pixel_um
    return float((near[1] - y) / pixel % ny), float((near[0] - x) / pixel % nx)


def _views(P: Projector, image: ArrayLike, blocks: int) -> Masks:
    views = min(blocks, P.period[0]), min(blocks, P.period[1])
    masks = angular_subsets(P.period, views, lenslet_phase(P))
    return by_energy(masks, np.nan_to_num(np.asarray(image, float), posinf=0.0, neginf=0.0), P.grid)


def _smoothing(P: Projector) -> DepthSmoothing:
    if P.camera is None:
        return DepthSmoothing((min(P.period) / 2,) * P.volume_shape[0])
    return DepthSmoothing.for_camera(P.camera, P.depths)
