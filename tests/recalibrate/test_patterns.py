"""H over a window: sums over patterns and their transpose, and equality with single predictions."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.fit.model import Fineness, predict
from lfcal.recalibrate._patterns import VoxelPatterns, every_voxel, patterns_at
from tests.recalibrate.common import described, small_plan, the_window, true_patterns


@pytest.mark.parametrize("workers", [1, 3])
def test_sums_are_the_transpose_of_images(workers: int) -> None:
    rng = np.random.default_rng(0)
    values = rng.random((30, 5, 7), np.float32)
    places = rng.integers(0, 9, (30, 3))
    patterns = VoxelPatterns(places, np.zeros((30, 2)), values, (9 + 4, 9 + 6), workers)
    volume = rng.random((4, 30), np.float32)
    images = rng.random((4, 13, 15), np.float32)
    assert np.vdot(patterns.images(volume), images) == pytest.approx(np.vdot(volume, patterns.sums(images)), rel=1e-5)
    plain = np.zeros((4, 13, 15))
    for weight, (_, y, x), value in zip(volume.T, places, values, strict=True):
        plain[:, y : y + 5, x : x + 7] += weight[:, None, None] * value
    assert patterns.images(volume) == pytest.approx(plain, rel=1e-5)


def test_results_do_not_depend_on_the_workers() -> None:
    patterns = true_patterns(small_plan())
    volume = np.random.default_rng(1).random((1, len(patterns)), np.float32)
    alone = VoxelPatterns(patterns.places, patterns.offsets_px, patterns.values, patterns.shape, 3)
    assert np.array_equal(patterns.images(volume), alone.images(volume))


def test_patterns_are_those_of_single_positions() -> None:
    plan = small_plan()
    own, setup = the_window(plan).plan, described(plan)
    places, offsets = every_voxel(own, halves=True)
    some = np.random.default_rng(2).choice(len(places), 40, replace=False)
    made = patterns_at(setup, own, (places[some], offsets[some]), Fineness.coarse, 2)
    for place, offset, value in zip(made.places, made.offsets_px, made.values, strict=True):
        (one,) = predict(setup, own, place[None], offset[None], Fineness.coarse)
        assert value == pytest.approx(one, abs=1e-6 * float(one.max()))


def test_halves_are_four_voxels_about_each_position() -> None:
    places, offsets = every_voxel(the_window(small_plan()).plan, halves=True)
    assert len(places) == 4 * len(np.unique(places, axis=0))
    assert offsets[:4].tolist() == [[-0.25, -0.25], [-0.25, 0.25], [0.25, -0.25], [0.25, 0.25]]
    assert offsets.mean(0).tolist() == [0, 0]
