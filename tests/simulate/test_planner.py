"""The plan of effects: decisions, reasons, cost, and the tolerance it keeps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from lfcal.base import drain
from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.simulate import SimulatedCamera, response
from lfcal.simulate.accuracy import _estimates as estimates
from lfcal.simulate.accuracy import _work, calibration
from lfcal.simulate.accuracy._estimates import Influence, estimates_of
from lfcal.simulate.accuracy.planner import plan_effects
from lfcal.simulate.effects import (
    CATALOGUE,
    AngularResponse,
    ArrayTilt,
    Bandwidth,
    Coma,
    Crosstalk,
    Effect,
    Estimate,
    ExactAngles,
    FiniteSource,
    LensletDiffraction,
    LensletGap,
    Outlook,
    PitchError,
    PositioningError,
    PsfEffect,
    ReadNoise,
    SceneEffect,
    ShotNoise,
    Spherical,
    Zernike,
    catalogue,
)
from lfcal.simulate.engines import field as field_engine
from lfcal.simulate.engines import grid
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.scene import Scene
from lfcal.simulate.simulate import iter_simulate_psf, simulate_psf
from lfcal.simulate.staging import outlook_of
from lfcal.work import RunChoice
from tests.simulate.common import BASE, FAST, difference, small_camera, small_plan, some_positions


class Called(Exception):
    pass


@dataclass(frozen=True)
class Trap(SceneEffect):
    """An effect whose code must not run."""

    error: float = 0.5

    name: ClassVar[str] = "trap"
    title: ClassVar[str] = "trap"

    def estimate(self, outlook: Outlook) -> Estimate:
        return Estimate(1.0, "traps", self.error, "a trap")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        raise Called


@dataclass(frozen=True)
class FilterTrap(PsfEffect):
    name: ClassVar[str] = "filter_trap"
    title: ClassVar[str] = "trap"

    def estimate(self, outlook: Outlook) -> Estimate:
        return Estimate(1.0, "traps", 1e-4, "a trap")

    def kernel(self, camera: object) -> np.ndarray:
        raise Called


def test_r29_plan_reads_like_the_table() -> None:
    plan = ScanPlan.for_camera(preset("r29"), virtual_depths=[4.0])
    found = plan_effects(plan, 0.03)
    on = {row.name for row in found.rows if row.on}
    optics = {"lens_types", "lenslet_diffraction", "iris_diffraction", "iris_shape", "telecentricity", "exact_angles"}
    assert on == optics
    assert found.level == "wave" and found.seconds > found.ideal_seconds > 0
    assert len(found.rows) == len(catalogue())
    for row in found.rows:
        assert row.reason and row.seconds >= 0 and row.z_um == plan.depths_um[0]
    assert "px" in found.row("lens_types").reason and "%" in found.row("lens_types").reason
    assert "sensor frame" in found.row("read_noise").reason
    assert "unknown" in found.row("lenslet_gap").reason


def test_a_loose_tolerance_leaves_all_out_and_a_tight_one_nothing() -> None:
    none = plan_effects(small_plan(cutout=15), 4.0)
    assert none.effects == () and none.level == "geometric"
    assert none.seconds == pytest.approx(none.ideal_seconds)
    all_of_it = plan_effects(small_plan(), 1e-9)
    known = [r for r in all_of_it.rows if not r.effect.deviation and r.effect.acts_on.enters_h]
    assert all(row.on or row.estimate.error < 1e-5 for row in known)


def test_what_is_left_out_adds_up_to_less_than_the_tolerance() -> None:
    plan = small_plan()
    for tolerance in (0.005, 0.02, 0.05, 0.2, 0.6):
        found = plan_effects(plan, tolerance)
        out = [
            r.estimate.error for r in found.rows if not r.on and not r.effect.deviation and r.effect.acts_on.enters_h
        ]
        assert [sum(out)] == pytest.approx(list(found.left_out))
        assert found.left_out[0] <= tolerance / 2


@pytest.mark.parametrize("tolerance", (0.1, 0.03, 0.01, 0.003))
def test_rounded_sums_of_errors_end_the_search_for_the_fastest_decisions(tolerance: float) -> None:
    """The sum of the omitted errors was above the limit by rounding, and the search repeated it for ever."""
    plan = ScanPlan.for_camera(preset("flfm_20x05"), depths_um=(-20.0, 20.0), cutout=101)
    found = plan_effects(plan, tolerance=tolerance)
    assert all(error <= 0.5 * tolerance for error in found.left_out)


def test_costly_effects_are_left_out_first() -> None:
    plan = small_plan()
    source, gap = FiniteSource(20.0), LensletGap(0.8)
    errors = [e.estimate(plan_effects_outlook(plan)).error for e in (source, gap)]
    tolerance = 2.1 * max(errors)
    assert 2 * sum(errors) > tolerance
    found = plan_effects(plan, tolerance, effects=(source, gap))
    assert not found.row("finite_source").on and found.row("lenslet_gap").on
    assert found.row("finite_source").seconds > found.row("lenslet_gap").seconds == 0


def test_what_cannot_show_in_h_stays_off_though_asked_for() -> None:
    plan = small_plan(cutout=31)
    asked = {"read_noise": "on", "zernike": "on", "backlash": "on"}
    found = plan_effects(plan, 0.2, asked)
    for name, words in (
        ("read_noise", "acts on the sensor frame, not on H"),
        ("backlash", "acts on the stage, not on H"),
        ("zernike", "no typical size"),
    ):
        row = found.row(name)
        assert not row.on and row.reason.startswith("switched on, but") and words in row.reason
    frames = plan_effects(plan, 0.2, asked, frames=True)
    assert frames.row("read_noise").on and frames.row("backlash").on and not frames.row("zernike").on
    H = simulate_psf(replace(plan, period=(1, 2)), (*BASE, ReadNoise(3.0)), sampling=FAST)
    assert "read_noise" not in [effect["name"] for effect in H.provenance["simulated"]["effects"]]


def plan_effects_outlook(plan: ScanPlan) -> Outlook:
    from lfcal.simulate.staging import outlook_of

    return outlook_of(plan, 0)


def test_overrides() -> None:
    plan = small_plan()
    found = plan_effects(plan, 0.03, {"lenslet_diffraction": "off", "crosstalk": "on"})
    assert not found.row("lenslet_diffraction").on and found.row("crosstalk").on
    assert found.level == "geometric" and "switched off" in found.row("lenslet_diffraction").reason
    with pytest.raises(InputError, match=r"did you mean \w*diffraction\?"):
        plan_effects(plan, 0.03, {"diffraction": "on"})
    with pytest.raises(InputError, match="auto, on or off"):
        plan_effects(plan, 0.03, {"crosstalk": "yes"})
    with pytest.raises(InputError):
        plan_effects(plan, 0.0)


def test_deviations_count_once_they_are_known() -> None:
    plan = small_plan()
    assert not plan_effects(plan, 0.05).row("lenslet_gap").on
    assert plan_effects(plan, 0.05, effects=(LensletGap(5.0),)).row("lenslet_gap").on
    assert not plan_effects(plan, 0.05, effects=(LensletGap(0.01),)).row("lenslet_gap").on


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
    [
        Coma(0.3),
        Spherical(0.25),
        LensletGap(5.0),
        Crosstalk(0.05),
        PitchError(1e-3),
    ],
    ids=lambda e: e.name,
)
def test_estimates_near_the_native_plane(v: float, effect: Effect) -> None:
    """No formula holds there: what is said of a known effect is measured, and right at other positions."""
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
@pytest.mark.parametrize("v", [0.0, pytest.param(0.5, marks=pytest.mark.long)])
def test_exact_angles_are_estimated_by_what_follows_them(v: float) -> None:
    """Near the native plane the wave level does not: its own difference would be a tenth of the true one."""
    plan = small_plan(v, cutout=31)
    estimate = plan_effects(plan, 0.03).row("exact_angles").estimate
    ys, xs = [2, 12], [5, 20]
    off, on = (
        PlaneResponse(plan, 0, effects, level="reference", sampling=Sampling(samples_per_px=12)).rows(ys, xs)
        for effects in (BASE, (*BASE, ExactAngles()))
    )
    assert estimate.measured and 0.5 <= estimate.error / difference(off, on) <= 2


def test_waves_are_not_left_out_because_another_effect_brings_them() -> None:
    """A vectorial pupil switches diffraction on: that it is on anyway does not make diffraction small."""
    plan = ScanPlan.for_camera(preset("lfm_60x12"), depths_um=[0.5], cutout=31)
    found = plan_effects(plan, 0.2)
    assert found.row("lenslet_diffraction").estimate.measured
    assert found.row("lenslet_diffraction").estimate.error > 0.2 and found.level == "debye"


def test_a_plan_of_many_planes_runs_effects_at_a_few() -> None:
    plan = ScanPlan.for_camera(small_camera(), virtual_depths=np.linspace(-0.5, 0.5, 23), cutout=21)
    planes = [outlook_of(plan, z) for z in range(23)]
    ran: list[int] = []

    class Counted(Influence):
        def __init__(self, plan: ScanPlan, z: int, effects: Sequence[Effect]) -> None:
            super().__init__(plan, z, effects)
            self.z = z

        def of(self, effect: Effect) -> float:
            ran.append(self.z)
            return 0.1 if self.z else 0.001

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(estimates, "Influence", Counted)
        estimates.measured.cache_clear()
        estimates.influence.cache_clear()
        found = estimates_of([Crosstalk(0.05)], [Crosstalk(0.05)], planes, plan)[0]
    estimates.measured.cache_clear()
    estimates.influence.cache_clear()
    assert sorted(ran) == [0, 6, 11, 16, 22]
    errors = [e.error for e in found]
    assert np.all(np.diff(errors[:7]) > 0) and errors[0] == 0.001 and errors[6:] == pytest.approx([0.1] * 17)
    assert errors[3] == pytest.approx(0.01), "halfway on a logarithmic scale"


def test_frames_bring_noise_and_motion() -> None:
    plan = small_plan()
    names = {e.name for e in plan_effects(plan, 0.02, frames=True, effects=(PositioningError(5.0),))}
    assert {"read_noise", "quantisation", "stage_error"} <= names
    quiet = small_plan(camera=small_camera(read_noise_e=0.0))
    assert "read_noise" not in {e.name for e in plan_effects(quiet, 0.02, frames=True)}


def test_an_effect_that_is_off_does_not_run() -> None:
    plan = small_plan(cutout=31)
    found = plan_effects(plan, 0.9, {"trap": "off"}, effects=(Trap(), FilterTrap()))
    assert not found.row("trap").on and not found.row("filter_trap").on
    simulate_psf(replace(plan, period=(2, 2)), found)
    with pytest.raises(Called):
        simulate_psf(plan, plan_effects(plan, 0.9, {"trap": "on"}, effects=(Trap(),)))
    with pytest.raises(Called):
        simulate_psf(plan, (FilterTrap(),))


def test_an_effect_that_is_off_costs_nothing() -> None:
    """Work is counted, not timed: one engine run per response without light effects."""
    plan = small_plan()
    assert PlaneResponse(plan, 0, plan_effects(plan, 0.03).effects).runs == 1
    both = PlaneResponse(plan, 0, (Bandwidth(0.02), FiniteSource(10.0)), level="wave")
    assert both.runs == 7 * Bandwidth(0.02).runs(plan_effects_outlook(plan))
    assert PlaneResponse(plan, 0, (Bandwidth(0.02),), level="geometric").runs == 1, "rays have no colour"


@pytest.mark.few(1)
@pytest.mark.parametrize(("v", "tolerance"), [(4.0, 0.03), (4.0, 0.12), (-3.0, 0.05)])
def test_planned_simulation_lies_within_the_tolerance_of_everything(v: float, tolerance: float) -> None:
    plan = small_plan(v)
    given = (LensletGap(1.0), Crosstalk(0.003), Bandwidth(0.05))
    found = plan_effects(plan, tolerance, effects=given)
    everything = plan_effects(plan, 1e-9, effects=given)
    assert len(everything.effects) > len(found.effects)
    ys, xs = some_positions(plan)
    planned = PlaneResponse(plan, 0, found.effects, sampling=FAST).rows(ys, xs)
    full = PlaneResponse(plan, 0, everything.effects, sampling=FAST).rows(ys, xs)
    assert difference(planned, full) <= tolerance


def test_noise_estimates_enter_the_budget_of_frames() -> None:
    plan = small_plan()
    found = plan_effects(plan, 0.25, frames=True, effects=(ShotNoise(), ReadNoise(0.1)))
    assert not found.row("shot_noise").on and not found.row("read_noise").on


@dataclass(frozen=True, eq=False)
class Tabulated(SceneEffect):
    """An effect of another distribution that holds an array: it has no hash worth the name, and cannot be compared."""

    table: np.ndarray = field(default_factory=lambda: np.ones(3))

    name: ClassVar[str] = "tabulated"
    title: ClassVar[str] = "tabulated"
    __hash__ = None  # type: ignore[assignment]

    def estimate(self, outlook: Outlook) -> Estimate:
        return Estimate(1.0, "tables", 0.3, "a table")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        return replace(scene, f_number=scene.f_number * float(self.table.mean()))


def test_effects_that_hold_lists_and_arrays_are_planned() -> None:
    plan = replace(small_plan(0.0, cutout=21), period=(1, 2))
    terms = Zernike([[4, 0, 0.1], [3, 1, 0.05]])  # type: ignore[arg-type]  # as a script may write it
    assert hash(terms) == hash(Zernike(((4, 0, 0.1), (3, 1, 0.05))))
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


ACTIONS = ("on_scene", "spread", "kernel", "displace", "on_frame")
"""Methods by which an effect acts on a simulation."""


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Count the calls of the actions of each effect of the catalogue."""
    found: Counter[str] = Counter()

    def counted(kind: type[Effect], action: str) -> None:
        original = getattr(kind, action)

        def call(self: Effect, *args: object, **more: object) -> object:
            found[kind.name] += 1
            return original(self, *args, **more)

        monkeypatch.setattr(kind, action, call)

    for kind in CATALOGUE:
        for action in ACTIONS:
            if hasattr(kind, action):
                counted(kind, action)
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


