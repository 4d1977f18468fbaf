"""The field of the main lens on the array: closed forms, both modes, and the law of a thin lens."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import j1

from lfcal.base import InputError
from lfcal.camera import preset
from lfcal.simulate.engines import choose_mode
from lfcal.simulate.engines._radial import focus_integral
from lfcal.simulate.engines.field import field_spectrum, field_table
from lfcal.simulate.scene import PupilIris, Scene, seidel
from lfcal.simulate.staging import scene_of
from tests.simulate.scenes import PIXEL, camera_scene, microscope_scene


def about(table, half):
    """Return the values within ``half`` µm and their coordinates."""
    n, m = table.values.shape[0], int(half / table.dx_um)
    x = (np.arange(2 * m + 1) - m) * table.dx_um
    return table.values[n // 2 - m : n // 2 + m + 1, n // 2 - m : n // 2 + m + 1], x


def without_phase(a, b):
    """Return ``a`` turned to the phase of ``b``: a constant phase has no effect."""
    return a * np.exp(1j * np.angle((b * a.conj()).sum()))


@pytest.mark.parametrize("iris", [PupilIris(), PupilIris(stop=(0.0, 0.0, 50.0))])
def test_in_focus_it_is_the_airy_pattern(iris):
    """A plain circle takes the radial route, the same circle with a stop the FFT."""
    scene = camera_scene(0.0, iris=iris)
    field, x = about(field_table(scene, PIXEL / 3, 100.0), 60.0)
    r = np.hypot(x[:, None], x[None, :])
    k = math.pi * r / (scene.wavelength_um * scene.f_number)
    airy = (
        math.sqrt(math.pi)
        / (2 * scene.wavelength_um * scene.f_number)
        * np.where(k < 1e-9, 1.0, 2 * j1(np.maximum(k, 1e-9)) / np.maximum(k, 1e-9))
    )
    bound = 2e-6 if iris.circular else 3e-4  # a polygon of many sides represents the circle
    assert np.abs(field - airy).max() < bound * airy.max()


@pytest.mark.parametrize(
    ("v", "more"),
    [
        (3.0, {}),
        (3.0, {"iris": PupilIris(9, 0.0, 0.1), "exact_defocus": True}),
        (40.0, {"iris": PupilIris(9, 0.0, 0.1)}),  # a part of a large shadow
        (0.3, {}),
        (0.3, {"iris": PupilIris(9, 0.0, 0.1)}),
        (3.0, {"iris": PupilIris(9, stop=(5.0, 0.0, 1.0))}),  # no light
    ],
)
def test_the_spectrum_is_that_of_the_table(v, more):
    scene = camera_scene(v, **more)
    table = field_table(scene, PIXEL / 3, 100.0).values
    found = field_spectrum(scene, PIXEL / 3, 100.0)
    wanted = np.fft.fft2(table)
    assert found.shape == table.shape
    assert np.abs(found - wanted).max() <= 1e-13 * np.abs(wanted).max()


@pytest.mark.parametrize("v", [0.3, -0.3])
def test_near_field_of_a_polygon_route_is_the_radial_integral(v):
    scene = camera_scene(v, iris=PupilIris(stop=(0.0, 0.0, 50.0)))
    field, x = about(field_table(scene, PIXEL / 3, 90.0, "U"), 60.0)
    r = np.hypot(x[:, None], x[None, :])
    u = -2 * math.pi * scene.reduced_image_um / (4 * scene.f_number**2 * scene.wavelength_um)
    level = math.sqrt(math.pi) / (2 * scene.wavelength_um * scene.f_number)
    wanted = level * focus_integral(u, math.pi * r / (scene.wavelength_um * scene.f_number))
    assert np.abs(field - wanted).max() < 2e-3 * np.abs(wanted).max()


@pytest.mark.parametrize(
    ("number", "bound", "iris"),
    [(11.0, 0.012, PupilIris(9, 0.0, 0.1)), (17.0, 0.007, PupilIris()), (-14.0, 0.009, PupilIris(6, 0.5))],
)
def test_both_modes_agree_where_both_hold(number, bound, iris):
    unit = 4 * 25 * 0.55 / (5 * 15 * PIXEL)
    scene = camera_scene(number * unit, iris=iris, wavefront=seidel(spherical=0.1, coma=0.15), exact_defocus=True)
    assert abs(scene.fresnel_number - abs(number)) < 1e-9
    u, x = about(field_table(scene, PIXEL / 4, 90.0, "U"), 70.0)
    e, _ = about(field_table(scene, PIXEL / 4, 90.0, "E"), 70.0)
    sphere = np.exp(-1j * np.pi / (scene.wavelength_um * scene.reduced_image_um) * (x[:, None] ** 2 + x[None, :] ** 2))
    e = without_phase(e * sphere, u)
    light = np.abs(u) ** 2
    assert np.abs(np.abs(e) ** 2 - light).sum() < bound * light.sum()
    assert (np.abs(e - u) ** 2).sum() < (3 * bound) ** 2 * light.sum()
    mirrored = np.abs(e[:, ::-1]) ** 2  # coma the other way round would show
    assert np.abs(mirrored - light).sum() > 5 * bound * light.sum()


def test_modes_are_chosen_by_the_fresnel_number():
    modes = [choose_mode(scene) for scene in (*map(camera_scene, (0.0, 4.0, -4.0)), microscope_scene())]
    assert modes == ["U", "E", "E", "D"]


@pytest.mark.parametrize("v", [5.0, -5.0])
def test_shadow_is_the_iris_seen_from_the_image(v):
    """Behind the array the shadow is upright, before it upside down."""
    scene = camera_scene(v, iris=PupilIris(3, 0.0, 0.0), main_diffraction=False)
    field, x = about(field_table(scene, PIXEL / 2, 300.0), 290.0)
    light = np.abs(field) ** 2
    vertex = (np.abs(x) > 1.2 * scene.shadow_radius_um) & (np.sign(x) == np.sign(v))
    middle = np.abs(x) < 15
    assert light[np.ix_(middle, vertex)].max() > 50 * light[np.ix_(middle, vertex[::-1])].max()
    assert light.sum() * (PIXEL / 2) ** 2 == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize("v", [3.0, 0.2, -6.0])
def test_energy_is_one_through_the_iris_and_less_past_a_second_stop(v):
    whole = field_table(camera_scene(v), PIXEL / 3, 500.0)
    assert (np.abs(whole.values) ** 2).sum() * whole.dx_um**2 == pytest.approx(1.0, abs=5e-3)
    cut = field_table(camera_scene(v, iris=PupilIris(9, 0.0, 0.1, stop=(1.0, 0.0, 1.0))), PIXEL / 3, 500.0)
    assert (np.abs(cut.values) ** 2).sum() * cut.dx_um**2 == pytest.approx(0.391, abs=0.02)


@pytest.mark.parametrize("corner", [0.0, 1.0])
def test_part_of_a_large_shadow_is_the_part_of_the_whole(corner):
    """Near an edge the part is the same; elsewhere the ripple of distant edges averages out."""
    whole = camera_scene(60.0, iris=PupilIris(5, 0.0, 0.2, stop=(0.96 * corner, 0.0, 1.0) if corner else None))
    small, _ = about(field_table(whole, 5.0, 300.0), 280.0)
    large, _ = about(field_table(whole, 5.0, 0.95 * whole.shadow_radius_um), 280.0)
    light = np.abs(large) ** 2
    smooth = [np.abs(f) ** 2 @ np.ones(light.shape[1]) for f in (small, large)]
    assert np.abs(smooth[0] - smooth[1]).max() < 0.02 * smooth[1].max()
    assert np.abs(np.abs(small) ** 2 - light).sum() < 0.03 * light.sum()


def test_tables_that_cannot_be_computed_are_refused():
    for exact, limit in ((False, 12), (True, 8)):
        with pytest.raises(InputError, match=f"main_diffraction.*is below {limit}, got off; switch it on"):
            field_table(camera_scene(0.1, main_diffraction=False, exact_rays=exact), 2.0, 100.0)
    with pytest.raises(InputError, match="samples on each side"):
        field_table(camera_scene(0.1), 0.02, 500.0)
    with pytest.raises(InputError, match="increase the number of samples"):
        field_table(camera_scene(0.1), 5.0, 100.0)
    dark = field_table(camera_scene(3.0, iris=PupilIris(9, stop=(5.0, 0.0, 1.0))), 2.0, 100.0)
    assert not dark.values.any()


@pytest.mark.parametrize("v", [4.0, 0.6])
def test_even_aberrations_are_those_of_the_whole_pupil(v: float) -> None:
    """A term that is not even, with zero waves, makes the engine compute the whole pupil."""
    even, iris = ((2, 0, 0.4), (4, 0, -0.8)), PupilIris(blades=5, rotation_rad=0.2)
    for exact in (False, True):
        scenes = [
            camera_scene(v, iris=iris, exact_rays=exact, wavefront=waves)
            for waves in (even, (*even, (2, -2, 0.0)), (even[0], (2, 2, -0.8)))
        ]
        dx = 0.2 * scenes[0].reduced_pixel_um
        found, expected, other = (field_table(scene, dx, 40 * dx).values for scene in scenes)
        assert np.abs(found).max() > 0
        np.testing.assert_array_equal(found, expected)
        assert not np.array_equal(other, expected)


FAR_UM = 2e8  # of the lens from the array: angles at the image are those of a telecentric cone
NODES, ANGLES = 90, 400


def aperture(blades: int, turn: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return nodes (n, 2) and weights over a regular polygon of area pi, or the unit disc."""
    t, w = np.polynomial.legendre.leggauss(NODES)
    t, w = (t + 1) / 2, w / 2
    if blades == 0:
        angles = 2 * math.pi * np.arange(ANGLES) / (ANGLES)
        rho = np.sqrt(t)[:, None]
        points = np.stack([rho * np.cos(angles), rho * np.sin(angles)], axis=-1)
        return points.reshape(-1, 2), np.repeat(math.pi * w / (ANGLES), ANGLES)
    corner = turn + 2 * math.pi * np.arange(blades + 1) / blades
    radius = math.sqrt(2 * math.pi / (blades * math.sin(2 * math.pi / blades)))
    corners = radius * np.stack([np.cos(corner), np.sin(corner)], axis=1)
    points, weights = [], []
    for p, q in itertools.pairwise(corners):
        # a triangle from the middle: the outer side is mapped towards the middle
        points.append(t[:, None, None] * ((1 - t)[None, :, None] * p + t[None, :, None] * q))
        weights.append(w[:, None] * w * t[:, None] * abs(p[0] * q[1] - p[1] * q[0]))
    return np.concatenate(points).reshape(-1, 2), np.concatenate(weights).ravel()


