"""Seconds, bytes and accuracy predicted from the description, compared with what engines compute."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from benchmarks._effect_scenes import random_plan
from benchmarks.forecast import RISE
from lfcal.camera import Camera, ScanPlan, preset
from lfcal.simulate import (
    AnyScene,
    Sampling,
    lattice_scene_for,
    outlook_of,
    plan_effects,
    resolve_level,
    scene_for,
    simulate_psf,
)
from lfcal.simulate import effects as fx
from lfcal.simulate.accuracy import Traits, _work, calibration, cost, probe, settle, step_for, steps_for
from lfcal.simulate.accuracy._work import LightSizes, engine_work
from lfcal.simulate.accuracy.cost import efficient_steps, engine_seconds
from lfcal.simulate.accuracy.sampling import comparison
from lfcal.simulate.engines import engine_for
from lfcal.simulate.engines._wave import WavePlane
from lfcal.simulate.engines.grid import GridPlane
from lfcal.simulate.engines.microscope import DebyePlane
from lfcal.simulate.scene import Scene
from lfcal.simulate.staging import wave_level
from tests.simulate.common import BASE, long, small_plan

TOLERANCES = (0.3, 0.1, 0.05, 0.03, 0.02, 0.01, 0.005, 0.003, 0.001)


@pytest.fixture
def same_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute with the speed of the machine on which the constants were measured; one plane corrects at once."""
    monkeypatch.setattr(calibration, "ASSUMED", 0)
    monkeypatch.setattr(calibration, "_timed_rate", lambda: _work.FITTED_RATE)
    monkeypatch.setattr(calibration, "_SPEED", None)


@pytest.mark.parametrize("level", ["geometric", "wave"])
def test_lenslets_that_miss_the_cutout_cost_nothing(level: str) -> None:
    """A shadow grows without end as the source goes away; those of its lenslets that are computed do not."""
    near, far, farther, wide = (
        engine_seconds(outlook_of(small_plan(v, cutout=cutout), 0), level, 0.03)
        for v, cutout in ((30.0, 49), (300.0, 49), (3000.0, 49), (300.0, 99))
    )
    assert far < 1.2 * near and farther < 1.2 * near and 1.5 * far < wide < 5 * far


@pytest.mark.usefixtures("same_machine")
def test_simulations_correct_the_forecast() -> None:
    """Of the engine that ran, and of no other; the sampling is chosen as before."""
    outlook, off = outlook_of(small_plan(3.0, cutout=121), 0), 3.0
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
    before, exact = engine_seconds(outlook, "debye"), Traits(separable=False, exact=True)
    on_grid = engine_seconds(outlook, "debye", 0.03, exact)
    cost.correct_rate(outlook, "grid", 0.03, 1, 3 * on_grid, exact)
    assert engine_seconds(outlook, "debye") == before
    assert engine_seconds(outlook, "debye", 0.03, exact) == pytest.approx(3 * on_grid)
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


def described(plan: ScanPlan) -> tuple[AnyScene | fx.Outlook, ...]:
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