def test_each_action_is_counted(calls: Counter[str]) -> None:
    """The test above can fail: an effect that is switched on is called."""
    plan = replace(small_plan(cutout=31), period=(1, 2))
    found = plan_effects(plan, 0.5, {"coma": "on", "crosstalk": "on", "finite_source": "on"})
    calls.clear()
    simulate_psf(plan, found, "geometric")
    assert {"coma", "crosstalk", "finite_source"} <= set(calls)


WORK = {
    "crosstalk": (Crosstalk(0.01), response, "filtered"),
    "spherical": (Spherical(0.25), field_engine, "zernike_wavefront"),
    "array_tilt": (ArrayTilt(1e-3), grid, "TiltedArray"),
    "angular_response": (AngularResponse(0.4), grid, "pixel_response"),
    "finite_source": (FiniteSource(50.0), grid.GridPlane, "displaced"),
    "bandwidth": (Bandwidth(0.02), PlaneResponse, "_make_engine"),
    "lenslet_diffraction": (LensletDiffraction(), grid, "fill_disc"),
}
"""Work of the engines that only one effect needs."""


@pytest.mark.parametrize("name", WORK)
def test_an_effect_that_is_off_costs_no_work_in_the_engines(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    effect, place, function = WORK[name]
    plan, count = replace(small_plan(cutout=31), period=(1, 2)), 0
    original = getattr(place, function)

    def counted(*args: Any, **more: Any) -> Any:
        nonlocal count
        count += 1
        return original(*args, **more)

    monkeypatch.setattr(place, function, counted)
    others = tuple(e for e in BASE if e.name != name)
    most = {"bandwidth": 1}.get(name, 0)
    for effects, needed in ((others, False), ((*others, effect), True)):
        count = 0
        level = "grid" if name != "lenslet_diffraction" or needed else "geometric"
        simulate_psf(plan, effects, level, sampling=Sampling(4.0, margin_px=10))
        assert (count > most) == needed, f"{count} calls of {function}"


def test_the_forecasts_with_and_without_an_effect_are_those_of_such_a_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration, "_SPEED", None)
    monkeypatch.setattr(calibration, "_timed_rate", lambda: _work.FITTED_RATE)
    plan = ScanPlan.for_camera(small_camera(), virtual_depths=[3.0, 4.0], cutout=41)
    found = plan_effects(plan, 0.05, effects=(FiniteSource(1.0),))
    for row in found.rows:
        assert row.seconds_with >= row.seconds_without
        if not row.effect.acts_on.enters_h:
            assert row.seconds_with == row.seconds_without == found.seconds, "it does not act on H"
            continue
        assert (row.seconds_with if row.on else row.seconds_without) == pytest.approx(found.seconds)
        if row.on:
            other = plan_effects(plan, 0.05, {row.name: "off"}, effects=(FiniteSource(1.0),))
            assert row.seconds_without == pytest.approx(other.seconds), row.name
    source = plan_effects(plan, 0.05, {"finite_source": "on"}, effects=(FiniteSource(1.0),))
    assert found.row("finite_source").seconds_with == pytest.approx(source.seconds) and source.seconds > found.seconds
    diffraction = found.row("lenslet_diffraction")
    assert diffraction.seconds_without < diffraction.seconds_with, "rays are faster"
