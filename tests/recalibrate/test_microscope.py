"""Recalibration of a light-field microscope on a frame of a simulator that shares no code with the engines.

The field on the array is Debye's integral, as Broxton et al. (2013) print it. Square lenslets change its phase, and an
angular spectrum on one fine grid propagates it to the sensor. The error of H is judged at positions without light.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import j0

from lfcal.camera import Camera, Microscope, ScanPlan, preset
from lfcal.fit import NewFrame, Setup
from lfcal.fit.model import Fineness, predict
from lfcal.fit.parameters import ScanScales, Vector
from lfcal.recalibrate import recalibrate
from lfcal.recalibrate.recalibrate import DETERMINED
from lfcal.simulate.staging import scene_for
from tests.recalibrate.common import described, the_window

SIDE, CUTOUT, DEPTHS = 110, 61, (-13.0, 8.0)
FINE = 6
"""Samples per pixel."""
PEAK = 3000.0
"""Brightest pixel (electrons)."""
WRONG = {"gap_um": 60.0, "rotation_rad": 1e-3, "pitch_um": 0.1, "offset_y_um": 3.3, "offset_x_um": 3.3}
WRONG |= {"focal_0_um": 40.0, "numerical_aperture": 0.02}
"""Largest difference of the camera from its description: 2.4 % of the gap, 0.4 px, 1.6 % of f, 4 % of the aperture."""


def small_microscope() -> ScanPlan:
    """Return the plan of a 20x/0.5 light-field microscope with a small sensor."""
    camera = preset("lfm_20x05")
    camera = replace(camera, sensor=replace(camera.sensor, shape=(SIDE, SIDE), prnu=0.0))
    return ScanPlan.for_camera(camera, depths_um=DEPTHS, cutout=CUTOUT)


def debye(camera: Camera, z_um: float, r_um: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return the scalar field of a point at defocus ``z_um``, at distances ``r_um`` from its image; unit energy."""
    optics = camera.optics
    assert isinstance(optics, Microscope)
    k = 2 * np.pi * optics.medium_index / camera.wavelength_um
    alpha = np.arcsin(optics.numerical_aperture / optics.medium_index)
    t, w = np.polynomial.legendre.leggauss(160)
    t, w = alpha * (t + 1) / 2, w * alpha / 2
    lateral = j0(k / optics.magnification * np.multiply.outer(r_um, np.sin(t)))
    field = lateral @ (w * np.sqrt(np.cos(t)) * np.sin(t) * np.exp(-1j * k * z_um * (1 - np.cos(t))))
    found: NDArray[np.complex128] = field * k / (np.sqrt(2 * np.pi * (1 - np.cos(alpha))) * optics.magnification)
    return found


def pattern(setup: Setup, plan: ScanPlan, place: tuple[int, int, int]) -> NDArray[np.float64]:
    """Return the pattern ``(nt, ns)`` of a point."""
    z, y, x = place
    scene, camera = scene_for(setup.plan(plan), z, setup.effects), setup.camera
    own, lattice, px = camera.lattice, scene.lattice, camera.sensor.pixel_um
    n = FINE * (CUTOUT + 40)
    at = (np.arange(n) - (n - 1) / 2) * px / FINE
    v, u = np.meshgrid(at + y * px, at + x * px, indexing="ij")
    row, column = scene.source_um(y, x)
    r = np.hypot(v - row, u - column)
    knots = np.linspace(0, r.max(), 3000)
    radial = debye(camera, setup.plan(plan).depths_um[z], knots)
    field = np.interp(r, knots, radial.real) + 1j * np.interp(r, knots, radial.imag)
    c, s = np.cos(own.rotation_rad), np.sin(own.rotation_rad)
    along, down = (u - lattice.offset_um[0]), (v - lattice.offset_um[1])
    along, down = c * along + s * down, c * down - s * along
    away = [one - own.pitch_um * np.rint(one / own.pitch_um) for one in (along, down)]
    square = away[0] ** 2 + away[1] ** 2
    field = field * np.exp(-1j * np.pi * square / (camera.wavelength_um * own.types[0].focal_length_um))
    f = np.fft.fftfreq(n, px / FINE)
    slope = camera.wavelength_um**2 * (f[:, None] ** 2 + f**2)
    spectrum = np.exp(2j * np.pi / camera.wavelength_um * own.gap_um * (np.sqrt(1 - slope) - 1))
    light = np.abs(np.fft.ifft2(np.fft.fft2(field) * spectrum)) ** 2 * (px / FINE) ** 2
    pixels: NDArray[np.float64] = light.reshape(n // FINE, FINE, n // FINE, FINE).sum((1, 3))
    return pixels[20:-20, 20:-20]


def summed(setup: Setup, plan: ScanPlan, index: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return patterns ``(n, nt, ns)`` of several points."""
    return np.stack([pattern(setup, plan, (z, y, x)) for z, y, x in index.tolist()])


@pytest.mark.long
@pytest.mark.parametrize("seed", (11, 12, 13))
def test_h_of_a_microscope_is_found_on_one_frame_of_beads(seed: int) -> None:
    plan, rng = small_microscope(), np.random.default_rng(seed)
    own, start = the_window(plan).plan, described(plan)
    start = replace(start, effects=tuple(one for one in start.effects if one.name != "vectorial"))  # scalar light
    vector = Vector(start, ScanScales.of(own), DETERMINED)
    true = vector.setup_at(
        vector.at({name: rng.choice((-1, 1)) * rng.uniform(0.6, 1) * most for name, most in WRONG.items()})
    )
    ny, nx = own.period
    index = np.stack([rng.integers(low, high, 26) for low, high in ((0, 2), (3, ny - 3), (3, nx - 3))], axis=1)
    patterns, light = summed(true, plan=own, index=index), np.zeros((SIDE, SIDE))
    for (_, y, x), one in zip(index[:20].tolist(), patterns, strict=False):
        light[y : y + CUTOUT, x : x + CUTOUT] += rng.uniform(0.3, 1) * one
    mean = PEAK * light / light.max() + 20 + np.linspace(-4, 4, SIDE)
    electrons = rng.poisson(mean) + 3 * rng.standard_normal(mean.shape)
    frame = NewFrame(electrons.astype(np.float32), noise=(9.0, 1.0))

    def error(setup: Setup) -> float:
        made = predict(setup, own, index[20:], np.zeros((6, 2)), Fineness.fine)
        return float(np.abs(made - patterns[20:]).sum() / patterns[20:].sum())

    found = recalibrate([frame], plan, effects=start.effects)
    before, floor, after = (error(one) for one in (start, true, found.setup))
    print(f"{seed}: {before:.3f} -> {after:.4f}, floor {floor:.4f}, {found.verdict}", found.notes)
    assert found.accepted, found.verdict
    assert before > 0.2 and after < 0.015, (before, after, floor)
