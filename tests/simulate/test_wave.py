"""The wave level against the full coherent reference, and against itself."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import fresnel

from lfcal.camera import LensletLattice, LensType
from lfcal.simulate._symmetry import mirrored_rows
from lfcal.simulate.engines._wave import WavePlane
from lfcal.simulate.engines.base import EnergyError, PlaneEngine, Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.engines.field import FieldTable
from lfcal.simulate.engines.reference import ReferencePlane
from lfcal.simulate.scene import PupilIris, seidel
from tests.simulate.scenes import PIXEL, camera_scene, moments, relative_error

FINE = Sampling(nodes_per_px=4, margin_px=12, energy_floor=1e-3, coherent=True)
QUICK = Sampling(nodes_per_px=3, margin_px=5)


def at_both(scene, sampling=FINE, y=2 * PIXEL, x=-3 * PIXEL, samples=4.0):
    """Return the cutouts of the wave level and of the reference."""
    return WavePlane(scene, sampling).point(y, x), ReferencePlane(scene, Sampling(samples)).point(y, x)


@pytest.mark.few(3)
@pytest.mark.parametrize(("v", "bound"), [(3.0, 0.02), (1.15, 0.02), (-2.0, 0.02), (0.0, 0.01), (-0.5, 0.03)])
def test_against_the_reference(v, bound):
    found, wanted = at_both(camera_scene(v, cutout=(61, 61)))
    assert relative_error(found, wanted) < bound
    assert np.allclose(moments(found), moments(wanted), atol=0.02)
    shifted = np.roll(found, 1, 1)  # a pixel aside would show
    assert relative_error(shifted, wanted) > 5 * bound


@pytest.mark.long
@pytest.mark.parametrize(
    ("v", "fast", "bound"),
    [
        (2.0, True, 0.07),
        (4.0, False, 0.009),
        pytest.param(-2.0, True, 0.07, marks=pytest.mark.long),
        pytest.param(4.0, True, 0.06, marks=pytest.mark.long),
    ],
)
@pytest.mark.few(1)
def test_exact_rays_land_where_the_propagated_field_does(v, fast, bound):
    """Square f/2.8 lenslets behind F/2.2, and f/5 behind F/5; without exact angles 20 to 27 and 3 %."""
    gap = 132.46
    lattice = LensletLattice("square", 47.3, gap, (LensType(gap),))
    change = {"wavelength_um": 0.45, "pixel_um": 3.45, "image_um": v * gap, "lattice": lattice, "f_number": 2.172}
    scene = camera_scene(v, exact_rays=True, exact_defocus=True, **(change | {"aperture": "cell"} if fast else {}))
    sampling = Sampling(nodes_per_px=8 if fast else 5, margin_px=12, coherent=True)
    found, wanted = at_both(scene, sampling, samples=10.0 if fast else 5.0)
    assert relative_error(found, wanted) < bound
    plain = WavePlane(replace(scene, exact_rays=False, exact_defocus=False), sampling).point(2 * PIXEL, -3 * PIXEL)
    assert relative_error(plain, wanted) > 2.5 * bound


def test_default_sampling_is_good_to_a_few_percent():
    found, wanted = at_both(camera_scene(4.0, cutout=(61, 61)), QUICK)
    assert relative_error(found, wanted) < 0.05


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "change",
    [
        {"wavefront": seidel(spherical=0.3, coma=0.2), "iris": PupilIris()},
        {"pixel_fill": 0.7},
        {"pupil_um": 20e3},
        {"aperture": "cell"},
    ],
)
def test_against_the_reference_with(change):
    scene = camera_scene(3.0, cutout=(61, 61), **change)
    sampling = replace(FINE, nodes_per_px=5) if "pixel_fill" in change else FINE  # narrow pixels need more nodes
    found, wanted = at_both(scene, sampling)
    assert relative_error(found, wanted) < 0.03
    plain = WavePlane(camera_scene(3.0, cutout=(61, 61)), FINE).point(2 * PIXEL, -3 * PIXEL)
    assert relative_error(plain, wanted) > 0.04


@pytest.mark.parametrize("flag", ["exact_rays", "exact_defocus"])
@pytest.mark.few(1)
def test_exact_angles_follow_the_reference(flag):
    """A fast cone on long lenslets: sines and tangents part by more than the levels do."""
    pitch = 15 * PIXEL
    gap = 3.2 * pitch
    lattice = LensletLattice("square", pitch, gap, (LensType.focused_at(4.0, gap),), clear_um=pitch * 0.95)
    scene = camera_scene(4.0, lattice=lattice, image_um=4 * gap, f_number=3.2, cutout=(61, 61), period=(15, 15))
    found, wanted = at_both(replace(scene, **{flag: True}), samples=6.0)
    paraxial = WavePlane(scene, FINE).point(2 * PIXEL, -3 * PIXEL)
    assert relative_error(paraxial, wanted) > 0.05
    assert relative_error(found, wanted) < 0.5 * relative_error(paraxial, wanted)


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_every_array_turned(kind, rotation=0.3):
    pitch = 15 * PIXEL
    gap = 5 * pitch
    lattice = LensletLattice(kind, pitch, gap, (LensType.focused_at(3.0, gap),), rotation, (7.0, -3.0), clear_um=78.0)
    found, wanted = at_both(camera_scene(2.5, lattice=lattice, cutout=(61, 61)))
    assert relative_error(found, wanted) < 0.03


def test_a_single_lenslet_is_the_fresnel_pattern_of_its_aperture():
    """One square cell under a flat field: products of Fresnel integrals, pixel by pixel."""
    pitch = 15 * PIXEL
    gap = 5 * pitch
    lattice = LensletLattice("square", pitch, gap, (LensType(1e9),))
    scene = camera_scene(4.0, lattice=lattice, image_um=1e7, aperture="cell", cutout=(31, 31), period=(15, 15))
    engine = WavePlane(scene, Sampling(None, 6, 7, energy_floor=0.0))
    lens = engine.tables.kinds[0]
    n = lens.field.re.shape[0]
    flat = replace(lens, field=lens.field._replace(re=np.ones((n, n), np.float32), im=np.zeros((n, n), np.float32)))
    energy = np.zeros((n, n), np.float32)
    energy[n // 2, n // 2] = 1.0  # only the lenslet at the source
    engine.tables = replace(engine.tables, kinds=(replace(flat, energy=energy),), floor=0.5, reach_um=1.0)
    found = engine.point(0.0, 0.0)
    q = math.sqrt(2 / (scene.wavelength_um * gap))
    fine = (np.arange(31 * 24) - 31 * 12 + 0.5) * PIXEL / 24
    (s2, c2), (s1, c1) = fresnel(q * (fine + pitch / 2)), fresnel(q * (fine - pitch / 2))
    line = np.abs((c2 - c1) + 1j * (s2 - s1)) ** 2 / 2
    line = line.reshape(31, 24).mean(1) * PIXEL
    wanted = np.outer(line, line)
    inner = slice(5, 26)
    assert relative_error(found[inner, inner], wanted[inner, inner]) < 6e-3


@pytest.mark.long
@pytest.mark.parametrize("v", [4.0, pytest.param(0.4, marks=pytest.mark.long)])
def test_single_precision_is_enough(v):
    scene = camera_scene(v)
    single, double = (WavePlane(scene, Sampling(nodes_per_px=3, double=d)).point(4.0, 7.0) for d in (False, True))
    assert relative_error(single, double) < 3e-6


@pytest.mark.parametrize("v", [3.0, -3.0, 0.5])
def test_energy_out_never_exceeds_energy_in(v):
    engine = WavePlane(camera_scene(v, cutout=(121, 121)), QUICK)
    images = engine.rows([0, 7], [0, 11, 30])
    certificate = engine.certificate
    assert certificate.responses > 0
    assert certificate.energy_out <= certificate.energy_in * 1.002
    assert certificate.worst <= 1.02
    assert images.sum() <= certificate.energy_out * 1.001
    assert images.sum() == pytest.approx(certificate.energy_in, rel=0.06)


def test_a_window_wider_than_its_samples_allow_is_an_error_that_names_the_remedy():
    with pytest.raises(EnergyError, match="samples_per_px above 1"):
        WavePlane(camera_scene(3.0), Sampling(1.0, 3, 20)).point(0.0, 0.0)


def test_rows_points_and_offsets_are_the_same_responses():
    offsets = np.zeros((26, 45, 2))
    offsets[3, 5] = (1.3, -2.1)
    scene = camera_scene(3.0, offsets_um=offsets)
    engine = WavePlane(scene, QUICK)
    rows = engine.rows([3, 4], [5, 6, -40], workers=2)
    assert relative_error(rows[1, 1], engine.point(4 * PIXEL, 6 * PIXEL)) < 1e-6
    assert relative_error(rows[0, 0], engine.point(3 * PIXEL + 1.3, 5 * PIXEL - 2.1)) < 1e-6
    assert relative_error(rows[0, 2], rows[0, 0]) < 1e-5  # a period of 45 px further on, with its offset
    out = np.empty_like(rows)
    assert engine.rows([3, 4], [5, 6, -40], out=out, workers=1) is out
    assert np.array_equal(out, rows)


def test_finite_pupil_spreads_the_micro_images():
    """The pattern repeats after the micro-images' period, 47 px here, not after the lenslets', 45 px."""
    gap = camera_scene(3.0).gap_um
    scene = camera_scene(3.0, pupil_um=gap / (47 / 45 - 1))
    here, lenslets, images = WavePlane(scene, QUICK).rows([0], [0, 45, 47])[0]
    assert relative_error(images, here) < 1e-5
    assert relative_error(lenslets, here) > 0.2


def test_mirrored_rows_are_computed_once():
    scene = camera_scene(3.0, iris=PupilIris(7, 0.2, math.pi / 7))
    assert mirrored_rows(scene, np.array([-2, 0, 2, 5])) == {2: 0}
    engine = WavePlane(scene, QUICK)
    both = engine.rows([-2, 2], [4])
    responses = engine.certificate.responses
    alone = WavePlane(scene, QUICK)
    assert relative_error(alone.rows([2], [4])[0], both[1]) < 1e-5
    assert alone.certificate.responses == responses
    assert mirrored_rows(replace(scene, iris=PupilIris(7, 0.2, 0.1)), np.array([-2, 2])) == {}
    assert mirrored_rows(replace(scene, wavefront=((1, -1, 0.1),)), np.array([-2, 2])) == {}


def test_what_is_off_is_not_computed():
    with_it = WavePlane(camera_scene(4.0), QUICK).point(0.0, 0.0)
    without = WavePlane(camera_scene(4.0, main_diffraction=False), QUICK).point(0.0, 0.0)
    assert 0.02 < relative_error(without, with_it) < 0.3


@pytest.mark.parametrize("level", ["geometric", "wave", "reference"])
def test_every_level_is_a_plane_engine(level):
    engine = engine_for(camera_scene(3.0, cutout=(31, 31)), level, Sampling(4.0) if level == "reference" else QUICK)
    assert isinstance(engine, PlaneEngine)
    assert engine.level == level
    image = engine.rows([0], [0])[0, 0]
    assert image.dtype == np.float32
    assert np.isfinite(image).all()
    assert engine.predicted_seconds(10) == pytest.approx(10 * engine.predicted_seconds(1))
    assert engine.certificate.responses > 0


def test_engine_for_refuses_what_makes_no_sense():
    for level, scene in (
        ("debye", camera_scene()),
        ("fast", camera_scene()),
        ("wave", camera_scene(lenslet_diffraction=False)),
    ):
        with pytest.raises(ValueError, match=";"):
            engine_for(scene, level)


def test_field_table_names_its_mode():
    assert FieldTable("E", 1.0, np.zeros((2, 2), complex), 1.0).mode == "E"
