"""The geometric level against random rays, and its exact areas."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.camera import preset
from lfcal.simulate.engines._geometric import GeometricPlane
from lfcal.simulate.engines._polygon import half_planes, iris_outline
from lfcal.simulate.scene import PupilIris, Scene
from lfcal.simulate.staging import scene_of
from tests.simulate.scenes import PIXEL, camera_scene, microscope_scene, moments, relative_error


def thrown(scene: Scene, y_um: float, x_um: float, rays: int = 200_000) -> np.ndarray:
    """Return the cutout that random rays draw, traced in the full camera: pupil, image, array, sensor."""
    rng = np.random.default_rng(1)
    outline = iris_outline(scene.iris)
    normal, offset = half_planes(outline)
    reach = float(np.abs(outline).max())
    u = rng.uniform(-reach, reach, (rays, 2))
    u = u[(u @ normal.T <= offset).all(1)]
    chief = np.array([x_um, y_um]) / scene.scale
    on_array = chief + scene.reduced_image_um * u / (2 * scene.f_number)
    slope = -u / (2 * scene.f_number)
    basis = scene.lattice.basis_um()
    index = np.rint((on_array - scene.lattice.offset_um) @ np.linalg.inv(basis)).astype(int)
    best = np.full(len(u), np.inf)
    centre, kind = np.zeros_like(u), np.zeros(len(u), int)
    for dq in (-1, 0, 1):
        for dr in (-1, 0, 1):
            q, r = index[:, 0] + dq, index[:, 1] + dr
            c = scene.lattice.centres_um(q, r)
            d = np.hypot(*(on_array - c).T)
            better = d < best
            best[better], centre[better] = d[better], c[better]
            kind[better] = scene.lattice.type_of(q, r)[better]
    passed = best <= scene.clear_radius_um if scene.aperture == "circle" else np.ones(len(u), bool)
    focal = np.array([t.focal_length_um for t in scene.lattice.types])[kind]
    sensor = on_array + scene.reduced_gap_um * (slope - (on_array - centre) / focal[:, None])
    pixel = np.floor(sensor / scene.reduced_pixel_um + 0.5).astype(int)
    row, column = scene.nearest_pixel(y_um, x_um)
    nt, ns = scene.cutout
    t, s = pixel[:, 1] - row + nt // 2, pixel[:, 0] - column + ns // 2
    seen = passed & (t >= 0) & (t < nt) & (s >= 0) & (s < ns)
    image = np.zeros((nt, ns))
    np.add.at(image, (t[seen], s[seen]), 1 / len(u))
    return image


@pytest.mark.few(1)
@pytest.mark.parametrize("v", [4.0, -2.5, 0.3, 0.0])
def test_spots_against_random_rays(v):
    scene = scene_of(preset("bench"), virtual_depth=v, cutout=(57, 57), iris=PupilIris(7, 0.3, 0.2))
    image = GeometricPlane(scene).point(2.1 * PIXEL, -3.7 * PIXEL)
    wanted = thrown(scene, 2.1 * PIXEL, -3.7 * PIXEL)
    assert image.sum() == pytest.approx(wanted.sum(), abs=6e-3)
    noise = np.sqrt(np.maximum(wanted, 1e-6) / 150_000).sum() / wanted.sum()
    assert relative_error(image, wanted) < 1.5 * noise + 4e-3


@pytest.mark.long
def test_microscope_cells_against_random_rays():
    scene = microscope_scene(8.0)
    image = GeometricPlane(scene).point(9.0, -13.0)
    wanted = thrown(scene, 9.0, -13.0)
    assert image.sum() == pytest.approx(1.0, abs=2e-3)
    assert relative_error(image, wanted) < 0.09


def test_mean_energy_is_the_fill_factor():
    scene = camera_scene(4.0, period=(26, 45), cutout=(121, 121))
    images = GeometricPlane(scene).rows(range(-13, 13), range(-22, 23))
    assert images.sum((2, 3)).mean() == pytest.approx(scene.fill_factor, rel=3e-3)


def test_spots_that_cross_the_edge_are_cut_not_dropped():
    whole = GeometricPlane(camera_scene(4.0, cutout=(121, 121))).point(0.0, 0.0)
    part = GeometricPlane(camera_scene(4.0, cutout=(21, 31))).point(0.0, 0.0)
    assert np.abs(whole[50:71, 45:76] - part).max() < 1e-7 * whole.max() + 1e-9
    assert part[:, 0].sum() + part[0].sum() > 0


def test_both_forms_of_the_map_meet_where_they_change():
    edge = 14.5 / 15  # shadow as large as a lenslet
    near, far = (GeometricPlane(camera_scene(edge * f, iris=PupilIris())).point(3.0, 8.0) for f in (1 - 1e-6, 1 + 1e-6))
    assert relative_error(near, far) < 5e-3


def test_a_step_moves_the_array_and_an_offset_the_source():
    plane = GeometricPlane(camera_scene(4.0, cutout=(91, 91)))
    here, next_one, there = plane.rows([0], [0, 1, 45])[0]  # one period along x
    assert relative_error(there, here) < 1e-5 and relative_error(next_one, here) > 0.1
    assert abs(moments(here)[1]) < 1.0
    offsets = np.zeros((26, 45, 2))
    offsets[2, 3] = (1.1, -0.7)
    elsewhere = plane.point(2 * PIXEL + 1.1, 3 * PIXEL - 0.7)
    scene = camera_scene(4.0, cutout=(91, 91), offsets_um=offsets)
    assert np.array_equal(GeometricPlane(scene).rows([2], [3])[0, 0], elsewhere)


def test_a_wrong_rotation_of_the_iris_shows():
    right, turned = (
        GeometricPlane(camera_scene(4.0, iris=PupilIris(3, 0.0, angle))).point(0.0, 0.0)
        for angle in (0.4, 0.4 + math.pi)
    )
    assert relative_error(turned, right) > 0.3
