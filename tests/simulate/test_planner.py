"""The plan of effects: decisions, reasons, cost, and the tolerance that it keeps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base import InputError, drain
from lfcal.camera import ScanPlan, preset
from lfcal.simulate import (
    PlaneResponse,
    Sampling,
    SimulatedCamera,
    iter_simulate_psf,
    outlook_of,
    plan_effects,
    response,
    simulate_psf,
)
from lfcal.simulate import effects as fx
from lfcal.simulate.accuracy import _estimates as estimates
from lfcal.simulate.accuracy import _work, calibration
from lfcal.simulate.accuracy._estimates import Influence, estimates_of
from lfcal.simulate.engines import field as field_engine
from lfcal.simulate.engines import grid
from lfcal.simulate.scene import Scene
from lfcal.work import RunChoice
from tests.simulate.common import BASE, FAST, difference, small_camera, small_plan, some_positions


def test_r29_plan_reads_like_the_table() -> None:
    plan = ScanPlan.for_camera(preset("r29"), virtual_depths=[4.0])
    found = plan_effects(plan, 0.03)
    on = {row.name for row in found.rows if row.on}
    optics = {"lens_types", "lenslet_diffraction", "iris_diffraction", "iris_shape", "telecentricity", "exact_angles"}
    assert on == optics
    assert found.level == "wave" and found.seconds > found.ideal_seconds > 0
    assert len(found.rows) == len(fx.catalogue())
    for row in found.rows:
        assert row.reason and row.seconds >= 0 and row.z_um == plan.depths_um[0]
    assert "px" in found.row("lens_types").reason and "%" in found.row("lens_types").reason
    assert "sensor frame" in found.row("read_noise").reason
    assert "unknown" in found.row("lenslet_gap").reason


def test_what_is_left_out_adds_up_to_less_than_the_tolerance() -> None:
    none = plan_effects(small_plan(cutout=15), 4.0)
    assert none.effects == () and none.level == "geometric"
    assert none.seconds == pytest.approx(none.ideal_seconds)
    for tolerance in (1e-9, 0.005, 0.02, 0.2, 0.6):
        found = plan_effects(small_plan(), tolerance)
        known = [r for r in found.rows if not r.effect.deviation and r.effect.acts_on.enters_h]
        out = [row.estimate.error for row in known if not row.on]
        assert [sum(out)] == pytest.approx(list(found.left_out))
        assert found.left_out[0] <= tolerance / 2 or max(out) < 1e-5, tolerance


def test_rounded_sums_of_errors_end_the_search_for_the_fastest_decisions() -> None:
    """The sum of the omitted errors was above the limit by rounding, and the search repeated it for ever."""
    plan = ScanPlan.for_camera(preset("flfm_20x05"), depths_um=(-20.0, 20.0), cutout=101)
    for tolerance in (0.1, 0.03, 0.01, 0.003):
        assert all(error <= 0.5 * tolerance for error in plan_effects(plan, tolerance=tolerance).left_out)


def test_costly_effects_are_left_out_first_and_deviations_count_once_they_are_known() -> None:
    plan = small_plan()
    source, gap = fx.FiniteSource(20.0), fx.LensletGap(0.8)
    errors = [e.estimate(outlook_of(plan, 0)).error for e in (source, gap)]
    tolerance = 2.1 * max(errors)
    assert 2 * sum(errors) > tolerance
    found = plan_effects(plan, tolerance, effects=(source, gap))
    assert not found.row("finite_source").on and found.row("lenslet_gap").on
    assert found.row("finite_source").seconds > found.row("lenslet_gap").seconds == 0
    for given, on in (((), False), ((fx.LensletGap(5.0),), True), ((fx.LensletGap(0.01),), False)):
        assert plan_effects(plan, 0.05, effects=given).row("lenslet_gap").on == on, given


def test_what_cannot_show_in_h_stays_off_though_switched_on() -> None:
    plan = small_plan(cutout=31)
    expected = {
        "read_noise": "acts on the sensor frame, not on H",
        "backlash": "acts on the stage, not on H",
        "zernike": "no typical size",
    }
    choices = dict.fromkeys(expected, "on")
    found, frames = (plan_effects(plan, 0.2, choices, frames=frames) for frames in (False, True))
    for name, words in expected.items():
        row = found.row(name)
        assert not row.on and row.reason.startswith("switched on, but") and words in row.reason
        assert frames.row(name).on == (name != "zernike")
    H = simulate_psf(replace(plan, period=(1, 2)), (*BASE, fx.ReadNoise(3.0)), sampling=FAST)
    assert "read_noise" not in [effect["name"] for effect in H.provenance["simulated"]["effects"]]


def test_effects_may_be_switched_on_and_off() -> None:
    plan = small_plan()
    found = plan_effects(plan, 0.03, {"lenslet_diffraction": "off", "crosstalk": "on"})
    assert not found.row("lenslet_diffraction").on and found.row("crosstalk").on
    assert found.level == "geometric" and "switched off" in found.row("lenslet_diffraction").reason
    for tolerance, choices, match in (
        (0.03, {"diffraction": "on"}, r"did you mean \w*diffraction\?"),
        (0.03, {"crosstalk": "yes"}, "auto, on or off"),
        (0.0, {}, "tolerance"),
    ):
        with pytest.raises(InputError, match=match):
            plan_effects(plan, tolerance, choices)


def test_decisions_are_made_for_each_plane() -> None:
    plan = ScanPlan.for_camera(small_camera(), virtual_depths=[0.0, 4.0], cutout=21)
    found = plan_effects(plan, 0.03)
    row = found.row("iris_diffraction")
    assert row.planes == (False, True) and row.on and "on at 1 of 2 planes" in row.reason
    assert row.z_um == plan.depths_um[1], "the plane where it matters"
    near, far = plan.depths_um
    assert row.effect in found.at(far) and row.effect not in found.at(near)
    assert found.at(near + 1.0) == found.at(near), "between planes the nearest counts"
    few = replace(plan, period=(2, 2))
    H = simulate_psf(few, plan_effects(few, 0.03), tolerance=0.03)
    simulated = H.provenance["simulated"]
    assert simulated["effect_planes"]["iris_diffraction"] == [1]
    assert [effect["name"] for effect in simulated["effects"]] == [e.name for e in found.effects]


@pytest.mark.long
@pytest.mark.parametrize("v", [0.0, 0.2])
@pytest.mark.parametrize(
    "effect",
    [fx.Coma(0.3), fx.Spherical(0.25), fx.LensletGap(5.0), fx.Crosstalk(0.05), fx.PitchError(1e-3)],
    ids=lambda e: e.name,
)
def test_estimates_near_the_native_plane(v: float, effect: fx.Effect) -> None:
    """No formula holds there: the estimate of a known effect is measured, and right at other positions."""
    plan = small_plan(v, cutout=31)
    found = plan_effects(plan, 0.03, effects=(effect,)).row(effect.name)
    sampling = Sampling(nodes_per_px=5, margin_px=24, coherent=True)
    ys, xs = [1, 7, 13], [4, 9, 18, 30]
    off, on = (PlaneResponse(plan, 0, effects, sampling=sampling).rows(ys, xs) for effects in (BASE, (*BASE, effect)))
    measured = difference(off, on)
    assert found.estimate.measured
    assert 0.5 * measured <= found.estimate.error <= 2 * measured
    assert found.on == (found.estimate.error > 0.015) or found.estimate.error > 0.005


@pytest.mark.long
@pytest.mark.parametrize("v", [0.0, 0.5])
def test_exact_angles_are_estimated_by_what_follows_them(v: float) -> None:
    """Near the native plane the wave level does not: its own difference would be a tenth of the true one."""
    plan = small_plan(v, cutout=31)
    estimate = plan_effects(plan, 0.03).row("exact_angles").estimate
    ys, xs = [2, 12], [5, 20]
    off, on = (
        PlaneResponse(plan, 0, effects, level="reference", sampling=Sampling(samples_per_px=12)).rows(ys, xs)
        for effects in (BASE, (*BASE, fx.ExactAngles()))
    )
    assert estimate.measured and 0.5 <= estimate.error / difference(off, on) <= 2


def test_waves_are_not_left_out_because_another_effect_brings_them() -> None:
    """A vectorial pupil switches diffraction on: that it is on anyway does not make diffraction small."""
    plan = ScanPlan.for_camera(preset("lfm_60x12"), depths_um=[0.5], cutout=31)
    found = plan_effects(plan, 0.2)
    assert found.row("lenslet_diffraction").estimate.measured
    assert found.row("lenslet_diffraction").estimate.error > 0.2 and found.level == "debye"


@pytest.fixture
def no_estimates() -> Iterator[None]:
    """Forget estimates before and after a test."""
    for step in range(2):
        estimates.measured.cache_clear()
        estimates.influence.cache_clear()
        if not step:
            yield


@pytest.mark.usefixtures("no_estimates")
def test_a_plan_of_many_planes_runs_effects_at_a_few(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = ScanPlan.for_camera(small_camera(), virtual_depths=np.linspace(-0.5, 0.5, 23), cutout=21)
    ran: list[int] = []

    class Counted(Influence):
        def __init__(self, plan: ScanPlan, z: int, effects: Sequence[fx.Effect]) -> None:
            super().__init__(plan, z, effects)
            self.z = z

        def of(self, effect: fx.Effect) -> float:
            ran.append(self.z)
            return 0.1 if self.z else 0.001

    monkeypatch.setattr(estimates, "Influence", Counted)
    outlooks, effects = [outlook_of(plan, z) for z in range(23)], [fx.Crosstalk(0.05)]
    errors = [found.error for found in estimates_of(effects, effects, outlooks, plan)[0]]
    assert sorted(ran) == [0, 6, 11, 16, 22]
    assert np.all(np.diff(errors[:7]) > 0) and errors[0] == 0.001 and errors[6:] == pytest.approx([0.1] * 17)
    assert errors[3] == pytest.approx(0.01), "halfway on a logarithmic scale"


def test_frames_add_noise_and_motion() -> None:
    plan = small_plan()
    names = {e.name for e in plan_effects(plan, 0.02, frames=True, effects=(fx.PositioningError(5.0),))}
    assert {"read_noise", "quantisation", "stage_error"} <= names
    quiet = small_plan(camera=small_camera(read_noise_e=0.0))
    assert "read_noise" not in {e.name for e in plan_effects(quiet, 0.02, frames=True)}
    found = plan_effects(plan, 0.25, frames=True, effects=(fx.ShotNoise(), fx.ReadNoise(0.1)))
    assert not found.row("shot_noise").on and not found.row("read_noise").on, "within the budget of frames"


def test_an_effect_that_is_off_costs_nothing() -> None:
    """Work is counted, not timed: one engine run per response without light effects."""
    plan = small_plan()
    assert PlaneResponse(plan, 0, plan_effects(plan, 0.03).effects).runs == 1
    both = PlaneResponse(plan, 0, (fx.Bandwidth(0.02), fx.FiniteSource(10.0)), level="wave")
    assert both.runs == 7 * fx.Bandwidth(0.02).runs(outlook_of(plan, 0))
    assert PlaneResponse(plan, 0, (fx.Bandwidth(0.02),), level="geometric").runs == 1, "rays have no colour"


@pytest.mark.few(1)
@pytest.mark.parametrize(("v", "tolerance"), [(4.0, 0.03), (4.0, 0.12), (-3.0, 0.05)])
def test_planned_simulation_lies_within_the_tolerance_of_everything(v: float, tolerance: float) -> None:
    plan = small_plan(v)
    given = (fx.LensletGap(1.0), fx.Crosstalk(0.003), fx.Bandwidth(0.05))
    found = plan_effects(plan, tolerance, effects=given)
    everything = plan_effects(plan, 1e-9, effects=given)
    assert len(everything.effects) > len(found.effects)
    ys, xs = some_positions(plan)
    planned = PlaneResponse(plan, 0, found.effects, sampling=FAST).rows(ys, xs)
    full = PlaneResponse(plan, 0, everything.effects, sampling=FAST).rows(ys, xs)
    assert difference(planned, full) <= tolerance


@dataclass(frozen=True, eq=False)
class Tabulated(fx.SceneEffect):
    """An effect of another package that contains an array, and cannot be hashed or compared."""

    table: np.ndarray = field(default_factory=lambda: np.ones(3))
    name = title = "tabulated"
    __hash__ = None

    def estimate(self, outlook: fx.Outlook) -> fx.Estimate:
        return fx.Estimate(1.0, "tables", 0.3, "a table")

    def on_scene(self, scene: Scene, outlook: fx.Outlook) -> Scene:
        return replace(scene, f_number=scene.f_number * float(self.table.mean()))


def test_effects_that_hold_lists_and_arrays_are_planned() -> None:
    plan = replace(small_plan(0.0, cutout=21), period=(1, 2))
    terms = fx.Zernike([[4, 0, 0.1], [3, 1, 0.05]])  # as a script may write it
    assert hash(terms) == hash(fx.Zernike(((4, 0, 0.1), (3, 1, 0.05))))
    assert plan_effects(plan, 0.03, effects=(terms,)).row("zernike").estimate.measured
    found = plan_effects(plan, 0.03, effects=(Tabulated(np.full(3, 1.3)),))
    assert found.row("tabulated").estimate.measured and found.row("tabulated").on
    simulate_psf(plan, found, workers=1)


def test_every_reason_has_a_brief_that_repeats_no_number() -> None:
    plan = small_plan()
    choices = {"coma": "on", "crosstalk": "off", "shot_noise": "on", "zernike": "on"}
    found = plan_effects(plan, 0.05, choices)
    briefs = {row.name: row.brief for row in found.rows}
    assert (briefs["coma"], briefs["crosstalk"], briefs["shot_noise"]) == ("switched on", "switched off", "not in H")
    assert briefs["zernike"] == "needs a size" and briefs["spherical"] == "unknown"
    assert all(row.brief == "needed" for row in found.rows if row.setting == "auto" and "above the" in row.reason)
    assert all(len(brief) <= 14 for brief in briefs.values())


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Count the calls of the methods by which effects act on a simulation."""
    found: Counter[str] = Counter()
    for kind in fx.CATALOGUE:
        for action in ("on_scene", "spread", "kernel", "displace", "on_frame"):
            if original := getattr(kind, action, None):

                def call(self: fx.Effect, *args: object, _original: Any = original, **more: object) -> object:
                    found[self.name] += 1
                    return _original(self, *args, **more)

                monkeypatch.setattr(kind, action, call)
    return found


