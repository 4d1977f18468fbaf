"""Drifts in frames of a small sensor, by a finer sampling than the model's, and the test that finds them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache

import numpy as np
import pytest
from scipy import stats

from lfcal.base import InputError
from lfcal.base.notes import notes_to
from lfcal.camera import NoLatticeError, ScanPlan, preset
from lfcal.fit import NewFrame, Setup
from lfcal.fit.model import Fineness
from lfcal.fit.parameters import ScanScales, Vector
from lfcal.recalibrate import DriftWatch, watch
from lfcal.recalibrate._alarm import AlarmTest, MeasuredDrift, mean_drift, rejected
from lfcal.recalibrate._drift import DriftWindow
from lfcal.recalibrate._patterns import VoxelPatterns, every_voxel, patterns_at
from lfcal.recalibrate.watch import _trends
from lfcal.recalibrate.watched import WatchedFrame, WatchedMean
from tests.recalibrate.common import beads, shared_patterns, small_plan, the_window, true_setup

PLAN = small_plan((2.4,), 56)
SETUP = true_setup(PLAN)


@pytest.fixture(scope="module", autouse=True)
def _shared_patterns() -> Iterator[None]:
    with shared_patterns():
        yield


@cache
def drifted(x_px: float = 0.0, y_px: float = 0.0, gap_percent: float = 0.0, plan: ScanPlan = PLAN) -> VoxelPatterns:
    """Return H by the finest sampling, after a drift of the array."""
    own, setup = the_window(plan).plan, true_setup(plan)
    pixel, gap = setup.camera.sensor.pixel_um, setup.camera.lattice.gap_um
    vector = Vector(setup, ScanScales.of(own), ("geometry",))
    moved = {"offset_x_um": x_px * pixel, "offset_y_um": y_px * pixel, "gap_um": 0.01 * gap_percent * gap}
    return patterns_at(vector.setup_at(vector.at(moved)), own, every_voxel(own), Fineness.finest, 2)


def frame(patterns: VoxelPatterns, seed: int, peak: float = 3000.0, plan: ScanPlan = PLAN) -> NewFrame:
    rng = np.random.default_rng(seed)
    light = patterns.images(beads(plan, seed)[None])[0]
    electrons = rng.poisson(light * peak / light.max() + 20) + 3 * rng.standard_normal(light.shape)
    return NewFrame(electrons.astype(np.float32), noise=(9.0, 1.0), label=f"{seed}.tif")


def watched(frames: list[NewFrame], **options: object) -> DriftWatch:
    return watch(frames, SETUP, PLAN, workers=2, **options)


@cache
def quiet() -> tuple[NewFrame, ...]:
    return tuple(frame(drifted(), seed) for seed in range(16))


@pytest.mark.long
def test_h_holds_for_frames_of_other_objects() -> None:
    found = watched([frame(drifted(), 100 + k, (3000, 300)[k % 2]) for k in range(6)], quiet=quiet())
    assert found.holds and found.verdict.startswith("H is still valid: shift x")
    assert not any(one.alarm for one in found.means) and not found.noise_stated
    assert "16 quiet frames and an F distribution with 3 and 13 degrees of freedom" in found.basis
    pulls = np.array([one.values for one in found.frames]) / np.array([one.sigmas for one in found.frames])
    assert 0.4 < np.sqrt(np.mean(pulls**2)) < 1.5
    dim, bright = found.frames[1].sigmas, found.frames[0].sigmas
    assert dim[0] > 2 * bright[0]


def test_a_shift_is_found_and_dated() -> None:
    found = watched([frame(drifted(*([0.05] if k >= 3 else [])), 200 + k) for k in range(6)])
    assert found.holds is False and [one.alarm for one in found.means] == [False] * 3 + [True] * 3
    assert found.verdict.startswith("H is no longer valid: shift x +0.05") and "first in 203.tif" in found.verdict
    assert abs(found.values[0] - 0.05) < 3 * found.sigmas[0] < 0.025


@pytest.mark.long
def test_a_large_drift_is_measured_in_several_steps() -> None:
    drift = (0.5, -0.3, 1.0)
    found = watched([frame(drifted(*drift), 300)])
    assert found.holds is False and all(not one.problem for one in found.frames)
    assert found.values == pytest.approx(drift, abs=0.2)
    assert found.values[:2] == pytest.approx(drift[:2], abs=0.02)


@pytest.mark.long
def test_means_of_three_find_a_change_of_the_gap() -> None:
    frames = [frame(drifted(0.0, 0.0, 0.2), 400 + k) for k in range(7)]
    found = watched(frames, quiet=quiet(), mean=3)
    assert [len(one.frames) for one in found.means] == [3, 3, 1]
    assert found.holds is False and all(one.alarm for one in found.means[:2])
    assert found.values[2] == pytest.approx(0.2, abs=0.07)


def test_a_trend_has_the_unit_of_its_times() -> None:
    rng, begin = np.random.default_rng(0), datetime(2026, 5, 1, tzinfo=UTC)
    noise = np.diag([1e-6, 1e-6, 1e-4])
    drifts = [
        MeasuredDrift(np.array([0.02 * k, 0, 0]) + np.sqrt(np.diag(noise)) * rng.standard_normal(3), noise, np.zeros(3))
        for k in range(6)
    ]
    hourly = _trends(drifts, [begin + timedelta(hours=2 * k) for k in range(6)], range(6))
    daily = _trends(drifts, [begin + timedelta(days=k) for k in range(6)], range(6))
    plain = _trends(drifts, [begin] * 6, range(6))
    for found, slope, per in ((hourly, 0.01, "hour"), (daily, 0.02, "day"), (plain, 0.02, "frame")):
        assert found[0].per == per and found[0].significant and abs(found[0].slope - slope) < 4 * found[0].sigma
        assert not found[1].significant and not found[2].significant
    assert found[0].sigma == pytest.approx(1e-3 / np.sqrt(17.5), rel=1.2)
    assert _trends(drifts[:2], [None, None], range(2)) == ()
    # frames without a drift count as well
    few = _trends([*drifts[:2], *drifts[4:]], [None] * 4, [0, 1, 4, 5])
    assert few[0].per == "frame" and abs(few[0].slope - 0.02) < 4 * few[0].sigma


def test_frames_that_h_does_not_explain_are_no_evidence() -> None:
    good = frame(drifted(), 600)
    stripes = (good.values + 300 * (np.arange(56) % 2)).astype(np.float32)
    mixed = watched([replace(good, values=stripes), *(frame(drifted(), 601 + k) for k in range(3))])
    assert mixed.holds and len(mixed.means) == 3 and "does not explain it" in mixed.frames[0].problem
    alone = replace(mixed, frames=mixed.frames[:1])
    assert alone.holds is None and alone.verdict.startswith("undecided: H does not explain 1 of 1 frames")


@pytest.mark.long
def test_a_frame_that_cannot_be_used_does_not_end_the_series() -> None:
    dark = NewFrame(np.random.default_rng(0).normal(0, 3, (56, 56)).astype(np.float32), noise=(9.0, 1.0), label="dark")
    found = watched([dark, frame(drifted(), 610)])
    assert found.holds and "structure" in found.frames[0].problem and np.isnan(found.frames[0].values[0])
    with pytest.raises(InputError, match="structure that is larger than the noise"):
        watched([dark])


def test_frames_that_cannot_be_read_are_refused_before_h_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    class Damaged(list[NewFrame]):
        def __getitem__(self, _: object) -> NewFrame:
            raise InputError("cut.tif: damaged")

    monkeypatch.setattr(DriftWindow, "iter_prepared", lambda *_: pytest.fail("H is computed"))
    with pytest.raises(InputError, match=r"cut\.tif: damaged"):
        watched(Damaged([frame(drifted(), 0)]))


@pytest.mark.long
def test_saturated_pixels_are_left_out_and_named() -> None:
    clipped = replace(frame(drifted(0.05), 620), values=np.minimum(frame(drifted(0.05), 620).values, 900))
    notes: list[str] = []
    with notes_to(notes.append):
        found = watched([clipped])
    assert any("left out as saturated" in one for one in notes)
    assert found.values[0] == pytest.approx(0.05, abs=0.015)


def test_options_and_frames_that_cannot_be_used_are_refused() -> None:
    some, three = [frame(drifted(), 0)], [frame(drifted(), k) for k in range(3)]
    another = NewFrame(np.ones((80, 60), np.float32), noise=(9, 1), label="a.tif")
    for frames, options, message in (
        (some, {"quiet": three}, "quiet frames: expected at least 6, or none, got 3"),
        (some, {"rate": 0.7}, "rate of false alarms: expected"),
        (some, {"mean": 0}, "mean: expected"),
        ([another], {}, "size: expected 56 x 56 px, as in the camera, got 80 x 60 px"),
    ):
        with pytest.raises(InputError, match=message):
            watched(frames, **options)
    plan = ScanPlan.for_camera(preset("flfm_20x05"), depths_um=[0.0], cutout=21)
    with pytest.raises(NoLatticeError, match="watching frames"):
        watch(some, Setup(plan.camera, (), (0.0,)), plan)


@pytest.mark.long
def test_quiet_frames_that_h_does_not_explain_are_refused() -> None:
    with pytest.raises(InputError, match="at least 6 that H explains, got 0; frame: "):
        watched([frame(drifted(), 0)], quiet=[NewFrame(np.ones((50, 60), np.float32))] * 6)


def test_the_mean_of_all_frames_is_tested() -> None:
    one = WatchedMean(("a",), (0.0, 0.0, 0.1), (0.01, 0.01, 0.04), 9.0, 0.02, False)
    frames = (WatchedFrame("a", None), WatchedFrame("b", None))
    found = DriftWatch(frames, (), (one, one), (), True, (0.0, 0.0, 0.1), (0.01, 0.01, 0.03), (), 0.01, 11.3)
    assert found.verdict.startswith("H is no longer valid: gap +0.100 ± 0.030 % in the mean of 2 frames; recalibrate")


@pytest.mark.long
def test_depths_that_h_states_are_used() -> None:
    wrong = replace(PLAN, depths_um=tuple(z + 40.0 for z in PLAN.depths_um))
    setup = replace(SETUP, depth_errors_um=(-40.0,))
    some = [frame(drifted(), 1)]
    assert watch(some, setup, wrong).frames[0].values == pytest.approx(watched(some).frames[0].values, abs=1e-4)


FLOORS = np.array([0.0, 0.0, 0.02])


def drawn(rng: np.random.Generator, count: int, shift: tuple[float, ...] = (0, 0, 0)) -> list[MeasuredDrift]:
    """Return drifts with correlated noise of different size in each, twice as large as stated."""
    found = []
    for _ in range(count):
        a = rng.uniform(0.5, 3) * np.array([[2, 0, 0], [0.3, 2, 0], [0, 5, 20]]) * 1e-3
        values = np.array(shift) + 2 * a @ rng.standard_normal(3) + rng.normal(0, 2 * FLOORS)
        found.append(MeasuredDrift(values, a @ a.T, FLOORS))
    return found


@pytest.mark.long
def test_quiet_frames_give_alarms_at_the_stated_rate() -> None:
    for mean in (1, 3):
        rng, alarms = np.random.default_rng(0), 0
        for _ in range(60):
            test = AlarmTest(drawn(rng, 24), 0.05)
            alarms += sum(test.tested(drawn(rng, mean))[1] < 0.05 for _ in range(50))
        assert 0.03 < alarms / 3000 < 0.07, mean
    # without quiet frames, at the stated noise
    rng, test = np.random.default_rng(1), AlarmTest([], 0.05)
    found = [one._replace(values=one.values / 2) for one in drawn(rng, 3000)]
    alarms = sum(test.tested([one])[0] > test.threshold() for one in found)
    assert 0.035 < alarms / 3000 < 0.065


def scattered(rng: np.random.Generator, count: int, sigma: float, start: tuple[float, ...]) -> list[MeasuredDrift]:
    """Return drifts about ``start``, with errors as stated: ``sigma`` px, 20 ``sigma`` %, and those of the model."""
    noise, floors = np.array([1, 1, 20]) * sigma, np.array([0.001, 0.001, 0.02])
    return [
        MeasuredDrift(start + np.hypot(noise, floors) * rng.standard_normal(3), np.diag(noise**2), floors)
        for _ in range(count)
    ]


@pytest.mark.parametrize("sigma", [0.004, 0.01, 0.02])
def test_a_common_offset_gives_no_alarm_in_frames_of_another_brightness(sigma: float) -> None:
    """The offset of the quiet frames, relative to H, was compared in units of each frame's own sigma."""
    rng, start, alarms = np.random.default_rng(7), (0.05, -0.03, 0.4), 0
    for _ in range(400):
        test = AlarmTest(scattered(rng, 20, 0.01, start), 0.05)
        alarms += test.tested(scattered(rng, 1, sigma, start))[1] < 0.05
    assert 0.02 < alarms / 400 < 0.08


def test_stated_errors_include_that_of_the_quiet_mean() -> None:
    """The mean of many frames had a smaller stated error than the mean of few quiet frames that it is relative to."""
    rng, pulls = np.random.default_rng(8), []
    for _ in range(300):
        test = AlarmTest(scattered(rng, 6, 0.01, (0, 0, 0)), 0.01)
        found = mean_drift(scattered(rng, 60, 0.01, (0, 0, 0)))
        pulls.append((found.values - test.start) / test.errors(found))
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.2


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
