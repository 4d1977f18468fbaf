"""A light-field microscope by dipoles, sums over the pupil and Gauss-Legendre nodes on every lenslet and pixel.

No numerics shared with the engines: the fields of `dipole_pupil` are summed vector by vector at Chebyshev points about
the source, once a depth; polynomials through them are the fields everywhere else. Square lenslets along the pixels act
on rows and columns separately, so Fresnel's integral

    V(s) = 1/(i lambda B) integral E(X) exp(i pi (s - X)^2/(lambda B) - i pi (X - c)^2/(lambda f)) dX

is one matrix an axis, with its own nodes on each lenslet: no lenslet's edge lies between samples, nothing is periodic.
Under a turned array the pixels are turned instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from lfcal.simulate.scene import Scene
from tests.simulate.dipole_oracle import dipole_pupil

__all__ = ["DipoleFields", "DipoleFineness"]

F8 = NDArray[np.float64]
C16 = NDArray[np.complex128]

SPARE = 24
"""Nodes beside those that the phase's turns ask for."""
STEPS = 8
"""Places a pixel from which the light on a turned array's pixels is interpolated, by splines of fifth order."""
CHUNK = 2048
"""Pupil nodes that are summed at a time."""

rule = lru_cache(maxsize=None)(np.polynomial.legendre.leggauss)


@dataclass(frozen=True)
class DipoleFineness:
    """How finely the integrals are summed.

    Attributes
    ----------
    nodes
        Nodes of pupil, fields and lenslets, as a multiple of what holds their phases.
    pixel
        Nodes a pixel's side.
    beyond_um
        How far beyond the cutout light on the array is followed; the outer half fades out.
    """

    nodes: float = 1.0
    pixel: int = 8
    beyond_um: float = 400.0

    def count(self, radians: float) -> int:
        """Return the Gauss-Legendre nodes for a phase that runs over that many radians; a multiple of four."""
        return 4 * math.ceil(self.nodes * (0.5 * radians + SPARE) / 4)