def test_only_effects_that_are_on_are_called(calls: Counter[str], tmp_path: Path) -> None:
    """In H in memory and in units, and in frames; nothing else of an effect runs."""
    plan = replace(small_plan(cutout=31), period=(2, 3))
    found = plan_effects(plan, 0.03)
    on = {row.name for row in found.rows if row.on}
    assert 4 < len(on) < len(found.rows) / 2
    for how in ({}, {"out": tmp_path / "H.h5", "run": RunChoice("threads", 1)}):
        calls.clear()
        drain(iter_simulate_psf(plan, found, **how))
        assert set(calls) == on
    frames = plan_effects(plan, 0.03, {"ghost": "off"}, frames=True)
    calls.clear()
    SimulatedCamera(plan, frames).read(0)
    assert on < set(calls) == {row.name for row in frames.rows if row.on}
    # effects that are switched on are called, so the comparisons above can fail
    switched = plan_effects(plan, 0.5, {"coma": "on", "crosstalk": "on", "finite_source": "on"})
    calls.clear()
    simulate_psf(plan, switched, "geometric")
    assert {"coma", "crosstalk", "finite_source"} <= set(calls)


WORK = [
    (fx.Crosstalk(0.01), response, "filtered"),
    (fx.Spherical(0.25), field_engine, "zernike_wavefront"),
    (fx.ArrayTilt(1e-3), grid, "TiltedArray"),
    (fx.AngularResponse(0.4), grid, "pixel_response"),
    (fx.FiniteSource(50.0), grid.GridPlane, "displaced"),
    (fx.Bandwidth(0.02), PlaneResponse, "_make_engine"),
    (fx.LensletDiffraction(), grid, "fill_disc"),
]
"""Work of the engines that only one effect needs."""


