"""Clean PSF matrices by ray splatting, for every lattice the inspection must hold for."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from lfcal.base.compiled import njit
from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Microscope, Sensor
from lfcal.psf.aperture.shape import blade_radius

PEAK = 3000.0
"""Counts of the brightest pixel of a scene."""


@njit()
def splat(
    centres: NDArray[np.float64],
    spread: NDArray[np.float64],
    points: NDArray[np.float64],
    edge: NDArray[np.float64],
    shift: float,
    source: NDArray[np.float64],
    window: NDArray[np.float64],
    gain: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Add the light of every frame: rays through lenslets, where the iris's shadow lights them (pixels).

    ``centres (n, 2)`` as (x, y) and ``spread (n,)`` of the lenslets, ``points (m, 2)`` on a lenslet, ``edge``
    radius of the shadow over angle, ``shift`` = 1/v, ``source`` and ``window (ny, nx, 2)`` as (x, y) image of the
    source and centre of the cutout, ``gain (ny, nx)``, ``out (ny, nx, nt, ns)``.
    """
    ny, nx, nt, ns = out.shape
    reach = edge.max()
    step = edge.size / (2 * math.pi)
    for y in range(ny):
        for x in range(nx):
            sx, sy = source[y, x, 0], source[y, x, 1]
            left, top = window[y, x, 0] - (ns - 1) // 2, window[y, x, 1] - (nt - 1) // 2
            for k in range(centres.shape[0]):
                cx, cy = centres[k, 0], centres[k, 1]
                if math.hypot(cx - sx, cy - sy) > reach + 10:
                    continue
                for i in range(points.shape[0]):
                    px, py = cx + points[i, 0] - sx, cy + points[i, 1] - sy
                    angle = int(math.atan2(py, px) % (2 * math.pi) * step) % edge.size
                    if px * px + py * py > edge[angle] ** 2:
                        continue
                    u = cx + (sx - cx) * shift + points[i, 0] * spread[k] - left
                    v = cy + (sy - cy) * shift + points[i, 1] * spread[k] - top
                    j, r = math.floor(u), math.floor(v)
                    if j < 0 or r < 0 or j >= ns - 1 or r >= nt - 1:
                        continue
                    u -= j
                    v -= r
                    a = gain[y, x]
                    out[y, x, r, j] += a * (1 - u) * (1 - v)
                    out[y, x, r, j + 1] += a * u * (1 - v)
                    out[y, x, r + 1, j] += a * (1 - u) * v
                    out[y, x, r + 1, j + 1] += a * u * v


@dataclass(frozen=True)
class Scene:
    """A camera, its depth planes by virtual depth, and the cutout."""

    camera: Camera
    virtual_depths: tuple[float, ...]
    cutout: int
    blur_px: float = 0.75

    @property
    def depths(self) -> NDArray[np.float64]:
        """Object-space depths (µm)."""
        return np.array([self.camera.depth_of(v) for v in self.virtual_depths])

    @property
    def period(self) -> tuple[int, int]:
        """Positions ``(ny, nx)``."""
        y, x = self.camera.period_px
        return round(y), round(x)

    def shadow(self, v: float) -> NDArray[np.float64]:
        """Return the radius of the iris's shadow over 720 angles (px)."""
        optics = self.camera.optics
        gap = self.camera.lattice.gap_um / self.camera.sensor.pixel_um
        radius = abs(v) * gap / (2 * optics.working_f_number)
        theta = (np.arange(720) + 0.5) * (2 * math.pi / 720)
        if isinstance(optics, Microscope) or not optics.blades:
            return np.full(720, radius)
        turn = optics.blade_rotation_rad + (0.0 if v > 0 else math.pi)
        shape = blade_radius(theta, optics.blades, turn, 1.0, optics.blade_curvature)
        return shape * radius / math.sqrt(float(np.mean(shape**2)))

    def plane(
        self,
        z: int,
        stage: NDArray[np.float64] | None = None,
        cutouts: NDArray[np.float64] | None = None,
        gain: NDArray[np.float64] | None = None,
        depth_gain: float = 1.0,
    ) -> NDArray[np.float64]:
        """Return plane ``z``, ``(ny, nx, nt, ns)``, noise-free.

        ``stage`` and ``cutouts``, ``(ny, nx, 2)`` as (y, x) in pixels, misplace the source and the cutout; ``gain``
        ``(ny, nx)`` scales the light; ``depth_gain`` scales the virtual depth.
        """
        return _plane(self, self.virtual_depths[z] * depth_gain, stage, cutouts, gain)

    @functools.cached_property
    def planes(self) -> NDArray[np.float32]:
        """The clean, noise-free matrix with peak `PEAK`."""
        return (self._light * (PEAK / self._light.max())).astype(np.float32)

    @functools.cached_property
    def scale(self) -> float:
        """Counts per unit of light."""
        return PEAK / float(self._light.max())

    @functools.cached_property
    def _light(self) -> NDArray[np.float64]:
        return np.stack([self.plane(z) for z in range(len(self.virtual_depths))])


