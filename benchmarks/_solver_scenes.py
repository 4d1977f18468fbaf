"""Cameras and scenes for the comparison of solvers; the light comes from between the reconstructed voxels.

The reconstructed volume has one plane per step of depth and one voxel per pixel. The light comes from twice as many
other planes, and from voxels displaced by a fraction of a pixel. An H that is simulated for these positions, with a
finer tolerance, projects it. So no solver inverts the matrix that made the image, and the error of its
discretisation is included, as with a real frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from lfcal.camera import Camera
    from lfcal.psf import PSFMatrix

__all__ = ["CAMERAS", "SCENES", "Problem", "Subject", "problem_of", "subject_of"]

F8 = NDArray[np.float64]
Place = tuple[F8, F8, F8]
"""Depth (planes), row and column (px) of every voxel, relative to the middle of the volume."""

PEAK, BACKGROUND = 200.0, 5.0
"""Photons in the brightest pixel without background, and photons of the background."""

COARSE, FINE = 0.2, 0.1
"""Tolerance of the H that solvers use, and of the H that makes the images."""

OFF_GRID = 0.4
"""Displacement of the emitting voxels from the reconstructed ones (px); the cutouts of the patterns do not move."""

DOTS = 14
"""Number of beads in a scene."""


@dataclass(frozen=True)
class _Setup:
    """A camera, the virtual depths or depths (µm) of the planes, and the side of patterns and of images (px)."""

    camera: Callable[[], Camera]
    depths: tuple[float, ...]
    virtual: bool
    cutout: int
    side: int


@dataclass(frozen=True, eq=False)
class Subject:
    """A camera with the H that solvers use and the H that makes the images.

    Attributes
    ----------
    name
        Name of the camera.
    sought
        H of the ``nz`` reconstructed planes.
    fine
        H of ``2 nz`` other planes, for the displaced voxels.
    side
        Side of the images (px).
    """

    name: str
    sought: PSFMatrix
    fine: PSFMatrix
    side: int


@dataclass(frozen=True, eq=False)
class Problem:
    """An image and its true volume.

    Attributes
    ----------
    truth
        True volume ``(nz, Y, X)``, in photons of ``image``.
    image
        Image ``(Y, X)`` with noise and `BACKGROUND`, in photons.
    beads
        Positions (plane, row, column) of single beads, in planes and pixels of ``truth``; empty if there are none.
    """

    truth: F8
    image: F8
    beads: F8


def _microscope() -> Camera:
    from lfcal.camera import preset

    # the pitch is a whole number of pixels
    camera = preset("lfm_60x12")
    lattice = replace(camera.periodic, pitch_um=100.1)
    return replace(camera, lattice=lattice, sensor=replace(camera.sensor, shape=(260, 260), pixel_um=100.1 / 11))


def _bench() -> Camera:
    from lfcal.camera import preset

    return preset("bench")


def _r29_like() -> Camera:
    from benchmarks._fault_recordings import CAMERAS as RECORDED

    return RECORDED["r29-like"]().camera


CAMERAS = {
    "lfm_60x12": _Setup(_microscope, (-4.5, -3.0, -1.5, 0.0, 1.5, 3.0, 4.5), False, 95, 99),
    "bench": _Setup(_bench, (2.2, 2.8, 3.4, 4.0, 4.6), True, 61, 96),
    "r29-like": _Setup(_r29_like, (2.2, 2.8, 3.4, 4.0, 4.6), True, 71, 96),
}
"""Cameras: one with the native plane in the middle of the volume, and two at virtual depths above 2."""


def subject_of(name: str, side: int = 0) -> Subject:
    """Return the camera ``name`` with both simulated H; images have a side of ``side`` pixels (0: small ones)."""
    from lfcal.camera import ScanPlan
    from lfcal.simulate.accuracy.planner import plan_effects
    from lfcal.simulate.simulate import simulate_psf

    setup = CAMERAS[name]
    camera = setup.camera()

    def simulated(depths: tuple[float, ...], tolerance: float, beside: float) -> PSFMatrix:
        virtual, lengths = (depths, None) if setup.virtual else (None, depths)
        plan = ScanPlan.for_camera(camera, virtual_depths=virtual, depths_um=lengths, cutout=setup.cutout)
        plan = replace(plan, anchor=(plan.anchor[0] + beside, plan.anchor[1] + beside))
        return simulate_psf(plan, plan_effects(plan, tolerance), tolerance=tolerance)

    apart = setup.depths[1] - setup.depths[0]
    between = tuple(z + part * apart for z in setup.depths for part in (-0.25, 0.25))
    return Subject(name, simulated(setup.depths, COARSE, 0.0), simulated(between, FINE, OFF_GRID), side or setup.side)


def _places(planes: F8, side: int, beside: float) -> Place:
    across = np.arange(side) - (side - 1) / 2 + beside
    z, y, x = np.meshgrid(planes, across, across, indexing="ij")
    return z, y, x


def _bead_places(planes: int, side: int) -> F8:
    rng = np.random.default_rng(4)
    reach = 0.36 * side
    z = rng.permutation(np.arange(DOTS) % planes) - (planes - 1) / 2 + rng.uniform(-0.3, 0.3, DOTS)
    return np.stack([z, rng.uniform(-reach, reach, DOTS), rng.uniform(-reach, reach, DOTS)], axis=1)


def _beads(place: Place, planes: int, side: int) -> F8:
    """Return beads at positions off the grid, with rms widths of 1 pixel and half a plane."""
    z, y, x = place
    found = np.zeros(z.shape)
    for at in _bead_places(planes, side):
        found += np.exp(-(((z - at[0]) / 0.5) ** 2 + (y - at[1]) ** 2 + (x - at[2]) ** 2) / 2)
    return found


def _sheet(place: Place, planes: int, side: int) -> F8:
    """Return a tilted sheet with stripes that reaches into the outermost planes and fades towards the edges."""
    z, y, x = place
    height = (planes - 2) * x / (0.8 * side)
    fade = np.exp(-((np.hypot(y, x) / (0.4 * side)) ** 6))
    lit: F8 = np.exp(-(((z - height) / 0.6) ** 2) / 2) * (1 + 0.5 * np.cos(2 * np.pi * y / (side / 6))) * fade
    return lit


def _shell(place: Place, planes: int, side: int) -> F8:
    """Return the membrane of a vesicle."""
    z, y, x = place
    radius = np.sqrt((y**2 + x**2) / (0.33 * side) ** 2 + (z / (0.45 * planes)) ** 2)
    lit: F8 = np.exp(-(((radius - 1) / 0.07) ** 2) / 2)
    return lit


SCENES = {"beads": _beads, "sheet": _sheet, "shell": _shell}
"""Functions of the positions, number of planes and side (px) that return the light at each position."""


def problem_of(subject: Subject, scene: str, seed: int = 0) -> Problem:
    """Return the noisy image of a scene, made with the fine H, and its light at the reconstructed voxels."""
    from lfcal.reconstruct import Projector

    planes, side = len(subject.sought), subject.side
    light = SCENES[scene]
    middle = (planes - 1) / 2
    between = np.repeat(np.arange(planes) - middle, 2) + np.tile([-0.25, 0.25], planes)
    P = Projector(subject.fine, (side, side), dtype=np.float64)
    clean = np.maximum(P.forward(light(_places(between, side, OFF_GRID), planes, side)), 0)
    truth = light(_places(between, side, 0.0), planes, side).reshape(planes, 2, side, side).sum(1)
    scale = PEAK / clean.max()
    image = np.random.default_rng(seed).poisson(clean * scale + BACKGROUND).astype(np.float64)
    where = _bead_places(planes, side) if scene == "beads" else np.zeros((0, 3))
    return Problem(truth * scale, image, where + np.array([middle, (side - 1) / 2, (side - 1) / 2]))