def test_an_effect_that_is_off_costs_no_work_in_the_engines(monkeypatch: pytest.MonkeyPatch) -> None:
    plan, counted = replace(small_plan(cutout=31), period=(1, 2)), Counter[str]()

    def count(place: Any, function: str) -> None:
        original = getattr(place, function)
        monkeypatch.setattr(
            place, function, lambda *args, **more: counted.update([function]) or original(*args, **more)
        )

    for effect, place, function in WORK:
        count(place, function)
        others = tuple(e for e in BASE if e.name != effect.name)
        for effects, needed in ((others, False), ((*others, effect), True)):
            counted.clear()
            level = "grid" if effect.name != "lenslet_diffraction" or needed else "geometric"
            simulate_psf(plan, effects, level, sampling=Sampling(4.0, margin_px=10))
            # an engine is made once without light of several wavelengths
            assert (counted[function] > (effect.name == "bandwidth")) == needed, (function, counted)


def test_the_forecasts_with_and_without_an_effect_are_those_of_such_a_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration, "_SPEED", None)
    monkeypatch.setattr(calibration, "_timed_rate", lambda: _work.FITTED_RATE)
    plan = ScanPlan.for_camera(small_camera(), virtual_depths=[3.0, 4.0], cutout=41)
    found = plan_effects(plan, 0.05, effects=(fx.FiniteSource(1.0),))
    for row in found.rows:
        assert row.seconds_with >= row.seconds_without
        if not row.effect.acts_on.enters_h:
            assert row.seconds_with == row.seconds_without == found.seconds, "it does not act on H"
            continue
        assert (row.seconds_with if row.on else row.seconds_without) == pytest.approx(found.seconds)
        if row.on:
            other = plan_effects(plan, 0.05, {row.name: "off"}, effects=(fx.FiniteSource(1.0),))
            assert row.seconds_without == pytest.approx(other.seconds), row.name
    source = plan_effects(plan, 0.05, {"finite_source": "on"}, effects=(fx.FiniteSource(1.0),))
    assert found.row("finite_source").seconds_with == pytest.approx(source.seconds) and source.seconds > found.seconds
    diffraction = found.row("lenslet_diffraction")
    assert diffraction.seconds_without < diffraction.seconds_with, "rays are faster"