class DipoleFields:
    """The fields of a source at one depth on the array, from which its responses at any place follow.

    Parameters
    ----------
    scene
        Objective, specimen, wavefront and depth; a vectorial one.
    fine
        How finely.
    reach_px
        How far from the source the farthest pixel of a cutout ends, at most; None: that of the scene's cutout.
    """

    def __init__(self, scene: Scene, fine: DipoleFineness | None = None, reach_px: float | None = None) -> None:
        self.scene, self.fine = scene, fine or DipoleFineness()
        half = max(scene.cutout) / 2 + 0.5 if reach_px is None else reach_px
        self.reach = half * scene.pixel_um + self.fine.beyond_um
        self._rim = math.pi / (scene.wavelength_um * scene.f_number)  # rad/µm on the array
        # a polynomial of that degree holds a wave of so many radians from the middle to the end
        count = self.fine.count(2 * self._rim * self.reach)
        self._points = np.cos((2 * np.arange(count) + 1) * np.pi / (2 * count))
        self._fields = self._summed()

    def _summed(self) -> C16:
        """Return the six components ``(3, 2, n, n)`` at the Chebyshev points; a quarter is summed."""
        scene, optics = self.scene, self.scene.objective
        assert optics is not None and scene.vectorial
        along = self._rim * self.reach * math.sqrt(2)
        # pupil nodes lie up to pi/2 times as far apart as even ones; around, J_m of m > along are nothing
        radial = self.fine.count(math.pi / 2 * (along + self._turned()))
        pupil = dipole_pupil(scene, radial, self.fine.count(2 * along))
        sine = np.hypot(pupil.kx, pupil.ky) / self._rim
        light = pupil.light * np.exp(2j * np.pi * wavefront(scene, sine))
        half = self._points.size // 2
        at = self._points[:half] * self.reach
        quarter = np.zeros((3, 2, half, half), complex)
        for first in range(0, sine.size, CHUNK):
            part = slice(first, first + CHUNK)
            down, across = (np.exp(-1j * np.outer(at, k[part])) for k in (pupil.ky, pupil.kx))
            rows = down * light[:, :, None, part]
            quarter += (rows.reshape(-1, rows.shape[-1]) @ across.T).reshape(quarter.shape)
        fields = np.empty((3, 2, 2 * half, 2 * half), complex)
        for dipole, component in np.ndindex(3, 2):
            values = quarter[dipole, component]
            # odd in x where one of the two is along x and the other is not; in y likewise
            for axis, along_axis in ((1, 0), (0, 1)):
                sign = -1 if (dipole == along_axis) != (component == along_axis) else 1
                values = np.concatenate([values, sign * np.flip(values, axis)], axis)
            fields[dipole, component] = values
        return fields

    def _turned(self) -> float:
        """Return over how many radians the phase runs from the pupil's middle to its rim."""
        scene, optics = self.scene, self.scene.objective
        assert optics is not None
        k, rim = 2 * math.pi / scene.wavelength_um, math.cos(optics.half_angle_rad)
        turned = 2 * math.pi * sum(abs(waves) * (n + 1) for n, _, waves in scene.wavefront)
        if scene.specimen is None:
            return turned + k * optics.medium_index * abs(scene.z_um) * (1 - rim)
        deep, index = scene.specimen.depth_um, scene.specimen.index
        within = math.sqrt(max(0.0, 1 - (optics.numerical_aperture / index) ** 2))
        steeper = deep * optics.medium_index * (1 - rim) - (deep + scene.z_um) * index * (1 - within)
        return turned + k * abs(steeper)

    def response(self, scene: Scene, source_yx: tuple[float, float], pixel_yx: tuple[int, int]) -> F8:
        """Return the cutout of ``scene`` about a pixel, of a source whose chief ray is at ``source_yx`` (µm).

        Lenslets, gap, pixels and cutout are those of ``scene``, all else that of the fields.
        """
        n, side = self.fine.pixel, scene.pixel_fill * scene.pixel_um / 2
        t, w = rule(n)
        # places are counted from the source
        down, across = (
            (((np.arange(count) - count // 2 + pixel)[:, None] * scene.pixel_um + side * t).ravel() - source)
            for count, pixel, source in zip(scene.cutout, pixel_yx, source_yx, strict=True)
        )
        light = self._turned_light if scene.lattice.rotation_rad else self._light
        nt, ns = scene.cutout
        values = light(scene, source_yx, down, across).reshape(nt, n, ns, n)
        sums: F8 = np.einsum("tisj,i,j->ts", values, w, w) * side**2
        return sums

    def _light(self, scene: Scene, source_yx: tuple[float, float], down: F8, across: F8) -> F8:
        """Return the light (1/µm²) at places on the sensor, of lenslets along the pixels."""
        lattice = scene.lattice
        x, y = lattice.offset_um
        rows = self._axis(scene, lattice.row_pitch_um or lattice.pitch_um, y - source_yx[0], down)
        columns = self._axis(scene, lattice.pitch_um, x - source_yx[1], across)
        light = np.zeros((down.size, across.size))
        for field in self._fields.reshape(6, *self._fields.shape[2:]):
            light += np.abs(rows @ field @ columns.T) ** 2
        return light

    def _turned_light(self, scene: Scene, source_yx: tuple[float, float], down: F8, across: F8) -> F8:
        """Return the same of a turned array: the light of dipoles together is round, so pixels are turned instead."""
        lattice, (y0, x0) = scene.lattice, source_yx
        c, s = math.cos(lattice.rotation_rad), math.sin(lattice.rotation_rad)
        x, y = across[None, :], down[:, None]
        turned_y, turned_x = -s * x + c * y, c * x + s * y
        step = scene.pixel_um / STEPS
        grids = [
            step * np.arange(math.floor(v.min() / step) - 8, math.ceil(v.max() / step) + 9)
            for v in (turned_y, turned_x)
        ]
        # where a lenslet lies from the source, along the turned axes
        ox, oy = lattice.offset_um[0] - x0, lattice.offset_um[1] - y0
        upright = replace(lattice, rotation_rad=0.0, offset_um=(c * ox + s * oy, -s * ox + c * oy))
        light = self._light(replace(scene, lattice=upright), (0.0, 0.0), grids[0], grids[1])
        at = [(v - grid[0]) / step for v, grid in zip((turned_y, turned_x), grids, strict=True)]
        found: F8 = map_coordinates(light, at, order=5)
        return found

    def _axis(self, scene: Scene, pitch: float, lenslet: float, places: F8) -> C16:
        """Return the matrix ``(places, Chebyshev points)`` of one axis, along which one lenslet is at ``lenslet``."""
        lam, gap, focal = scene.wavelength_um, scene.lattice.gap_um, scene.lattice.types[0].focal_length_um
        most = math.ceil(self.reach / pitch) + 1
        centres = lenslet % pitch + pitch * np.arange(-most, most + 1)
        centres = centres[np.abs(centres) + pitch / 2 <= self.reach]
        far = self.reach + float(np.abs(places).max())
        steepest = self._rim + 2 * math.pi * far / (lam * gap) + math.pi * pitch / lam * abs(1 / gap - 1 / focal)
        u, w = rule(self.fine.count(steepest * pitch))
        x = centres[:, None] + u * pitch / 2
        phase = np.pi / lam * ((places[:, None, None] - x) ** 2 / gap - (x - centres[:, None]) ** 2 / focal)
        fade = np.clip((self.reach - np.abs(x)) / (0.5 * self.fine.beyond_um), 0, 1)
        weight = w * pitch / 2 * np.sin(np.pi / 2 * fade) ** 2 / math.sqrt(lam * gap)
        carried = np.exp(1j * phase).reshape(places.size, -1) * weight.ravel()
        return carried @ interpolation(self._points, x.ravel() / self.reach)


def wavefront(scene: Scene, rho: F8) -> F8:
    """Return the objective's aberration (waves) at radii of the pupil: terms of symmetry of revolution."""
    waves = np.zeros_like(rho)
    for n, m, share in scene.wavefront:
        assert m == 0 and n % 2 == 0
        # R_n^0(rho) is Legendre's polynomial of degree n/2 at 2 rho^2 - 1
        waves += share * np.polynomial.legendre.legval(2 * rho**2 - 1, [0] * (n // 2) + [1])
    return waves


def interpolation(points: F8, at: F8) -> F8:
    """Return the matrix from values at Chebyshev ``points`` in [-1, 1] to values ``at`` (barycentric)."""
    n = points.size
    weights = (-1.0) ** np.arange(n) * np.sin((2 * np.arange(n) + 1) * np.pi / (2 * n))
    apart = at[:, None] - points
    apart[apart == 0] = 1e-300
    terms = weights / apart
    found: F8 = terms / terms.sum(1, keepdims=True)
    return found