def thin_lens(scene: Scene, at: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return the field at points (n, 2) of the array behind a thin lens with a stop of diameter b/Nw; unit energy."""
    points, weights = aperture(scene.iris.blades, scene.iris.rotation_rad)
    radius, k = (FAR_UM + scene.image_um) / (2 * scene.f_number), 2 * math.pi / scene.wavelength_um
    points = points * radius
    to_image = np.sqrt(np.square(points).sum(1) + (FAR_UM + scene.image_um) ** 2)
    found = []
    for x in at:
        way = np.sqrt(np.square(points - x).sum(1) + FAR_UM**2)
        # the path along the axis is subtracted from both, which are large numbers
        phase = k * ((way - FAR_UM) - (to_image - FAR_UM - scene.image_um))
        found.append((weights * FAR_UM / way**2 * np.exp(1j * phase)).sum())
    return np.array(found) * radius / (math.sqrt(math.pi) * scene.wavelength_um)


@pytest.mark.parametrize("blades", [0, 7])
@pytest.mark.parametrize("depth", [4.0, 0.2])
def test_the_field_of_the_tangent_law_is_that_behind_a_thin_lens(blades: int, depth: float) -> None:
    camera = preset("bench")
    camera = replace(camera, optics=replace(camera.optics, blades=blades))
    scene = scene_of(camera, virtual_depth=depth, cutout=(9, 9), pupil_um=math.inf)
    scene = replace(scene, exact_defocus=True, exact_rays=True)
    assert choose_mode(scene) == ("E" if depth > 1 else "U")

    def off(law: float) -> float:
        table = field_table(replace(scene, lens_law=law), 1.0, 240.0 if depth > 1 else 24.0)
        middle = len(table.values) // 2
        steps = np.linspace(0, 1.2 * scene.shadow_radius_um + 6, 12).astype(int)
        places = np.concatenate([np.stack([steps, 0 * steps], 1), np.stack([steps // 2, steps * 3 // 4], 1)])
        values = table.values[middle + places[:, 1], middle + places[:, 0]]
        if table.mode == "E":
            values = values * np.exp(-1j * math.pi * np.square(places).sum(1) / (scene.wavelength_um * scene.image_um))
        wanted = thin_lens(scene, places.astype(float))
        turn = np.vdot(values, wanted)
        values = values * turn / abs(turn)
        return float(np.linalg.norm(values - wanted) / np.linalg.norm(wanted))

    tangent, sine = off(1.0), off(0.0)
    assert tangent < 2e-3 and sine > 5 * tangent