def test_costs_decide(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a transform that takes 100 times as long, windows are the faster ones of the same scene."""
    scene, outlook = described(bench_plan())
    monkeypatch.setattr(_work, "PER_SAMPLE", 100 * _work.PER_SAMPLE)
    monkeypatch.setattr(cost, "RISK", math.inf)
    for one in (scene, outlook):
        assert [step_for(one, "wave", t).level for t in (0.1, 0.05, 0.01)] == ["wave", "wave", "grid"]
        # nothing that keeps the smallest tolerance is lost
        assert efficient_steps(one, "wave")[-1] == steps_for(one, "wave")[-1]


@pytest.mark.usefixtures("same_machine")
@pytest.mark.parametrize("number", range(40))
@pytest.mark.few(3)
def test_costs_do_not_rise_with_the_tolerance(number: int) -> None:
    """Random cameras, by the forecast: for the sampling alone, and together with the effects of each tolerance."""
    plan, _ = random_plan(number)
    level = wave_level(plan.camera)
    for one in (lattice_scene_for(plan, 0, ()), outlook_of(plan, 0)):
        steps = steps_for(one, level)
        costs = [cost._plane_seconds(one, steps, step, None) for step in efficient_steps(one, level)]
        assert costs == sorted(costs)
    seconds = [plan_effects(plan, tolerance).seconds for tolerance in TOLERANCES]
    assert all(loose <= 1.01 * tight for loose, tight in pairwise(seconds)), seconds


CAMERAS = ((preset("bench"), 4.0), (preset("bench"), 0.5), (preset("r29"), 2.0))


def traits_of(plan: ScanPlan, *effects: fx.SceneEffect) -> Traits:
    return Traits.of(lattice_scene_for(plan, 0, effects))


def test_effects_that_change_the_work_of_engines_say_so() -> None:
    """Only their code runs to forecast the time without them."""
    plans = [ScanPlan.for_camera(camera, virtual_depths=[v]) for camera, v in CAMERAS]
    plans.append(ScanPlan.for_camera(preset("lfm_20x05"), depths_um=[5.0]))
    changing = {
        effect.name
        for plan in plans
        for effect in fx.catalogue()
        if isinstance(effect, fx.SceneEffect) and traits_of(plan, effect) != traits_of(plan)
    }
    stated = {effect.name for effect in fx.catalogue() if isinstance(effect, fx.SceneEffect) and effect.changes_work}
    assert "exact_angles" in changing and changing <= stated


@pytest.mark.parametrize("depth_um", [0.0, 12.0])
def test_responses_of_the_debye_path_are_counted(depth_um: float) -> None:
    """By the responses that the engine computes for a period."""
    plan = ScanPlan.for_camera(preset("lfm_20x05"), depths_um=[depth_um], cutout=31)
    scene = lattice_scene_for(plan, 0, (fx.LensletDiffraction(),))
    engine = engine_for(scene, "debye", Sampling(nodes_per_px=1))
    ny, nx = plan.period
    engine.rows(range(ny), range(nx), workers=1)
    assert isinstance(engine, DebyePlane)
    assert len(engine._responses) == pytest.approx(traits_of(plan, fx.LensletDiffraction()).responses * ny * nx)


def test_mirrored_rows_are_not_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the positions that the engine computes for a period."""
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0], cutout=21)
    computed = []
    respond = WavePlane._respond
    monkeypatch.setattr(
        WavePlane, "_respond", lambda self, *args: (computed.append(len(args[0])), respond(self, *args))
    )
    for effects in (BASE, (*BASE, fx.Telecentricity()), (*BASE, fx.Telecentricity(), fx.ArrayRotation(0.01))):
        computed.clear()
        scene = lattice_scene_for(plan, 0, effects)
        engine_for(scene, "wave", Sampling(nodes_per_px=2, margin_px=1)).rows(*map(range, plan.period), workers=1)
        assert sum(computed) == pytest.approx(Traits.of(scene).rows * math.prod(plan.period))


@pytest.mark.parametrize(("camera", "v"), [*CAMERAS[::2], (preset("r29"), -4.0)])
@pytest.mark.parametrize("cutout", [31, long(91)])
def test_lenslets_of_a_position_are_counted(camera: Camera, v: float, cutout: int) -> None:
    """By the lenslets that the engine computes for a row of positions."""
    plan = ScanPlan.for_camera(camera, virtual_depths=[v], cutout=cutout)
    scene = lattice_scene_for(plan, 0, BASE)
    step = next(step for step in steps_for(scene, "wave") if step.level == "wave")
    engine = engine_for(scene, "wave", step.sampling)
    engine.rows([0], range(plan.period[1]), workers=1)
    counted = engine.certificate.responses / plan.period[1]
    light = LightSizes.of(scene)
    half = max(math.ceil(spot + step.sampling.margin_px) for spot in light.spots_px)
    assert light.lenslets(half, step.sampling.energy_floor) == pytest.approx(counted, rel=0.4, abs=1.5)


@pytest.mark.parametrize(("camera", "v"), CAMERAS)
def test_the_time_of_a_grid_follows_its_transforms(camera: Camera, v: float) -> None:
    """By n² log n of the grids that the engine makes."""
    plan = ScanPlan.for_camera(camera, virtual_depths=[v], cutout=31)
    scene = lattice_scene_for(plan, 0, BASE)
    grids = [step for step in steps_for(scene, "grid") if step.level == "grid"][:3]
    sides = [engine_for(scene, "grid", step.sampling).grid_side for step in grids]
    for one, other, n, m in zip(grids, grids[1:], sides, sides[1:], strict=False):
        transforms = m**2 * math.log(m) / (n**2 * math.log(n))
        forecast = engine_work(scene, other).each / engine_work(scene, one).each
        assert transforms**0.6 < forecast < 1.7 * transforms, "positions of small grids have fixed costs too"


def microscope_plan(z_um: float) -> ScanPlan:
    """Return a plane of a small cutout that exact angles bring onto a grid."""
    return ScanPlan.for_camera(preset("lfm_20x05"), depths_um=[z_um], cutout=31)


