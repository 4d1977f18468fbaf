"""Planes, pupils and lenslets at which formulas divide by zero, cancel or run away."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import mpmath as mp
import numpy as np
from scipy.special import j1

from lfcal.camera import LensletLattice, LensType, Microscope
from lfcal.simulate.accuracy.sampling import steps_for
from lfcal.simulate.engines import field
from lfcal.simulate.engines._debye import debye_field, debye_nodes
from lfcal.simulate.engines._geometric import GeometricPlane
from lfcal.simulate.engines._propagator import sensor_propagator
from lfcal.simulate.engines._radial import focus_integral
from lfcal.simulate.engines._wave import WavePlane
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.field import wavefront_waves
from lfcal.simulate.engines.microscope import DebyePlane
from lfcal.simulate.engines.reference import ReferencePlane
from lfcal.simulate.scene import PupilIris, seidel
from tests.hard_cases.record import hard_case, worst
from tests.simulate.scenes import PIXEL, camera_scene, microscope_scene, moments, relative_error

FINE = Sampling(nodes_per_px=4, margin_px=12, energy_floor=1e-4)
QUICK = Sampling(nodes_per_px=3, margin_px=5)
AT = (2 * PIXEL, -3 * PIXEL)
ERROR = "relative L1 deviation from the coherent reference"


def wave(scene, sampling=QUICK, at=AT, mode=None):
    """Return a response of the wave level."""
    return WavePlane(scene, sampling, mode).point(*at)


def reference(scene, at=AT, samples=5.0, mode=None):
    """Return a response of the reference."""
    return ReferencePlane(scene, Sampling(samples), mode).point(*at)


@hard_case("Source on the native plane", wrong="1/a becomes infinite", measure=ERROR, bound=0.006)
def test_native_plane():
    scene = camera_scene(0.0)
    return relative_error(wave(scene, FINE), reference(scene, mode="U"))


@hard_case(
    "A nanometre from the native plane",
    wrong="phases of 1/a reach 1e8 rad and lose all significant digits",
    measure="largest change relative to the native plane, on both sides, divided by the peak",
    bound=1e-3,
)
def test_a_nanometre_away():
    here = wave(camera_scene(0.0))
    sides = [wave(replace(camera_scene(0.0), image_um=a)) for a in (1e-3, -1e-3)]
    return worst(*(float(np.abs(side - here).max() / here.max()) for side in sides))


@hard_case(
    "Native plane, rays only",
    wrong="the shadow shrinks to a point and its density is infinite",
    measure="relative change over a nanometre, and energy in excess of 1",
    bound=1e-3,
)
def test_native_plane_geometric():
    planes = [GeometricPlane(replace(camera_scene(0.0), image_um=a)).point(*AT) for a in (0.0, 1e-3, 1e-300)]
    return worst(*(relative_error(p, planes[0]) for p in planes), float(planes[0].sum()) - 1)


@hard_case(
    "Inside the iris's depth of focus (Fresnel number 1)",
    wrong="if the spherical phase is removed, the error of the response is 6 %, and 15 % at Fresnel number 0.5",
    measure=ERROR,
    bound=0.015,
)
def test_depth_of_focus():
    scene = camera_scene(100 * 0.55 / camera_scene().gap_um)
    return relative_error(wave(scene, FINE), reference(scene, mode="U"))


@hard_case(
    "Spots of neighbouring lenslets overlap",
    wrong="intensities are added although fields interfere",
    measure=ERROR + ", with the summation that the code chooses",
    bound=0.02,
)
def test_overlapping_spots():
    scene = camera_scene(-0.8)
    return relative_error(wave(scene, FINE), reference(scene))


@hard_case(
    "Change from near to far field",
    wrong="a jump between neighbouring planes where the method changes",
    measure="relative L1 difference of the planes on both sides of the change",
    bound=0.006,
)
def test_switch():
    one = field.SWITCH * 4 * camera_scene().f_number ** 2 * camera_scene().wavelength_um
    near, far = (replace(camera_scene(), image_um=one * (1 + side)) for side in (-1e-9, 1e-9))
    engines = [WavePlane(scene, FINE) for scene in (near, far)]
    assert [engine.mode for engine in engines] == ["U", "E"]
    return relative_error(*(engine.point(*AT) for engine in engines))


@hard_case(
    "Lenslet exactly in focus, rays only",
    wrong="division by sigma = 0",
    measure="energy lost or gained if sigma of one type is 0 or +-1e-16",
    bound=1e-6,
)
def test_focus_geometric():
    light = [float(GeometricPlane(camera_scene(2.0 * (1 + d))).point(*AT).sum()) for d in (1e-3, 0.0, 1e-16, -1e-16)]
    return worst(*(abs(value - light[1]) for value in light[2:]), abs(light[0] - light[1]) - 1e-2)


@hard_case(
    "Lenslet exactly in focus",
    wrong="division by sigma = 0",
    measure="relative L1 change between sigma = 0 and 1e-9",
    bound=1e-5,
)
def test_focus_wave():
    at = (2.3 * PIXEL, -3.4 * PIXEL)  # no spot's middle lies on the border of two pixels
    return relative_error(wave(camera_scene(2.0 * (1 + 2e-9)), at=at), wave(camera_scene(2.0), at=at))


@hard_case(
    "Iris smaller than a lenslet",
    wrong="windows follow the centre of the lenslet and miss the light",
    measure=ERROR + ", with the narrowest windows in use, far from the centre of the lenslet",
    bound=0.08,
)
def test_small_iris():
    pitch = 22 * PIXEL
    types = tuple(LensType.focused_at(depth, 5 * pitch) for depth in (2.0, 3.0, 5.0))
    lattice = LensletLattice("hexagonal", pitch, 5 * pitch, types, clear_um=21.5 * PIXEL)
    scene = camera_scene(image_um=15 * pitch, lattice=lattice, f_number=20.0, cutout=(41, 41))
    at = (0.0, 8 * PIXEL)
    # near the native plane windows are chosen where no grid holds the scene; they are as wide as elsewhere
    narrowest = steps_for(replace(scene, image_um=8 * scene.image_um), "wave")[0].sampling
    return relative_error(wave(scene, narrowest, at), reference(scene, at))


@hard_case(
    "On-axis null (u = 4 pi)",
    wrong="normalising by the peak divides by 1e-29",
    measure="error of the energy of the normalised field",
    bound=3e-3,
)
def test_null():
    v = np.linspace(0, 700, 20001)
    light = np.abs(focus_integral(4 * math.pi, v)) ** 2
    assert light[0] < 1e-28
    return abs(float(np.trapezoid(light * v, v)) / 2 - 1)


@hard_case(
    "Defocus of exactly zero in the focal integral",
    wrong="the Lommel series are 0/0 at u = 0 and u = v",
    measure="largest deviation from the Airy pattern at u = 0 and 1e-12",
    bound=1e-12,
)
def test_lommel():
    v = np.array([1e-12, 1e-6, 1.0, 10.0])
    return worst(*(float(np.abs(focus_integral(u, v) - 2 * j1(v) / v).max()) for u in (0.0, 1e-12)))


@hard_case(
    "Debye integral far from focus",
    wrong="a fixed number of nodes causes errors of 50 to 2000 %",
    measure="largest error divided by the peak, at z = 400 µm",
    bound=1e-11,
)
def test_debye_nodes():
    scene = microscope_scene(400.0)
    r = np.linspace(0, 5000, 40)
    wanted = debye_field(scene, r, nodes=2 * debye_nodes(scene, 5000.0))
    assert np.abs(debye_field(scene, r, nodes=40) - wanted).max() > 0.5 * np.abs(wanted).max()
    return float(np.abs(debye_field(scene, r) - wanted).max() / np.abs(wanted).max())


@hard_case(
    "NA within 1e-6 of the index",
    wrong="the apodisation has a branch point at 90 degrees",
    measure="relative change of the field when the number of nodes is doubled",
    bound=1e-12,
)
def test_aperture_near_index():
    scene = microscope_scene(1.0, objective=Microscope(20.0, 1.0 - 1e-6, 1.0), f_number=10.0)
    r = np.linspace(0, 200, 30)
    wanted = debye_field(scene, r, nodes=2 * debye_nodes(scene, 200.0))
    return float(np.abs(debye_field(scene, r) - wanted).max() / np.abs(wanted).max())


@hard_case(
    "Sphere minus its parabola",
    wrong="sqrt(1 - s) - 1 loses digits by cancellation; k sqrt(b^2 + r^2) has an error of 0.3 rad in single precision",
    measure="error of the exact defocus in waves, at 1e5 waves of defocus",
    bound=1e-10,
)
def test_cancellation():
    scene = camera_scene(1e4, exact_defocus=True, f_number=2.0)
    u = np.linspace(1e-6, 1, 50)
    mp.mp.dps = 40
    a = mp.mpf(scene.image_um) / mp.mpf(scene.wavelength_um)
    sine2 = [(mp.mpf(float(x)) / 4) ** 2 for x in u]
    exact = np.array([float(a * (1 - mp.sqrt(1 - s) - s / 2)) for s in sine2])
    found = wavefront_waves(scene, u, np.zeros(1))
    return float(np.abs(found - exact).max())


@hard_case(
    "Evanescent waves",
    wrong="the square root of a negative number is NaN and spreads over the whole FFT",
    measure="largest modulus of the transfer function minus 1",
    bound=1e-12,
)
def test_evanescent():
    step, _ = sensor_propagator(np.fft.fftfreq(64, 0.1), 0.55, 500.0, True)
    assert step[32, 32] == 0
    return float(np.abs(step).max() - 1)


@hard_case(
    "Nothing passes the iris",
    wrong="normalising an empty plane is 0/0",
    measure="largest value of the response, all levels",
    bound=0.0,
)
def test_empty_plane():
    values = [0.0]
    for v in (3.0, 0.1):
        scene = camera_scene(v, iris=PupilIris(9, stop=(9.0, 0.0, 1.0)))
        values += [float(np.abs(p).max()) for p in (wave(scene), GeometricPlane(scene).point(*AT), reference(scene))]
    return worst(*values)


@hard_case(
    "Lenslets that miss the cutout",
    wrong="the list of lenslets is empty",
    measure="energy in a cutout of one pixel between two spots",
    bound=0.01,
)
def test_dark_pixel():
    scene = camera_scene(2.0, cutout=(1, 1), lattice=replace(camera_scene().lattice, clear_um=20.0))
    return float(wave(scene, at=(0.0, 7.5 * PIXEL)).sum())


@hard_case(
    "Enormous defocus (v = 1e4)",
    wrong="a table of the whole shadow would need 1e11 samples",
    measure="difference of the mean response from the geometric one",
    bound=0.03,
)
def test_enormous_defocus():
    scene = camera_scene(1e4)
    rays = GeometricPlane(scene).point(*AT)
    return abs(float(wave(scene).sum() / rays.sum()) - 1)


@hard_case(
    "Extreme defocus (v = 1e12), rays only",
    wrong="overflow, or a loop over every lenslet of the shadow",
    measure="response divided by that of evenly lit lenslets, minus 1",
    bound=0.05,
)
def test_absurd_defocus():
    scene = camera_scene(1e12, cutout=(121, 121))
    light = float(GeometricPlane(scene).point(*AT).sum())
    even = scene.fill_factor * (121 * PIXEL) ** 2 / (math.pi * scene.shadow_radius_um**2)
    return abs(light / even - 1)


@hard_case(
    "Eight waves of spherical aberration",
    wrong="the phase is too steep for the sampling, so energy is created or lost",
    measure="energy on the sensor divided by that behind the lenslets, minus 1 (absolute value)",
    bound=0.03,
)
def test_strong_aberration():
    scene = camera_scene(4.0, wavefront=seidel(spherical=8.0), cutout=(121, 121))
    # sums of fields have no tails that make up for windows which are too narrow
    engine = WavePlane(scene, replace(QUICK, coherent=True))
    engine.point(*AT)
    certificate = engine.certificate
    return abs(certificate.energy_out / certificate.energy_in - 1)


@hard_case(
    "Denormal inputs",
    wrong="the square of 5e-324 is 0, and its reciprocal is infinite",
    measure="relative change of the response",
    bound=1e-6,
)
def test_denormal_inputs():
    tiny = sys.float_info.min * sys.float_info.epsilon
    plain = camera_scene(0.0)
    odd = replace(plain, image_um=tiny, wavefront=((4, 0, tiny), (3, 1, -tiny)))
    found = [wave(odd, at=(tiny, -tiny)), GeometricPlane(odd).point(tiny, -tiny)]
    wanted = [wave(plain, at=(0.0, 0.0)), GeometricPlane(plain).point(0.0, 0.0)]
    focus = relative_error(
        DebyePlane(microscope_scene(tiny)).point(0.0, 0.0), DebyePlane(microscope_scene(0.0)).point(0.0, 0.0)
    )
    return worst(focus, *(relative_error(f, w) for f, w in zip(found, wanted, strict=True)))


@hard_case(
    "Lenslets four times as high as wide",
    wrong="lists of lenslets and windows assume square cells",
    measure="energy that misses a cutout larger than every spot",
    bound=0.06,
)
def test_long_lenslets():
    pitch, gap = 6 * PIXEL, 5 * 15 * PIXEL
    lattice = LensletLattice("square", pitch, gap, (LensType.focused_at(3.0, gap),), row_pitch_um=4 * pitch)
    scene = camera_scene(3.0, lattice=lattice, aperture="cell", cutout=(91, 91), period=(24, 6))
    return 1.0 - float(wave(scene, Sampling(nodes_per_px=4, margin_px=12)).sum())


@hard_case(
    "Displacement by half a pixel",
    wrong="a centring error of half a pixel causes an error of 177 %",
    measure="distance of the centroid from the central pixel for symmetric optics, all levels (px)",
    bound=1e-3,
)
def test_centring():
    lattice = LensletLattice("square", 15 * PIXEL, 5 * 15 * PIXEL, (LensType(600.0),), clear_um=78.0)
    scene = camera_scene(3.0, lattice=lattice, iris=PupilIris())
    images = [
        wave(scene, at=(0.0, 0.0)),
        wave(replace(scene, image_um=0.0), at=(0.0, 0.0)),
        GeometricPlane(scene).point(0.0, 0.0),
        reference(scene, (0.0, 0.0), 4.0),
        reference(scene, (0.0, 0.0), 5.0),
        DebyePlane(microscope_scene(5.0)).point(0.0, 0.0),
    ]
    return worst(*(abs(value) for image in images for value in moments(image)))
