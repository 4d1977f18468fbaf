"""The object and the dark field of a frame."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.fit.model import Fineness
from lfcal.recalibrate._patterns import VoxelPatterns, every_voxel, patterns_at
from lfcal.recalibrate._scene import ObjectFrame, dark_fields, estimate_scene
from tests.recalibrate.common import beads, described, small_plan, the_window


def own_patterns() -> VoxelPatterns:
    plan = small_plan()
    own = the_window(plan).plan
    return patterns_at(described(plan), own, every_voxel(own), Fineness.coarse, 1)


def test_explains_light_and_dark_field_of_a_frame_without_noise() -> None:
    patterns = own_patterns()
    light = patterns.images(beads(small_plan(), 4)[None])[0]
    fields = dark_fields(light.shape)
    dark = np.array([10, 4, 6, 8], np.float32)
    electrons = 2000 * light / light.max() + np.einsum("d,dyx->yx", dark, fields)
    scene = estimate_scene(patterns, ObjectFrame(electrons, np.ones_like(electrons)), fields, 150)
    assert np.abs(scene.expected - electrons).sum() < 0.01 * electrons.sum()
    found = np.einsum("d,dyx->yx", scene.dark, fields)
    assert found == pytest.approx(np.einsum("d,dyx->yx", dark, fields), abs=2.0)
    assert scene.expected == pytest.approx(scene.light + found, rel=1e-5)


def test_pixels_that_are_not_valid_have_no_influence() -> None:
    patterns = own_patterns()
    rng = np.random.default_rng(5)
    electrons = rng.uniform(5, 100, patterns.shape).astype(np.float32)
    valid = (rng.random(patterns.shape) > 0.2).astype(np.float32)
    fields = dark_fields(patterns.shape)
    other = np.where(valid > 0, electrons, 1e6).astype(np.float32)
    first, second = (estimate_scene(patterns, ObjectFrame(own, valid), fields, 5) for own in (electrons, other))
    assert np.array_equal(first.volume, second.volume)


@pytest.mark.parametrize(("parts", "count"), [(1, 4), (2, 16), (8, 121)])
def test_dark_fields_are_positive_and_independent_and_contain_a_plane(parts: int, count: int) -> None:
    fields = dark_fields((40, 50), parts)
    assert fields.shape == (count, 40, 50) and fields.min() >= 0
    columns = fields.reshape(count, -1).T.astype(np.float64)
    assert np.linalg.matrix_rank(columns, tol=1e-3) == count
    y, x = np.mgrid[0:40, 0:50]
    plane = (3 + 0.1 * y - 0.2 * x).ravel()
    assert columns @ np.linalg.lstsq(columns, plane, rcond=None)[0] == pytest.approx(plane, abs=1e-4)


def test_a_dark_field_of_many_parts_contains_waves() -> None:
    y, x = np.mgrid[-1:1:105j, -1:1:114j]
    wave = np.sin(2 * np.pi * (x + 0.5 * y)).ravel()
    errors = []
    for parts in (1, 8):
        columns = dark_fields(x.shape, parts).reshape(-1, wave.size).T.astype(np.float64)
        errors.append(np.abs(columns @ np.linalg.lstsq(columns, wave, rcond=None)[0] - wave).max())
    assert errors[0] > 0.5 and errors[1] < 0.02
