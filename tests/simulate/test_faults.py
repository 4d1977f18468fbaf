"""Faults of the recorded light, on frames whose light is known."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.errors import InputError
from lfcal.simulate import plan_effects
from lfcal.simulate.effects import Saturation, SensorNonlinearity
from lfcal.simulate.sensor.camera_source import SimulatedCamera
from lfcal.simulate.sensor.noise import expose
from lfcal.simulate.staging import outlook_of
from tests.simulate.common import BASE, FAST, difference, small_camera, small_plan


@pytest.mark.parametrize("v", [4.0, -3.0, 2.2])
@pytest.mark.parametrize("share", [0.02, -0.1])
def test_estimate_of_nonlinearity(v: float, share: float) -> None:
    plan, effect = small_plan(v), SensorNonlinearity(share)
    frames = [
        SimulatedCamera(plan, (*BASE, *more), sampling=FAST).read(40).astype(float) - plan.camera.sensor.black_level
        for more in ((), (effect,))
    ]
    measured = difference(*frames)
    assert 0.5 * measured <= effect.estimate(outlook_of(plan, 0)).error <= 2 * measured


def test_a_bent_sensor_reads_what_the_curve_says() -> None:
    """In electrons before the gain: half full, and 3 % missing at full well, are 1.5 % missing."""
    camera = small_camera(40, 40, read_noise_e=0.0)
    full = camera.sensor.full_well_e
    light = np.full((40, 40), 0.5 * full, np.float32)
    light[0, :4] = 0.0, full, 3 * full, 1.0
    for effects in ((SensorNonlinearity(0.03),), (SensorNonlinearity(0.03), Saturation())):
        counts = expose(light, camera, effects, exposure_s=0.01).astype(float) - camera.sensor.black_level
        electrons = counts * camera.sensor.electrons_per_count
        assert electrons[20, 20] == pytest.approx(0.5 * full * 0.985, rel=1e-5)
        assert electrons[0, 0] == pytest.approx(0.0, abs=1e-2) and electrons[0, 1] == pytest.approx(0.97 * full)
        assert electrons[0, 2] == pytest.approx(0.97 * full * (3 if len(effects) == 1 else 1), rel=1e-5)
    steep = [SensorNonlinearity(q) for q in (-0.5, 0.5)]
    for effect in steep:
        ramp = np.linspace(0, 2 * full, 1600, dtype=np.float32).reshape(40, 40)
        assert (np.diff(expose(ramp, camera, (effect,), exposure_s=0.01).astype(float).ravel()) >= 0).all()


def test_nonlinearity_is_no_part_of_h_and_off_by_itself() -> None:
    plan = small_plan(cutout=31)
    row = plan_effects(plan.camera, plan, frames=True).row("nonlinearity")
    assert not row.on and "not known of this camera" in row.reason
    asked = plan_effects(plan.camera, plan, overrides={"nonlinearity": "on"}).row("nonlinearity")
    assert not asked.on and "not on H" in asked.reason
    with pytest.raises(InputError, match="share"):
        SensorNonlinearity(0.6)
