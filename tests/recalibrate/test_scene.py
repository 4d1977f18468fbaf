"""The object and the dark field of a window: patterns, margins, the orthogonal score and what frames determine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.fit.model import Fineness, predict
from lfcal.recalibrate._modes import Modes
from lfcal.recalibrate._patterns import VoxelPatterns, every_voxel, patterns_at
from lfcal.recalibrate._scene import ObjectFrame, SceneEstimate, dark_fields, estimate_scene
from lfcal.recalibrate._window import SIDE, windows_of
from lfcal.recalibrate.score import RIDGE, goodness, orthogonal, score_and_goodness, score_of
from tests.recalibrate.common import beads, described, small_plan, the_window, true_patterns


def test_a_small_sensor_is_one_window_with_all_pixels() -> None:
    (window,) = windows_of(small_plan(side=60))
    assert window.shape == (60, 60) and window.origin == (0, 0)
    assert window.plan.period == (40, 40)


def test_a_large_sensor_has_windows_in_the_middle_and_near_the_corners() -> None:
    plan = small_plan(side=900)
    found = windows_of(plan)
    assert len(found) == 5
    assert all(window.shape == (SIDE + 40, SIDE + 40) for window in found)
    ends = [np.add(window.origin, window.shape) for window in found]
    assert min(min(window.origin) for window in found) >= 0 and max(int(end.max()) for end in ends) <= 900
    middle = np.add(found[0].origin, np.array(found[0].shape) / 2)
    assert middle == pytest.approx([450, 450], abs=1)
    assert len(windows_of(plan, 2)) == 2


def test_a_side_with_light_at_its_edge_has_a_margin() -> None:
    (window,) = windows_of(small_plan(side=100))
    light = np.full(window.shape, 10, np.float32)
    light[40:60, 40:60] = 1000
    valid = np.ones_like(light)
    assert np.array_equal(window.trusted(light, valid), valid)
    light[:, -2:] = 500
    found = window.trusted(light, valid)
    assert found[:, -20:].max() == 0 and found[:, :-20].min() == 1
    # of a mosaic, other colours are 0 and not valid
    colour = np.zeros_like(light)
    colour[1::2, ::2] = 1
    assert np.array_equal(window.trusted(light * colour, colour), found * colour)
    light[:, -2:] = 25
    assert np.array_equal(window.trusted(light * colour, colour), colour)


def test_a_window_too_small_for_margins_has_none() -> None:
    (window,) = windows_of(small_plan(side=60))
    light = np.random.default_rng(0).uniform(0, 100, window.shape).astype(np.float32)
    assert window.trusted(light, np.ones_like(light)).min() == 1


def test_sums_are_the_transpose_of_images() -> None:
    rng = np.random.default_rng(0)
    values, places = rng.random((30, 5, 7), np.float32), rng.integers(0, 9, (30, 3))
    volume, images = rng.random((4, 30), np.float32), rng.random((4, 13, 15), np.float32)
    plain = np.zeros((4, 13, 15))
    for weight, (_, y, x), value in zip(volume.T, places, values, strict=True):
        plain[:, y : y + 5, x : x + 7] += weight[:, None, None] * value
    for workers in (1, 3):
        patterns = VoxelPatterns(places, np.zeros((30, 2)), values, np.arange(30), (9 + 4, 9 + 6), workers)
        found = patterns.images(volume)
        assert np.vdot(found, images) == pytest.approx(np.vdot(volume, patterns.sums(images)), rel=1e-5)
        assert found == pytest.approx(plain, rel=1e-5)


def test_results_do_not_depend_on_the_workers() -> None:
    patterns = true_patterns(small_plan())
    volume = np.random.default_rng(1).random((1, len(patterns)), np.float32)
    alone = replace(patterns, workers=3)
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


def test_dark_fields_are_positive_and_independent_and_contain_planes_and_waves() -> None:
    y, x = np.mgrid[0:40, 0:50]
    plane = (3 + 0.1 * y - 0.2 * x).ravel()
    for parts, count in ((1, 4), (2, 16), (8, 121)):
        fields = dark_fields((40, 50), parts)
        assert fields.shape == (count, 40, 50) and fields.min() >= 0
        columns = fields.reshape(count, -1).T.astype(np.float64)
        assert np.linalg.matrix_rank(columns, tol=1e-3) == count
        assert columns @ np.linalg.lstsq(columns, plane, rcond=None)[0] == pytest.approx(plane, abs=1e-4)
    y, x = np.mgrid[-1:1:105j, -1:1:114j]
    wave = np.sin(2 * np.pi * (x + 0.5 * y)).ravel()
    errors = []
    for parts in (1, 8):
        columns = dark_fields(x.shape, parts).reshape(-1, wave.size).T.astype(np.float64)
        errors.append(np.abs(columns @ np.linalg.lstsq(columns, wave, rcond=None)[0] - wave).max())
    assert errors[0] > 0.5 and errors[1] < 0.02


def problem(seed: int = 0, count: int = 12) -> tuple[VoxelPatterns, ObjectFrame, SceneEstimate, np.ndarray, np.ndarray]:
    """Return a small problem with random patterns, derivatives and dark fields."""
    rng = np.random.default_rng(seed)
    places = np.stack([np.zeros(count, int), rng.integers(0, 8, count), rng.integers(0, 8, count)], axis=1)
    patterns = VoxelPatterns(
        places, np.zeros((count, 2)), rng.random((count, 5, 5), np.float32), np.arange(count), (12, 12), 1
    )
    volume = rng.uniform(50, 100, count).astype(np.float32)
    light = patterns.images(volume[None])[0]
    expected = light + np.float32(30)
    scene = SceneEstimate(volume, np.array([30], np.float32), light, expected)
    valid = (rng.random((12, 12)) > 0.1).astype(np.float32)
    frame = ObjectFrame(rng.poisson(expected).astype(np.float32), valid, 2.0, 0.01)
    return patterns, frame, scene, rng.standard_normal((3, 12, 12)).astype(np.float32), np.ones((1, 12, 12), np.float32)


def columns(patterns: VoxelPatterns, volume: np.ndarray) -> np.ndarray:
    """Return the image of a change of each voxel by its square root, as columns."""
    return patterns.images(np.diag(np.sqrt(volume)).astype(np.float32)).reshape(len(volume), -1).T.astype(np.float64)


def test_projected_images_cannot_be_produced_by_the_volume() -> None:
    patterns, frame, scene, images, _ = problem()
    weight = frame.inverse_variance(scene.expected)
    free = orthogonal(patterns, scene.volume, weight, images, steps=200)
    left = patterns.sums(weight * free) * np.sqrt(scene.volume)
    whole = patterns.sums(weight * images) * np.sqrt(scene.volume)
    assert np.abs(left).max() < 0.05 * np.abs(whole).max()


def test_score_is_that_of_least_squares_with_all_voxels() -> None:
    patterns, frame, scene, derivatives, fields = problem()
    w = frame.inverse_variance(scene.expected).ravel().astype(np.float64)
    tangent = columns(patterns, scene.volume)
    normal = tangent.T @ (w[:, None] * tangent)
    ridge = RIDGE * (normal @ np.ones(len(normal))).max() * np.eye(len(normal))
    J = np.concatenate([derivatives, fields]).reshape(4, -1).astype(np.float64)
    free = J - (J * w) @ tangent @ np.linalg.inv(normal + ridge) @ tangent.T
    matrix, slope = (free * w) @ free.T, (free * w) @ (frame.electrons - scene.expected).ravel()
    gain = matrix[:3, 3:] / matrix[3, 3]
    found = score_of(patterns, frame, scene, derivatives, fields)
    assert found.information == pytest.approx(matrix[:3, :3] - gain @ matrix[3:, :3], rel=2e-3)
    assert found.gradient == pytest.approx(slope[:3] - gain @ slope[3:], rel=2e-3, abs=1e-3)


def test_score_is_blind_to_an_error_of_the_volume() -> None:
    patterns, frame, scene, derivatives, fields = problem()
    wrong = patterns.images((np.sqrt(scene.volume) * np.float32(0.5))[None])[0]
    moved = ObjectFrame(scene.expected + wrong, frame.valid, 2.0, 0.01)
    weight = frame.inverse_variance(scene.expected)
    plain = (derivatives * weight * wrong).sum((1, 2))
    found = score_of(patterns, moved, scene, derivatives, fields)
    assert np.abs(found.gradient).max() < 0.05 * np.abs(plain).max()


def test_a_window_without_signal_has_no_information() -> None:
    """A window whose values are all at most zero was an error that ended the whole series."""
    patterns = true_patterns(small_plan())
    frame = ObjectFrame(np.full(patterns.shape, -1, np.float32), np.ones(patterns.shape, np.float32), 3.0)
    fields = dark_fields(patterns.shape)
    scene = estimate_scene(patterns, frame, fields, 5)
    assert scene.volume.max() == 0
    score, good = score_and_goodness(patterns, frame, scene, patterns.images(scene.volume[None]), fields)
    assert not score.information.any() and not score.gradient.any() and np.isfinite(good.ratio)


def test_goodness_is_one_for_noise_and_more_for_other_light() -> None:
    patterns, frame, scene, _, fields = problem()
    ratios = []
    for seed in range(40):
        sigma = 1 / np.sqrt(frame.inverse_variance(scene.expected) + 1e-9)
        noise = frame.valid * sigma * np.random.default_rng(seed).standard_normal((12, 12))
        own = ObjectFrame((scene.expected + noise).astype(np.float32), frame.valid, 2.0, 0.01)
        found = goodness(patterns, own, scene, fields)
        ratios.append(found.ratio)
    assert np.mean(ratios) == pytest.approx(1, abs=0.1)
    # the voxels and the dark field take up as many degrees of freedom
    assert found.freedom == pytest.approx(frame.valid.sum() - len(patterns) - 1, abs=25)
    brighter = ObjectFrame(frame.electrons * 2, frame.valid, 2.0, 0.01)
    assert goodness(patterns, brighter, scene, fields).ratio > 2


NAMES = ("gap", "focal", "offset")
PRECISION = np.array([4.0, 4.0, 1.0])
BOTH = np.array([1, 1, 0]) / np.sqrt(2)
OTHER = np.array([1, -1, 0]) / np.sqrt(2)
INFORMATION = 400 * np.outer(OTHER, OTHER) + 4 * 1.5 * np.outer(BOTH, BOTH) + np.diag([0, 0, 99.0])


def test_a_common_change_that_is_not_determined_is_named_and_not_followed() -> None:
    modes = Modes.of(INFORMATION, PRECISION)
    assert modes.undetermined(NAMES) == (("gap", "focal"),)
    found = modes.estimate(INFORMATION @ np.array([3.0, 1.0, 2.0]))
    assert found == pytest.approx(OTHER * (OTHER @ [3, 1, 2]) * 400 / 404 + np.array([0, 0, 2 * 0.99]))
    assert modes.covariance @ BOTH == pytest.approx(BOTH / 4)  # that of the prior
    assert modes.covariance @ OTHER == pytest.approx(OTHER / 404)


def test_determined_unknowns_are_those_of_least_squares_with_a_prior() -> None:
    information = INFORMATION + 40 * np.outer(BOTH, BOTH)
    modes = Modes.of(information, PRECISION)
    assert modes.undetermined(NAMES) == ()
    whole = np.linalg.inv(information + np.diag(PRECISION))
    assert modes.covariance == pytest.approx(whole)
    assert modes.estimate(np.array([1.0, 2.0, 3.0])) == pytest.approx(whole @ [1, 2, 3])


def test_an_unknown_without_any_information_stays() -> None:
    modes = Modes.of(np.diag([50.0, 0.0, 50.0]), PRECISION)
    assert modes.undetermined(NAMES) == (("focal",),)
    assert modes.estimate(np.array([1.0, 1.0, 1.0]))[1] == 0
