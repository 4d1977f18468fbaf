"""What a scene derives from a camera."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import PRESETS, preset
from lfcal.simulate.engines.zernike import zernike_radial
from lfcal.simulate.scene import PupilIris, Scene, seidel
from lfcal.simulate.staging import scene_of
from tests.simulate.scenes import camera_scene


@pytest.mark.parametrize("name", [name for name in PRESETS if preset(name).has_lattice])
@pytest.mark.parametrize("v", [-3.0, 0.0, 2.5])
def test_reduced_frame_is_the_same_optics_with_a_telecentric_pupil(name, v):
    """A chief ray and the ray through a pupil point cross array and sensor at the same places in both frames."""
    scene = scene_of(preset(name), virtual_depth=v, cutout=(31, 31))
    b, a, gap = scene.pupil_um, scene.image_um, scene.gap_um
    on_sensor, pupil = 123.0, 0.7 / (2 * scene.f_number)  # chief ray's foot, slope of the ray from the pupil point
    on_array = on_sensor / scene.scale
    if math.isinf(b):
        image, slope = on_array, -pupil
        ray = on_array + a * pupil
    else:
        image = on_array * (1 + a / b)
        ray = b * pupil + (image - b * pupil) * b / (b + a)  # at the array, from the pupil point to the image
        slope = (image - b * pupil) / (b + a)
    assert ray == pytest.approx(on_array + scene.reduced_image_um * pupil, rel=1e-12)
    at_sensor = ray + gap * slope
    reduced = on_array + scene.reduced_image_um * pupil - scene.reduced_gap_um * pupil
    assert at_sensor == pytest.approx(reduced * scene.scale, rel=1e-12)


def test_sigma_is_zero_where_a_type_is_in_focus():
    camera = preset("r29")
    for kind, v in enumerate((2.0, 3.0, 5.0)):
        assert abs(scene_of(camera, virtual_depth=v, cutout=(31, 31)).sigma(kind)) < 1e-15
    assert scene_of(camera, cutout=(31, 31)).sigma(0) == math.inf


def test_lenslets_are_closer_than_their_images():
    camera = preset("r29")
    scene = scene_of(camera, virtual_depth=4.0, cutout=(181, 181))
    assert scene.lattice.pitch_um * scene.scale == pytest.approx(camera.lattice.pitch_um, rel=1e-14)
    assert scene.scale == pytest.approx(camera.lattice_scale)
    assert scene.period == (55, 95)
    assert scene.shadow_radius_um / scene.lattice.pitch_um == pytest.approx(2.0, rel=0.02)


def test_telecentric_model_keeps_the_array():
    finite = scene_of(preset("r29"), virtual_depth=4.0, cutout=(31, 31))
    telecentric = scene_of(preset("r29"), virtual_depth=4.0, cutout=(31, 31), pupil_um=math.inf)
    assert telecentric.lattice == finite.lattice
    assert telecentric.scale == 1.0


def test_microscope_scene():
    scene = scene_of(preset("lfm_20x05"), z_um=25.0, cutout=(31, 31))
    assert scene.objective is not None
    assert scene.aperture == "cell"
    assert scene.fill_factor == 1.0
    assert scene.image_um == pytest.approx(-10_000)
    assert scene.period == (15, 15)


def test_anchor_moves_the_array_the_other_way():
    scene = scene_of(preset("bench"), virtual_depth=3.0, cutout=(31, 31), anchor_px=(0.25, -1.5))
    assert scene.anchor_px == pytest.approx((0.25, -1.5))
    assert scene.lattice.offset_um[0] * scene.scale == pytest.approx(1.5 * 5.5)


def test_gap_may_differ_from_the_camera_and_leaves_the_image():
    plain = scene_of(preset("bench"), virtual_depth=3.0, cutout=(31, 31))
    moved = scene_of(preset("bench"), virtual_depth=3.0, cutout=(31, 31), gap_um=plain.gap_um + 5)
    assert moved.gap_um == plain.gap_um + 5
    assert moved.image_um == plain.image_um


def test_nearest_pixel_and_offsets():
    offsets = np.zeros((26, 45, 2))
    offsets[3, 4] = (1.0, -2.0)
    scene = camera_scene(offsets_um=offsets)
    assert scene.nearest_pixel(2.7, -2.8) == (0, -1)
    assert scene.source_um(3, 4) == (3 * 5.5 + 1.0, 4 * 5.5 - 2.0)
    assert scene.source_um(3 + 26, 4 - 45) == (29 * 5.5 + 1.0, -41 * 5.5 - 2.0)


def test_seidel_terms_are_the_powers():
    rho = np.linspace(0, 1.1, 7)
    four = sum(w * zernike_radial(n, 0, rho) for n, _, w in seidel(spherical=0.7))
    assert np.abs(four - 0.7 * rho**4).max() < 1e-15
    three = sum(w * zernike_radial(n, abs(m), rho) for n, m, w in seidel(coma=-0.4) if m == 1)
    assert np.abs(three + 0.4 * rho**3).max() < 1e-15


@pytest.mark.parametrize("angle", [0.0, 0.6, 2.5, -1.1])
def test_coma_points_where_its_angle_says(angle):
    """W131 rho^3 cos(theta - angle) over the pupil, by the convention of `Scene.wavefront`: sines for m < 0."""
    rho, theta = np.linspace(0, 1, 6)[:, None], np.linspace(0, 2 * math.pi, 13)
    terms = seidel(coma=0.3, angle_rad=angle)
    found = sum(
        w * zernike_radial(n, abs(m), rho) * (np.cos(m * theta) if m >= 0 else np.sin(-m * theta)) for n, m, w in terms
    )
    assert np.abs(found - 0.3 * rho**3 * np.cos(theta - angle)).max() < 1e-15


@pytest.mark.parametrize(
    "change",
    [
        {"wavelength_um": math.nan},
        {"pixel_um": 0.0},
        {"image_um": math.inf},
        {"cutout": (4, 5)},
        {"period": (0, 3)},
        {"f_number": 0.2},
        {"aperture": "star"},
        {"pupil_um": -1.0},
        {"wavefront": ((3, 2, 0.1),)},
        {"wavefront": ((4, 0, math.inf),)},
        {"pixel_fill": 0.0},
        {"offsets_um": np.zeros((2, 2, 2))},
        {"pupil_um": 100.0, "image_um": -200.0},
    ],
)
def test_impossible_scenes_are_refused_in_one_line(change):
    with pytest.raises(InputError) as error:
        camera_scene(**change)
    assert "\n" not in str(error.value)
    assert ";" in str(error.value)


def test_bad_questions_are_refused():
    camera = preset("bench")
    with pytest.raises(InputError, match="both"):
        scene_of(camera, z_um=0.0, virtual_depth=2.0, cutout=(31, 31))
    with pytest.raises(InputError, match="nonsense"):
        scene_of(camera, virtual_depth=2.0, cutout=(31, 31), nonsense=1)
    with pytest.raises(InputError):
        PupilIris(2)
    with pytest.raises(InputError):
        PupilIris(6, stop=(0.0, 0.0, -1.0))


def test_scenes_compare_and_change():
    scene = camera_scene()
    assert scene == camera_scene()
    assert replace(scene, image_um=1.0) != scene
    assert isinstance(scene, Scene)


@pytest.mark.parametrize(("before", "after"), [(0.0, 2.0), (3.0, -1.5)])
def test_an_image_farther_behind_is_of_a_source_nearer_to_the_objective(before: float, after: float) -> None:
    camera = preset("lfm_20x05")
    first, second = (scene_of(camera, z_um=z, cutout=(31, 31)) for z in (before, after))
    found = first.refocused(second.image_um - first.image_um)
    assert found.z_um == pytest.approx(after, abs=1e-9) and first.z_um == pytest.approx(before)


def test_the_farthest_source_is_the_one_that_lies_farthest_from_its_place():
    offsets = np.zeros((26, 45, 2))
    assert camera_scene(offsets_um=offsets).farthest_um == camera_scene().farthest_um == 0.0
    offsets[3, 4], offsets[20, 40] = (1.0, -2.0), (-3.0, 4.0)
    assert camera_scene(offsets_um=offsets).farthest_um == pytest.approx(5.0)
