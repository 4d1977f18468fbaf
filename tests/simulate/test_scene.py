"""What a scene derives from a camera."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lfcal.base import InputError
from lfcal.camera import PRESETS, preset
from lfcal.simulate.engines.zernike import zernike_radial
from lfcal.simulate.scene import PupilIris, seidel
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


def test_values_of_scenes_are_those_of_the_presets():
    r29, bench = preset("r29"), preset("bench")
    for kind, v in enumerate((2.0, 3.0, 5.0)):
        assert abs(scene_of(r29, virtual_depth=v, cutout=(31, 31)).sigma(kind)) < 1e-15, "in focus"
    assert scene_of(r29, cutout=(31, 31)).sigma(0) == math.inf
    scene = scene_of(r29, virtual_depth=4.0, cutout=(181, 181))
    assert scene.lattice.pitch_um * scene.scale == pytest.approx(r29.lattice.pitch_um, rel=1e-14)
    assert scene.scale == pytest.approx(r29.lattice_scale) and scene.period == (55, 95)
    assert scene.shadow_radius_um / scene.lattice.pitch_um == pytest.approx(2.0, rel=0.02)
    telecentric = scene_of(r29, virtual_depth=4.0, cutout=(181, 181), pupil_um=math.inf)
    assert telecentric.lattice == scene.lattice and telecentric.scale == 1.0
    scope = scene_of(preset("lfm_20x05"), z_um=25.0, cutout=(31, 31))
    assert scope.objective is not None and scope.aperture == "cell" and scope.fill_factor == 1.0
    assert scope.image_um == pytest.approx(-10_000) and scope.period == (15, 15)
    plain, moved, longer = (
        scene_of(bench, virtual_depth=3.0, cutout=(31, 31), **change)
        for change in ({}, {"anchor_px": (0.25, -1.5)}, {"gap_um": 300.0})
    )
    assert moved.anchor_px == pytest.approx((0.25, -1.5))
    assert moved.lattice.offset_um[0] * moved.scale == pytest.approx(1.5 * 5.5), "the array moves the other way"
    assert longer.gap_um == 300.0 != plain.gap_um and longer.image_um == plain.image_um


def test_offsets_move_the_sources():
    offsets = np.zeros((26, 45, 2))
    assert camera_scene(offsets_um=offsets).farthest_um == camera_scene().farthest_um == 0.0
    offsets[3, 4], offsets[20, 40] = (1.0, -2.0), (-3.0, 4.0)
    scene = camera_scene(offsets_um=offsets)
    assert scene.farthest_um == pytest.approx(5.0)
    assert scene.nearest_pixel(2.7, -2.8) == (0, -1)
    assert scene.source_um(3, 4) == (3 * 5.5 + 1.0, 4 * 5.5 - 2.0)
    assert scene.source_um(3 + 26, 4 - 45) == (29 * 5.5 + 1.0, -41 * 5.5 - 2.0)


def test_seidel_terms_are_the_powers_and_coma_points_where_its_angle_says():
    """W131 rho^3 cos(theta - angle) over the pupil, by the convention of `Scene.wavefront`: sines for m < 0."""
    rho = np.linspace(0, 1.1, 7)
    four = sum(w * zernike_radial(n, 0, rho) for n, _, w in seidel(spherical=0.7))
    assert np.abs(four - 0.7 * rho**4).max() < 1e-15
    rho, theta = np.linspace(0, 1, 6)[:, None], np.linspace(0, 2 * math.pi, 13)
    for angle in (0.0, 0.6, 2.5, -1.1):
        found = sum(
            w * zernike_radial(n, abs(m), rho) * (np.cos(m * theta) if m >= 0 else np.sin(-m * theta))
            for n, m, w in seidel(coma=0.3, angle_rad=angle)
        )
        assert np.abs(found - 0.3 * rho**3 * np.cos(theta - angle)).max() < 1e-15, angle


REFUSED: dict[str, tuple[Any, ...]] = {
    "wavelength_um": (math.nan,),
    "pixel_um": (0.0,),
    "image_um": (math.inf,),
    "cutout": ((4, 5),),
    "period": ((0, 3),),
    "f_number": (0.2,),
    "aperture": ("star",),
    "pupil_um": (-1.0,),
    "wavefront": (((3, 2, 0.1),), ((4, 0, math.inf),)),
    "pixel_fill": (0.0,),
    "offsets_um": (np.zeros((2, 2, 2)),),
}


def test_impossible_scenes_are_refused_in_one_line():
    changes = [{name: value} for name, values in REFUSED.items() for value in values]
    for change in (*changes, {"pupil_um": 100.0, "image_um": -200.0}):
        with pytest.raises(InputError, match=";") as error:
            camera_scene(**change)
        assert "\n" not in str(error.value), change
    for options, match in (({"z_um": 0.0, "virtual_depth": 2.0}, "both"), ({"nonsense": 1}, "nonsense")):
        with pytest.raises(InputError, match=match):
            scene_of(preset("bench"), cutout=(31, 31), **options)
    for iris in ({"blades": 2}, {"stop": (0.0, 0.0, -1.0)}):
        with pytest.raises(InputError):
            PupilIris(**iris)


def test_an_image_farther_behind_is_of_a_source_nearer_to_the_objective() -> None:
    for before, after in ((0.0, 2.0), (3.0, -1.5)):
        first, second = (scene_of(preset("lfm_20x05"), z_um=z, cutout=(31, 31)) for z in (before, after))
        assert first == replace(first) != second
        found = first.refocused(second.image_um - first.image_um)
        assert found.z_um == pytest.approx(after, abs=1e-9) and first.z_um == pytest.approx(before)
