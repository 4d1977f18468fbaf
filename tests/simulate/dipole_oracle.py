"""A microscope's dipole by plain sums over a two-dimensional pupil: no numerics shared with the engines."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.simulate.scene import Scene

RADIAL, AROUND = 160, 192
"""Nodes of the pupil along the angle from the axis, in each section, and around it."""


class Pupil(NamedTuple):
    """Spatial frequencies on the array (rad/µm), amplitudes ``(3 dipoles, 2 components, n)`` with weights in them.

    ``energy`` (3, 2) is that of each component, ``power`` (n,) that at each node; both sum to 1.
    """

    kx: NDArray[np.float64]
    ky: NDArray[np.float64]
    light: NDArray[np.complex128]
    energy: NDArray[np.float64]
    power: NDArray[np.float64]


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


def dipole_light(pupil: Pupil, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the light of the three dipoles together at points (x, y) on the array (1/µm²)."""
    waves = np.exp(-1j * (np.outer(x, pupil.kx) + np.outer(y, pupil.ky)))
    fields = np.einsum("pq,kcq->kcp", waves, pupil.light)
    light: NDArray[np.float64] = (np.abs(fields) ** 2).sum((0, 1))
    return light