@pytest.mark.parametrize("plan", [microscope_plan(5.0), ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0])])
def test_the_table_of_a_cell_has_the_size_of_the_forecast(plan: ScanPlan) -> None:
    """With a small cutout, it takes most of the time of a grid's tables: forecasts were up to 5 times too short."""
    scene = replace(lattice_scene_for(plan, 0, effects_named("lenslet_diffraction", "exact_angles")), aperture="cell")
    for step in steps_for(scene, "grid")[:2]:
        engine = engine_for(scene, "grid", step.sampling)
        assert isinstance(engine, GridPlane)
        (real, _), *_ = engine._apertures
        assert LightSizes.of(scene).cell_table_side(engine.per_px) == pytest.approx(len(real.cell), rel=0.02)


@pytest.mark.parametrize("z_um", [0.0, long(60.0)])
def test_a_grid_of_a_dim_cutout_is_as_forecast(z_um: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """With 6 % of the light in the cutout, a first grid failed, whose time was not forecast."""
    scene, level = resolve_level(
        lattice_scene_for(microscope_plan(z_um), 0, effects_named("lenslet_diffraction", "exact_angles"))
    )
    tried: list[Sampling] = []
    balanced = probe.balanced

    def noted(scene: Scene, level: str, sampling: Sampling) -> Any:
        tried.append(sampling)
        return balanced(scene, level, sampling)

    monkeypatch.setattr(probe, "balanced", noted)
    forecast = step_for(scene, level, 0.004)
    found = settle(scene, level, 0.004)
    assert found.sampling == forecast.sampling and found.error <= 0.004
    finer = comparison(steps_for(scene, level), forecast)
    assert tried == [forecast.sampling] + ([finer[0].sampling] if finer else [])


def effects_named(*names: str) -> list[fx.Effect]:
    return [effect for effect in fx.catalogue() if effect.name in names]


@pytest.mark.usefixtures("same_machine")
def test_fringes_of_the_iris_are_forecast_once() -> None:
    """The engine tabulates the field with fringes in the same time; forecasts were up to twice too long."""
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0], cutout=21)
    off, on = (plan_effects(plan, 0.03, {"iris_diffraction": setting}) for setting in ("off", "on"))
    row = on.row("iris_diffraction")
    assert on.seconds == pytest.approx(off.seconds) and row.seconds_with == row.seconds_without


def test_exact_angles_of_a_microscope_are_forecast_on_the_grid() -> None:
    """They took up to 40 times as long as the forecast of the Debye path."""
    plan = ScanPlan.for_camera(preset("lfm_20x05"), depths_um=[5.0], cutout=61)
    off, on = (plan_effects(plan, 0.03, {"exact_angles": setting}) for setting in ("off", "on"))
    assert on.seconds > 4 * off.seconds and on.row("exact_angles").seconds > 3 * off.seconds
    used = {
        effects: settle(resolve_level(lattice_scene_for(plan, 0, effects.effects))[0], "debye", 0.03).level
        for effects in (off, on)
    }
    assert list(used.values()) == ["debye", "grid"]


def test_a_sampling_whose_failure_costs_much_is_tried_with_a_reserve() -> None:
    """A failed first sampling made coarse tolerances up to 1.3 times slower than finer ones."""
    names = ("lenslet_diffraction", "iris_diffraction", "iris_shape", "telecentricity", "exact_angles")
    scene = lattice_scene_for(random_plan(2036)[0], 0, effects_named(*names))
    first, plain = efficient_steps(scene, "wave")[0], steps_for(scene, "wave")[0]
    assert first.sampling == plain.sampling and 1.1 < first.expected / plain.expected <= cost.WARY
    assert settle(scene, "wave", 1.01 * plain.expected).sampling != plain.sampling


@pytest.mark.parametrize("number", range(12))
@pytest.mark.few(2)
def test_the_work_of_a_plane_does_not_rise_with_the_tolerance(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Random cameras, by the samples of all Fourier transforms of the grids that a plane and its probe compute."""
    plan, _ = random_plan(number)
    plan = replace(plan, cutout=(21, 21), period=(min(plan.period[0], 8), min(plan.period[1], 8)))
    work = 0.0
    respond = GridPlane._respond

    def counted(self: GridPlane, sources: Sequence[Any], *others: Any) -> None:
        nonlocal work
        work += len(sources) * self.grid_side**2
        respond(self, sources, *others)

    monkeypatch.setattr(GridPlane, "_respond", counted)
    found = []
    for tolerance in (0.1, 0.03, 0.01):
        chosen = plan_effects(plan, tolerance, {"bandwidth": "off"})  # it may measure effects
        work = 0.0
        simulate_psf(plan, chosen, tolerance=tolerance, workers=1)
        found.append(work)
    assert all(loose <= RISE * tight for loose, tight in pairwise(found)), found
