"""What is even along an axis is computed once for both sides of it, and is the same to the last bit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.simulate._symmetry import folded, is_mirror_symmetric, is_separable, mirrored_rows
from lfcal.simulate.engines._propagator import sensor_propagator
from lfcal.simulate.scene import PupilIris
from tests.simulate.scenes import camera_scene, microscope_scene


def test_places_of_an_axis_have_their_distances() -> None:
    for n in (2, 7, 8, 350):
        rows = np.arange(n, dtype=np.float64) - n // 2
        for axis in (np.fft.fftfreq(n, 0.37), -np.fft.fftfreq(n, 0.37) / 0.021, rows * 0.31 / -7.1, rows[:1]):
            distances, places = folded(axis)
            assert distances.size == axis.size // 2 + 1
            np.testing.assert_array_equal(distances[places], np.abs(axis))
    uneven = np.array([0.3, -1.0, 2.0])
    distances, places = folded(uneven)
    np.testing.assert_array_equal(distances[places], np.abs(uneven))
    assert distances.size == 3


@pytest.mark.parametrize("n", [64, 75])
def test_the_propagator_is_its_formula_at_every_frequency(n: int) -> None:
    f, lam, gap, (thick, index) = np.fft.fftfreq(n, 0.4), 0.55, 500.0, (100.0, 1.5)
    k2 = f[:, None] ** 2 + f[None, :] ** 2
    s = lam**2 * k2
    air = (gap - thick / index) / (1 + np.sqrt(np.maximum(1 - s, 0)))
    phase = -2 * np.pi * lam * k2 * (air + thick / (index + np.sqrt(np.maximum(index**2 - s, 0))))
    limit = 1 / (lam * math.sqrt((2 * gap * f[1]) ** 2 + 1))
    seen = (np.abs(f) < limit)[:, None] & (np.abs(f) < limit)[None, :] & (s < 1)
    step, separable = sensor_propagator(f, lam, gap, True, (thick, index))
    assert not separable and 0 < seen.sum() < seen.size
    np.testing.assert_array_equal(step, np.where(seen, np.exp(1j * phase), 0))


def test_a_regular_camera_is_alike_upside_down() -> None:
    rows = np.arange(-6, 7)
    irises = (PupilIris(9), PupilIris(0), PupilIris(9, 1.0, 0.1), PupilIris(stop=(0.3, 0.0, 0.8)))
    for scene in (*(camera_scene(iris=iris) for iris in irises), camera_scene(iris=irises[1], accept=(5.0, 0.0, 0.1))):
        assert is_mirror_symmetric(scene)
        # every row and its mirror image about the row of lenslets through the middle
        assert mirrored_rows(scene, rows).keys() >= {i for i in range(13) if rows[i] > 0}
    assert is_mirror_symmetric(microscope_scene()) and is_separable(microscope_scene())
    for change in (
        {"tilt": (1e-3, 0.0)},
        {"accept": (5.0, 0.0, 0.0)},
        {"exact_rays": True},
        {"defects": ((0, 0, 0.0),)},
    ):
        assert not is_separable(microscope_scene(**change))


@pytest.mark.parametrize("offset_px", [0.0, 0.5, 1.5])
def test_rows_are_paired_about_any_line_that_mirrors_the_array(offset_px: float) -> None:
    plain = camera_scene(iris=PupilIris(9))
    at = (0.0, offset_px * plain.pixel_um / plain.scale)
    scene = replace(plain, lattice=replace(plain.lattice, offset_um=at))
    rows = np.arange(-6, 7)
    # no other line of rows of lenslets lies so near that it mirrors a row of these onto another
    assert 2 * plain.lattice.row_step_um * plain.scale / plain.pixel_um > 24
    expected = {i: int(2 * offset_px - y) + 6 for i, y in enumerate(rows) if -6 <= 2 * offset_px - y < y}
    assert mirrored_rows(scene, rows) == expected


def test_what_differs_upside_down_is_not_mirrored() -> None:
    upright = {"iris": PupilIris(9)}
    for change in (
        upright | {"tilt": (0.01, 0.0)},
        upright | {"tilt": (0.0, 0.01)},
        upright | {"pixel_aspect": 1.01},
        upright | {"accept": (5.0, 0.02, 0.0)},
        upright | {"wavefront": ((2, -2, 0.1),)},
        upright | {"defects": ((1, 0, 0.0),)},
        {"iris": PupilIris(9, 0.0, 0.1)},
        {"iris": PupilIris(stop=(0.0, 0.3, 0.8))},
    ):
        scene = camera_scene(**change)
        assert not is_mirror_symmetric(scene) and mirrored_rows(scene, np.arange(-6, 7)) == {}, change
