"""The test of drifts: its rate of false alarms for drawn noise, and its threshold."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from lfcal.recalibrate._alarm import AlarmTest, MeasuredDrift, mean_drift, rejected

FLOORS = np.array([0.0, 0.0, 0.02])


def drawn(rng: np.random.Generator, count: int, shift: tuple[float, ...] = (0, 0, 0)) -> list[MeasuredDrift]:
    """Return drifts with correlated noise of different size in each, twice as large as stated."""
    found = []
    for _ in range(count):
        a = rng.uniform(0.5, 3) * np.array([[2, 0, 0], [0.3, 2, 0], [0, 5, 20]]) * 1e-3
        values = np.array(shift) + 2 * a @ rng.standard_normal(3) + rng.normal(0, 2 * FLOORS)
        found.append(MeasuredDrift(values, a @ a.T, FLOORS))
    return found


@pytest.mark.parametrize("mean", [1, 3])
def test_quiet_frames_give_alarms_at_the_stated_rate(mean: int) -> None:
    rng, alarms = np.random.default_rng(0), 0
    for _ in range(60):
        test = AlarmTest(drawn(rng, 24), 0.05)
        alarms += sum(test.tested(drawn(rng, mean))[1] < 0.05 for _ in range(50))
    assert 0.03 < alarms / 3000 < 0.07


def test_the_stated_noise_gives_alarms_at_the_stated_rate() -> None:
    rng, test = np.random.default_rng(1), AlarmTest([], 0.05)
    found = [one._replace(values=one.values / 2) for one in drawn(rng, 3000)]
    alarms = sum(test.tested([one])[0] > test.threshold() for one in found)
    assert 0.035 < alarms / 3000 < 0.065


def test_thresholds_are_those_of_the_distributions() -> None:
    calm = drawn(np.random.default_rng(2), 24)
    expected = 3 * 23 / 21 * stats.f.isf(0.01, 3, 21)
    assert AlarmTest(calm, 0.01).threshold() == pytest.approx(expected)
    assert AlarmTest([], 0.01).threshold() == pytest.approx(stats.chi2.isf(0.01, 3))
    square, chance = AlarmTest(calm, 0.01).tested(drawn(np.random.default_rng(3), 1, (0.05, 0, 0)))
    assert (square > expected) == (chance < 0.01)


def test_the_error_of_the_model_is_not_averaged_away() -> None:
    shifted = [MeasuredDrift(np.array([0, 0, 0.03]), np.diag([1e-6, 1e-6, 1e-4]), FLOORS)] * 400
    assert mean_drift(shifted).sigmas[2] == pytest.approx(0.02, rel=0.01)
    assert AlarmTest([], 0.01).tested(shifted)[1] > 0.1
    calm = drawn(np.random.default_rng(4), 30)
    every = [MeasuredDrift(np.array([0, 0, 0.03]), one.noise, FLOORS) for one in drawn(np.random.default_rng(5), 400)]
    test = AlarmTest(calm, 0.01)
    assert test.tested(every, floored=True)[0] < test.tested(every)[0]


def test_several_tests_together_keep_the_rate() -> None:
    rng = np.random.default_rng(6)
    series = rng.uniform(size=(4000, 20))
    assert np.mean([bool(rejected(one.tolist(), 0.05)) for one in series]) == pytest.approx(0.05, abs=0.012)
    assert rejected([0.9, 0.004, 0.5, 0.015], 0.01) == []
    assert rejected([0.9, 0.004, 0.5, 0.004], 0.01) == [1, 3]
    assert rejected([], 0.01) == []
