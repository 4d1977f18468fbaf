"""Seconds predicted from the description."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from benchmarks._effect_scenes import random_plan
from lfcal.camera import ScanPlan, preset
from lfcal.simulate import plan_effects, simulate_psf
from lfcal.simulate._pupil_scene import AnyScene
from lfcal.simulate.accuracy import calibration, cost
from lfcal.simulate.accuracy.cost import efficient_steps, engine_seconds, step_for
from lfcal.simulate.accuracy.probe import settle
from lfcal.simulate.accuracy.sampling import steps_for
from lfcal.simulate.effects import Outlook
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.staging import lattice_scene_for, outlook_of, resolve_level, scene_for, wave_level
from tests.simulate.common import BASE, small_plan

TOLERANCES = (0.3, 0.1, 0.05, 0.03, 0.02, 0.01, 0.005, 0.003, 0.001)


@pytest.mark.parametrize("level", ["geometric", "wave"])
def test_lenslets_that_miss_the_cutout_cost_nothing(level: str) -> None:
    """A shadow grows without end as the source goes away; those of its lenslets that are computed do not."""
    near, far, farther = (
        engine_seconds(outlook_of(small_plan(v, cutout=49), 0), level, 0.03) for v in (30.0, 300.0, 3000.0)
    )
    assert far < 1.2 * near and farther < 1.2 * near
    wide = engine_seconds(outlook_of(small_plan(300.0, cutout=99), 0), level, 0.03)
    assert 1.5 * far < wide < 5 * far


@pytest.fixture
def same_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute with the speed of the machine on which the constants were measured, and without corrections."""
    monkeypatch.setattr(calibration, "_timed_rate", lambda: cost.FITTED_RATE)
    monkeypatch.setattr(calibration, "_SPEED", None)


@pytest.mark.usefixtures("same_machine")
@pytest.mark.parametrize("off", [3.0, 1 / 3])
def test_simulations_correct_the_forecast(off: float) -> None:
    """Of the engine that ran, and of no other; the sampling is chosen as before."""
    outlook = outlook_of(small_plan(3.0, cutout=121), 0)
    before = {level: engine_seconds(outlook, level) for level in ("geometric", "wave", "reference")}
    chosen = step_for(outlook, "wave", 0.03)
    for _ in range(3):
        cost.correct_rate(outlook, "grid", 0.03, 2, off * 2 * before["wave"])
    after = {level: engine_seconds(outlook, level) for level in before}
    assert after == pytest.approx(before | {"wave": off * before["wave"]})
    assert step_for(outlook, "wave", 0.03) == chosen


@pytest.mark.usefixtures("same_machine")
def test_a_grid_does_not_correct_the_forecast_of_the_debye_path() -> None:
    """With exact angles, a microscope runs on a grid, up to 40 times slower: forecasts became 5 times too long."""
    outlook = outlook_of(ScanPlan.for_camera(preset("lfm_20x05"), depths_um=[5.0], cutout=121), 0)
    before = engine_seconds(outlook, "debye")
    cost.correct_rate(outlook, "grid", 0.03, 1, 40 * before)
    assert engine_seconds(outlook, "debye") == before
    cost.correct_rate(outlook, "debye", 0.03, 10, 20 * before)
    assert engine_seconds(outlook, "debye") == pytest.approx(2 * before)


@pytest.mark.usefixtures("same_machine")
def test_a_plane_corrects_the_forecast_unless_its_sampling_was_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost, "LEAST_RUN_S", 0.0)
    plan = replace(small_plan(3.0, cutout=21), period=(2, 2))
    simulate_psf(plan, (), "wave", sampling=Sampling(nodes_per_px=2), workers=1)
    assert calibration.machine_speed().planes("wave") == 0
    simulate_psf(plan, (), "wave", workers=1)
    assert calibration.machine_speed().planes("wave") == 1


def bench_plan() -> ScanPlan:
    """Return a plane of the bench camera for which one grid is faster than windows behind all its lenslets."""
    return ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0], cutout=49)


def described(plan: ScanPlan) -> tuple[AnyScene | Outlook, ...]:
    """Return a plane's scene and the outlook on it."""
    return resolve_level(scene_for(plan, 0, BASE))[0], outlook_of(plan, 0)


def test_a_sampling_that_is_slower_than_a_finer_one_is_not_used() -> None:
    """Tolerances of 4 to 30 % took up to three times as long as 2 %, with windows instead of the grid."""
    for one in described(bench_plan()):
        assert {step.level for step in steps_for(one, "wave")} == {"wave", "grid"}
        assert {step.level for step in efficient_steps(one, "wave")} == {"grid"}
    scene, _ = resolve_level(scene_for(bench_plan(), 0, BASE))
    found = settle(scene, "wave", 0.1)
    assert found.level == "grid" and found.error < 0.02


def test_windows_of_a_long_row_share_their_masks() -> None:
    """At 2 %, a row of 95 positions takes 193 µs per position with windows and 361 µs on the grid."""
    plan = ScanPlan.for_camera(preset("r29"), virtual_depths=[4.0], cutout=61)
    short = replace(plan, period=(plan.period[0], 12))
    for one, level in ((plan, "wave"), (short, "grid")):
        assert step_for(outlook_of(one, 0), "wave", 0.025).level == level


def test_costs_decide(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a transform that takes 100 times as long, windows are the faster ones of the same scene."""
    scene, outlook = described(bench_plan())
    monkeypatch.setattr(cost, "PER_SAMPLE", 100 * cost.PER_SAMPLE)
    for one in (scene, outlook):
        assert [step_for(one, "wave", t).level for t in (0.1, 0.05, 0.01)] == ["wave", "wave", "grid"]
        # nothing that keeps the smallest tolerance is lost
        assert efficient_steps(one, "wave")[-1] == steps_for(one, "wave")[-1]


@pytest.mark.usefixtures("same_machine")
@pytest.mark.parametrize("number", range(40))
@pytest.mark.few(8)
def test_costs_do_not_rise_with_the_tolerance(number: int) -> None:
    """Random cameras, by the forecast: for the sampling alone, and together with the effects of each tolerance."""
    plan, _ = random_plan(number)
    level = wave_level(plan.camera)
    for one in (lattice_scene_for(plan, 0, ()), outlook_of(plan, 0)):
        times = [cost._step_seconds(one, step) for step in efficient_steps(one, level)]
        costs = [tables + (math.prod(one.period) + cost.PROBED) * each for tables, each in times]
        assert costs == sorted(costs)
    seconds = [plan_effects(plan, tolerance).seconds for tolerance in TOLERANCES]
    assert all(loose <= 1.01 * tight for loose, tight in pairwise(seconds)), seconds
