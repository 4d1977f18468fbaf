"""The orthogonal score, compared with dense least squares over all unknowns."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.recalibrate._patterns import VoxelPatterns
from lfcal.recalibrate._scene import ObjectFrame, SceneEstimate
from lfcal.recalibrate.score import RIDGE, goodness, orthogonal, score_of


def problem(seed: int = 0, count: int = 12) -> tuple[VoxelPatterns, ObjectFrame, SceneEstimate, np.ndarray, np.ndarray]:
    """Return a small problem with random patterns, derivatives and dark fields."""
    rng = np.random.default_rng(seed)
    places = np.stack([np.zeros(count, int), rng.integers(0, 8, count), rng.integers(0, 8, count)], axis=1)
    patterns = VoxelPatterns(places, np.zeros((count, 2)), rng.random((count, 5, 5), np.float32), (12, 12), 1)
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
