"""Averaging: the known noise of the sensor, divided by the root of the frames."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.accuracy import PARTS, Subject, measure_curve
from lfcal.accuracy.parts.averaging import EFFECTS, FULL, dark_level, expected_noise
from lfcal.camera import Forecast, ScanPlan
from lfcal.psf import PSFMatrix
from lfcal.simulate.sensor.noise import temporal_noise


@pytest.fixture
def even(plan: ScanPlan) -> Subject:
    """H whose pixels are all alike: each of them holds `FULL` of the well."""
    return Subject("even", plan, PSFMatrix(np.ones(plan.shape, np.float32)))


def test_noise_is_that_of_photons_and_reading_over_the_root_of_the_frames(even: Subject) -> None:
    curve = measure_curve(PARTS.get("averaging"), even, 100)
    plan = even.planned
    sensor = plan.camera.sensor
    own = {r.settings["frames_averaged"]: r for r in curve.points if r.settings["exposure_s"] == [0.02] * 3}
    assert set(own) == {1, 2, 4, 8, 16, 32, 64}
    assert any("do not compare it with the rms error" in note for note in curve.notes), (
        "another measure than its sibling"
    )
    for count, point in own.items():
        electrons = FULL * sensor.full_well_e
        # the mean absolute deviate of a normal distribution is sqrt(2/pi) of its rms
        variance = electrons + sensor.read_noise_e**2 + sensor.electrons_per_count**2 / 12
        wanted = math.sqrt(2 / math.pi * variance / count) / electrons
        assert point.error == pytest.approx(wanted, rel=0.05)
        assert point.others["error by the noise model (%)"] == pytest.approx(100 * wanted, rel=1e-3)
        scan = replace(plan, frames_averaged=count)
        assert point.cost == pytest.approx(3600 * Forecast.of(scan).hours)


def test_more_light_than_the_well_holds_does_not_average_out(even: Subject) -> None:
    curve = measure_curve(PARTS.get("averaging"), even, 100)
    bright = [r for r in curve.points if r.settings["exposure_s"] == [0.08] * 3]
    # of 4 x 0.8 full wells one is kept
    assert all(r.error == pytest.approx(1 - 1 / (4 * FULL), rel=0.01) for r in bright)
    assert all(r.note == "100 % of the pixels are saturated" for r in bright)


def test_the_model_holds_for_dim_and_bright_pixels_together(plan: ScanPlan) -> None:
    light = np.array([[100.0, 4000.0]], np.float32)
    gain = plan.camera.sensor.electrons_per_count
    noise = temporal_noise(EFFECTS, plan.camera)
    rng = np.random.default_rng(0)
    read = math.hypot(plan.camera.sensor.read_noise_e, gain / math.sqrt(12))
    frames = rng.poisson(light, (40_000, 1, 2)) + rng.normal(0, read, (40_000, 1, 2))
    off = np.abs(frames.reshape(10_000, 4, 1, 2).mean(axis=1) - light).mean(axis=0).sum() / light.sum()
    assert expected_noise(light, noise, gain, 4) == pytest.approx(off, rel=0.02)


@pytest.mark.parametrize("black", [0.0, 64.0])
def test_the_dark_level_is_what_dark_frames_show(plan: ScanPlan, black: float) -> None:
    """Rounded and cut off at zero, by the probabilities of a normal deviate."""
    from scipy.stats import norm

    sensor = replace(plan.camera.sensor, black_level=black, read_noise_e=20.0)
    camera = replace(plan.camera, sensor=sensor)
    values = np.arange(0, 200)
    edges = np.concatenate([[-np.inf], values[:-1] + 0.5, [np.inf]])
    shares = np.diff(norm.cdf(edges, black, 20.0 / sensor.electrons_per_count))
    assert dark_level(camera) == pytest.approx(float(shares @ values), abs=0.03)


@pytest.mark.long
def test_a_black_level_within_the_noise_is_said(plan: ScanPlan) -> None:
    low = replace(plan, camera=replace(plan.camera, sensor=replace(plan.camera.sensor, black_level=0.0)))
    said, silent = (measure_curve(PARTS.get("averaging"), Subject("p", p), 0.1).notes for p in (low, plan))
    assert "the black level of 0 is within the read noise" in said[-1] and len(said) == len(silent) + 1
