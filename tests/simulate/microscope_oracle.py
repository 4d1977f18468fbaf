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
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from lfcal.simulate.scene import Scene

__all__ = ["DipoleFields", "DipoleFineness", "dipole_light", "dipole_pupil"]
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


RADIAL, AROUND = 160, 192
"""Nodes of the pupil along the angle from the axis, in each section, and around it."""


class Pupil(NamedTuple):
    """Spatial frequencies on the array (rad/µm), amplitudes ``(3 dipoles, 2 components, n)`` with weights in them.

    ``energy`` (3, 2) is that of each component, ``power`` (n,) that at each node; both sum to 1.
    """

    kx: F8
    ky: F8
    light: C16
    energy: F8
    power: F8


def dipole_pupil(scene: Scene, radial: int = RADIAL, around: int = AROUND) -> Pupil:
    """Return what dipoles along x, y and z send through the pupil, vector by vector; unit energy of all three."""
    optics, specimen = scene.objective, scene.specimen
    assert optics is not None
    n1, k0 = optics.medium_index, 2 * np.pi / scene.wavelength_um
    n2 = n1 if specimen is None else specimen.index
    depth = 0.0 if specimen is None else specimen.depth_um
    ends = [0.0, optics.half_angle_rad]
    if n2 < optics.numerical_aperture:
        ends.insert(1, float(np.arcsin(n2 / n1)))
    x, w = np.polynomial.legendre.leggauss(radial)
    # cosine-spaced: square roots at the ends of a section are then smooth
    u, du = (1 - np.cos(np.pi * (x + 1) / 2)) / 2, w * np.pi / 4 * np.sin(np.pi * (x + 1) / 2)
    t = np.concatenate([a + (b - a) * u for a, b in pairwise(ends)])
    dt = np.concatenate([(b - a) * du for a, b in pairwise(ends)])
    phi = 2 * np.pi * np.arange(around) / around
    t, phi = (v.ravel() for v in np.meshgrid(t, phi, indexing="ij"))
    dt = np.repeat(dt, around) * 2 * np.pi / around

    c1, s1, cp, sp = np.cos(t).astype(complex), np.sin(t), np.cos(phi), np.sin(phi)
    s2 = n1 / n2 * s1
    c2 = np.sqrt(1 - s2.astype(complex) ** 2)
    zero = np.zeros_like(c2)
    ray = np.array([s2 * cp, s2 * sp, c2])  # plane wave of the specimen
    across, along = np.array([-sp + zero, cp + zero, zero]), np.array([c2 * cp, c2 * sp, -s2])
    # leaving the specimen: Fresnel's coefficients of the way out, amplitude per solid angle of the medium
    ts = 2 * n2 * c2 / (n2 * c2 + n1 * c1)
    tp = 2 * n2 * c2 / (n1 * c2 + n2 * c1)
    angle = n1 * c1 / (n2 * c2)
    phase = np.exp(1j * k0 * ((depth + scene.z_um) * n2 * c2 - depth * n1 * c1))
    radially = np.array([cp, sp])
    turning = np.array([-sp, cp])
    light = np.empty((3, 2, t.size), complex)
    for k in range(3):
        p = np.zeros((3, 1))
        p[k] = 1
        sent = p - ray * (ray * p).sum(0)
        found = tp * (along * sent).sum(0) * radially + ts * (across * sent).sum(0) * turning
        # the objective and the tube lens: energy per solid angle becomes energy per area of the pupil
        light[k] = found * angle * phase / np.sqrt(c1)
    kx, ky = (k0 * n1 * s1 / optics.magnification * v for v in (cp, sp))
    area = (k0 * n1 / optics.magnification) ** 2 * s1 * c1.real * dt
    power = np.abs(light) ** 2 * area
    whole = power.sum()
    scaled = light * area / np.sqrt(whole) / (2 * np.pi)
    return Pupil(kx, ky, scaled, power.sum(-1) / whole, power.sum((0, 1)) / whole)


def dipole_light(pupil: Pupil, x: F8, y: F8) -> F8:
    """Return the light of the three dipoles together at points (x, y) on the array (1/µm²)."""
    waves = np.exp(-1j * (np.outer(x, pupil.kx) + np.outer(y, pupil.ky)))
    fields = np.einsum("pq,kcq->kcp", waves, pupil.light)
    light: F8 = (np.abs(fields) ** 2).sum((0, 1))
    return light


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
