"""The forecast of the noise of H: compared with H assembled from simulated frames, and how it changes with the plan."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base import drain
from lfcal.camera import Forecast, Marks, ScanPlan, not_stated_for_noise, preset
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view
from lfcal.psf import Cutout, assemble
from lfcal.simulate import ExpectedLight, ScanChoice, SimulatedCamera, iter_expected_light, scan_choices
from lfcal.simulate import effects as fx
from lfcal.simulate.sensor import FrameKind
from tests.simulate.common import long

OPTICS = (fx.LensTypeDefocus(), fx.LensletDiffraction(), fx.IrisShape(), fx.Telecentricity())
NOISE = (fx.DarkCurrent(), fx.ShotNoise(), fx.Saturation(), fx.ReadNoise(), fx.Quantisation())


def plan_of(**sensor: Any) -> ScanPlan:
    """Return a plan of the bench camera with a small sensor, in two planes of different exposures."""
    bench = preset("bench")
    camera = replace(bench, sensor=replace(bench.sensor, shape=(80, 96), **sensor))
    return ScanPlan.for_camera(camera, virtual_depths=(3.0, 4.0), cutout=41, exposure_s=(0.02, 0.04))


def light_of(plan: ScanPlan) -> ExpectedLight:
    return drain(iter_expected_light(plan))


def assembled(source: SimulatedCamera, chosen: list[int], frames: int, dark: float) -> NDArray[np.float64]:
    """Return H ``(positions, nt, ns)`` of the mean of frames at some positions, less the dark level."""
    plan = source.plan
    repeats = [(k, k + n * len(source)) for k in chosen for n in range(frames)]
    raw = [source.expose(source.light(k), source.exposure_s(k), FrameKind.LIGHT, key) for k, key in repeats]
    where = [tuple(source.position(k)) for k, _ in repeats]
    facts = replace(source.metadata, plan=None, plan_shape=None)
    view = corrected_view(ArraySource(np.stack(raw), where, metadata=facts), CorrectionRecipe(black_level=dark))
    H = assemble(view, plan.shape[:3], Cutout(plan.cutout, plan.anchor)).matrix
    return np.array([H[place] for place in dict.fromkeys(where)], float)


@pytest.mark.long
@pytest.mark.parametrize(
    ("frames", "peak", "sensor"),
    [
        long(1, 0.8, {}, id="preset"),
        long(4, 0.3, {"read_noise_e": 30.0}, id="dim, averaged"),
        pytest.param(4, 0.2, {"black_level": 0.0, "read_noise_e": 25.0}, id="cut off at zero"),
        pytest.param(1, 0.8, {"bit_depth": 6, "black_level": 4.0, "read_noise_e": 120.0}, id="coarse"),
        long(2, 0.5, {"dark_current_e_s": 2e5, "full_well_e": 5e4}, id="dark current"),
    ],
)
def test_the_forecast_is_the_deviation_of_assembled_frames(frames: int, peak: float, sensor: dict[str, float]) -> None:
    plan = plan_of(**sensor)
    expected = light_of(plan).noise(replace(plan, frames_averaged=frames), peak)
    noisy = SimulatedCamera(plan, (*OPTICS, *NOISE), peak=peak, seed=3)
    clean = SimulatedCamera(plan, OPTICS, peak=peak, seed=3)
    for z, wanted in enumerate(expected):
        chosen = [k for k in range(5, len(clean), 61) if clean.position(k).z == z]
        # a plane has its dark frames: dark current grows with the exposure
        dark = np.mean([noisy.dark_frame(n, plan.exposures[z]) for n in range(30)])
        truth = assembled(clean, chosen, 1, plan.camera.sensor.black_level)
        found = assembled(noisy, chosen, frames, float(dark))
        assert len(chosen) > 8
        assert wanted == pytest.approx(np.linalg.norm(found - truth) / np.linalg.norm(truth), rel=0.15)


def test_averages_divide_the_noise_by_their_root_and_light_lessens_it() -> None:
    plan = plan_of()
    light = light_of(plan)
    one, four = light.noise(plan), light.noise(replace(plan, frames_averaged=4))
    assert four == pytest.approx([n / 2 for n in one], rel=1e-3)
    assert all(dim > bright for dim, bright in zip(light.noise(plan, 0.2), one, strict=True))
    longer = light.noise(replace(plan, exposure_s=(0.04, 0.08)))
    assert longer == pytest.approx(one, rel=1e-3), "the peak says how much light there is"


def test_choices_are_the_fastest_first_and_the_plan_is_one_of_them() -> None:
    plan = plan_of()
    light, cost = light_of(plan), Forecast.of(plan, frames_per_s=20.0)
    choices = scan_choices(plan, light, 0.8, cost)
    seconds, noise = ([getattr(one, name) for one in choices] for name in ("seconds", "noise"))
    assert seconds == sorted(seconds) and noise == sorted(noise, reverse=True) and len(choices) == 11
    assert [one.plan for one in choices].count(plan) == 1
    for one in choices:
        again = Forecast.of(one.plan, frames_per_s=20.0)
        assert one.seconds == pytest.approx(3600 * again.hours, rel=1e-3)
    # wherever one is, the choices are the same
    fast = choices[1]
    assert fast.plan.exposures == pytest.approx((0.0025, 0.005)) and fast.peak == pytest.approx(0.1)
    again_of: tuple[ScanChoice, ...] = scan_choices(
        fast.plan, light, fast.peak, Forecast.of(fast.plan, frames_per_s=20)
    )
    assert [one.plan for one in again_of] == [one.plan for one in choices]
    three = replace(plan, frames_averaged=3)
    assert three in [one.plan for one in scan_choices(three, light, 0.8, Forecast.of(three))]


def test_what_is_not_stated_of_the_sensor_is_named() -> None:
    camera = preset("bench")
    assert not_stated_for_noise(camera) == ()
    assumed = replace(camera, marks=Marks.of({"sensor.full_well_e": "assumed", "sensor.prnu": "assumed"}))
    assert not_stated_for_noise(assumed) == ("full well",)


def test_exposures_of_more_than_a_day_are_no_choice() -> None:
    """A plan that is nearly dark has brighter choices only as long as a frame takes less than a day."""
    plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0,), cutout=55), exposure_s=50000.0)
    light = drain(iter_expected_light(plan))
    choices = scan_choices(plan, light, 0.2, Forecast.of(plan))
    assert plan in [one.plan for one in choices]
    assert 50000 < max(max(one.plan.exposures) for one in scan_choices(plan, light, 0.5, Forecast.of(plan))) <= 86400
    assert max(max(one.plan.exposures) for one in choices) == 50000
