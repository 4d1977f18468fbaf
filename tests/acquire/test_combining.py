"""Averaging and bracketing against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.acquire._exposing import average, merge
from lfcal.base.errors import InputError

MAX, BLACK = 4095, 64


def exposures(light: np.ndarray, seconds: list[float], rng: np.random.Generator | None = None) -> list[np.ndarray]:
    """Frames of ``light`` (counts per second above black), quantised and clipped as a sensor does."""
    frames = []
    for t in seconds:
        counts = light * t if rng is None else rng.poisson(light * t)
        frames.append(np.clip(np.rint(counts + BLACK), 0, MAX).astype(np.uint16))
    return frames


def test_average_is_the_mean_and_a_pixel_saturated_once_counts_as_saturated() -> None:
    frames = [np.full((2, 3), 65535, np.uint16), np.full((2, 3), 65534, np.uint16)] * 50
    mean, saturated = average(frames, 65535)
    assert np.all(mean == 65534.5) and saturated.all(), "sums of 100 frames do not overflow"
    mean, saturated = average([np.array([[10, MAX]], np.uint16), np.array([[20, 100]], np.uint16)], MAX)
    assert saturated.tolist() == [[False, True]] and mean[0, 0] == 15


def test_a_bracket_restores_light_beyond_the_range_of_one_exposure_in_any_order() -> None:
    light = np.geomspace(1e3, 5e6, 400).reshape(20, 20)
    times = [0.02, 0.005, 0.0005]
    frames = exposures(light, times)
    counts, saturated = merge(frames, [f >= MAX for f in frames], times, reference_s=0.02, black_level=BLACK)
    assert not saturated.any()
    truth = light * 0.02 + BLACK
    step = 0.5 * 0.02 / 0.0005  # rounding of the shortest exposure, where only that one is left
    assert np.abs(counts - truth).max() <= step and counts.max() > 20 * MAX
    faint = frames[0] < MAX
    assert np.abs(counts - truth)[faint].max() <= 1.5
    back = frames[::-1]
    other, _ = merge(back, [f >= MAX for f in back], times[::-1], reference_s=0.02, black_level=BLACK)
    assert np.allclose(counts, other, rtol=1e-6)
    # saturated in all exposures: marked, and kept as a lower bound
    frames = [np.array([[MAX, 1000]], np.uint16), np.array([[MAX, 200]], np.uint16)]
    counts, saturated = merge(frames, [f >= MAX for f in frames], [0.02, 0.002], reference_s=0.02, black_level=BLACK)
    assert saturated.tolist() == [[True, False]]
    assert counts[0, 0] == pytest.approx((MAX - BLACK) * 10 + BLACK)


def test_bracket_weighs_like_one_long_exposure() -> None:
    """The variance is that of all photons together, the least that is possible."""
    rng = np.random.default_rng(1)
    light = np.full((300, 300), 3e4)
    times = [0.02, 0.01, 0.005]
    frames = exposures(light, times, rng)
    counts, _ = merge(frames, [f >= MAX for f in frames], times, reference_s=0.02, black_level=BLACK)
    best = light[0, 0] * sum(times) * (0.02 / sum(times)) ** 2
    assert counts.mean() == pytest.approx(light[0, 0] * 0.02 + BLACK, rel=1e-3)
    assert counts.var() == pytest.approx(best, rel=0.03)


def test_bad_brackets_are_refused() -> None:
    frame = np.zeros((2, 2), np.uint16)
    for frames, times in (([frame], [0.0]), ([frame, frame], [1.0])):
        with pytest.raises(InputError):
            merge(frames, [frame > 0], times, reference_s=1.0)
    for frames in ([frame, frame[:1]], []):
        with pytest.raises(InputError):
            average(frames, 10)