def changed(plan: ScanPlan, effect: fx.Effect) -> float:
    found = Influence(replace(plan, cutout=(41, 41), period=(5, 5)), 0, BASE).of(effect)
    assert found is not None
    return found


@pytest.mark.long
def test_off_the_separable_path_a_small_effect_changes_little() -> None:
    """Engines differ by 0.1 to 1 %: an effect that calls for another one must not be taken for that."""
    plan = ScanPlan.for_camera(preset("lfm_20x05"), depths_um=[5.0], cutout=41)
    one, hundred = (changed(plan, fx.LensletSpherical(waves)) for waves in (1e-4, 1e-2))
    assert 0 < one < 1e-3
    assert one == pytest.approx(hundred / 100, rel=0.1)


def test_what_would_take_minutes_is_not_measured() -> None:
    """A spectrum of a microscope with cutouts of 1001 px took minutes, and gigabytes."""
    assert changed(small_plan(3.0, cutout=41), fx.ArrayTilt(1e-7)) < 0.002, "compared with an array computed alike"
    plan = ScanPlan.for_camera(preset("lfm_60x12"), cutout=131, depths_um=[-20.0])
    assert Influence(plan, 0, BASE).of(fx.Bandwidth(0.05)) is not None
    camera = replace(plan.camera, sensor=replace(plan.camera.sensor, shape=(1400, 1400)))
    large = ScanPlan.for_camera(camera, cutout=1301, depths_um=[-20.0])
    assert Influence(large, 0, BASE).of(fx.Bandwidth(0.5)) is None, "its formula stays"