def _plane(
    scene: Scene,
    v: float,
    stage: NDArray[np.float64] | None,
    cutouts: NDArray[np.float64] | None,
    gain: NDArray[np.float64] | None,
) -> NDArray[np.float64]:
    ny, nx = scene.period
    lattice, pixel = scene.camera.lattice, scene.camera.sensor.pixel_um
    y, x = np.meshgrid(np.arange(ny), np.arange(nx), indexing="ij")
    nominal = np.stack([x, y], -1).astype(float)
    source = nominal if stage is None else nominal + stage[..., ::-1]
    window = nominal if cutouts is None else nominal + cutouts[..., ::-1]
    edge = scene.shadow(v)
    far = 60 + edge.max() + np.abs(source - nominal).max()
    centres, types = lattice.lenslets_within((nx + far) * pixel, (ny + far) * pixel)
    gap = lattice.gap_um
    spread = np.array([1 - 1 / v - gap / lattice.types[t].focal_length_um for t in types])
    side = np.linspace(-1, 1, 23)
    grid = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    radius = lattice.clear_diameter_um / 2 / pixel
    points = radius * grid[np.hypot(*grid.T) <= 1.0]
    out = np.zeros((ny, nx, scene.cutout, scene.cutout))
    light = np.ones((ny, nx)) if gain is None else gain
    norm = 1.0 / max(1.0, float(np.mean(edge**2)))  # equal light through the iris at every depth
    splat(centres / pixel, spread, points, edge, 1 / v, source, window, light * norm, out)
    for frame in out.reshape(-1, scene.cutout, scene.cutout):
        cv2.GaussianBlur(frame, (0, 0), scene.blur_px, dst=frame)
    return out


def recorded(
    clean: NDArray[np.float32] | NDArray[np.float64], seed: int = 0, noise: float = 6.0, flicker: float = 0.01
) -> NDArray[np.float32]:
    """Return ``clean`` as a camera records it after dark subtraction: flicker, shot and read noise (counts)."""
    rng = np.random.default_rng(seed)
    lamp = 1 + flicker * rng.standard_normal(clean.shape[:3])
    seen = clean * lamp[..., None, None]
    sigma = np.sqrt(noise**2 + 0.2 * np.maximum(seen, 0))
    return (seen + sigma * rng.standard_normal(clean.shape)).astype(np.float32)


@functools.cache
def hexagonal() -> Scene:
    """Return a three-type hexagonal camera, 27 x 16 positions."""
    pixel, pitch = 5.5, 9.0
    gap = pitch * pixel * 4.8
    types = tuple(LensType.focused_at(v, gap) for v in (2.0, 3.0, 5.0))
    lattice = LensletLattice(
        "hexagonal", pitch * pixel, gap, types, clear_um=8.7 * pixel, offset_um=(9.0, -14.0), row_pitch_um=7.97 * pixel
    )
    optics = MainLens(50e3, 4.0, 300e3, blades=7, blade_rotation_rad=0.2)
    return Scene(Camera("hex", optics, lattice, Sensor((320, 320), pixel)), (4.0, 3.0, -2.6), 59)


@functools.cache
def square() -> Scene:
    """Return a light-field microscope with a square array, 15 x 15 positions."""
    pixel = 125.0 / 15
    lattice = LensletLattice(
        "square", 125.0, 2500.0, (LensType.focused_at(math.inf, 2500.0),), offset_um=(31.0, 8.0), clear_um=125.0
    )
    camera = Camera("lfm", Microscope(4.0, 0.1, 1.0), lattice, Sensor((600, 600), pixel), 0.525)
    return Scene(camera, (-3.8, -2.6, 3.2), 91, blur_px=1.0)


@functools.cache
def single() -> Scene:
    """Return a one-type hexagonal camera, 11 x 19 positions, its lattice a little turned."""
    pixel, pitch = 5.5, 11.0
    gap = pitch * pixel * 4.8
    lattice = LensletLattice("hexagonal", pitch * pixel, gap, (LensType.focused_at(3.0, gap),), rotation_rad=0.002)
    optics = MainLens(50e3, 4.0, 300e3, blades=9, blade_curvature=0.3)
    return Scene(Camera("one", optics, lattice, Sensor((320, 320), pixel)), (4.5, 2.6), 71)
