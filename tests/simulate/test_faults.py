"""Faults of the recorded light, on frames whose light is known."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.simulate import plan_effects
from lfcal.simulate.effects import Ghost, Saturation, SensorNonlinearity
from lfcal.simulate.sensor.camera_source import SimulatedCamera
from lfcal.simulate.sensor.noise import expose
from lfcal.simulate.staging import outlook_of
from tests.simulate.common import BASE, FAST, difference, small_camera, small_plan


@pytest.mark.few(2)
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
    row = plan_effects(plan, frames=True).row("nonlinearity")
    assert not row.on and "unknown for this camera" in row.reason
    asked = plan_effects(plan, overrides={"nonlinearity": "on"}).row("nonlinearity")
    assert not asked.on and "not on H" in asked.reason
    with pytest.raises(InputError, match="share"):
        SensorNonlinearity(0.6)


# -- ghosts --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1.0, 0.3, 2.5])
def test_a_point_s_ghost_lies_across_the_axis(scale: float) -> None:
    """A blot of light: its ghost's place and light, by the law of the mirrored, scaled and displaced image."""
    camera, px = small_camera(301, 401), small_camera().sensor.pixel_um
    light = np.zeros((301, 401), np.float32)
    light[180:190, 150:166] = 100.0
    effect = Ghost(0.1, scale, 12.0 * px, -7.0 * px)
    frame = expose(light, camera, (effect,), exposure_s=0.01).astype(float) - camera.sensor.black_level
    ghost = frame * camera.sensor.electrons_per_count - light
    assert ghost.sum() == pytest.approx(0.1 * light.sum(), rel=1e-3)
    row, column = camera.sensor.centre_px
    y, x = np.indices(ghost.shape)
    at = (ghost * y).sum() / ghost.sum(), (ghost * x).sum() / ghost.sum()
    wanted = row - scale * (184.5 - row) + 12, column - scale * (157.5 - column) - 7
    assert at == pytest.approx(wanted, abs=0.05)
    spread = np.sqrt((ghost * (x - at[1]) ** 2).sum() / ghost.sum())
    assert spread == pytest.approx(scale * 16 / np.sqrt(12), rel=0.1)


def test_a_mirrored_frame_is_exactly_that() -> None:
    """Of scale 1 about the middle of a sensor of odd sides, over several strips."""
    camera = small_camera(301, 401)
    light = np.random.default_rng(0).random((301, 401), np.float32)
    frame = expose(light, camera, (Ghost(1.0),), exposure_s=0.01).astype(float) - camera.sensor.black_level
    assert np.abs(frame * camera.sensor.electrons_per_count - light - light[::-1, ::-1]).max() < 1e-3


@pytest.mark.parametrize("ghost", [Ghost(0.5, 100.0, 1e9), Ghost(1.0, 0.01), Ghost(1.0, 100.0), Ghost(1.0, 1.0, -1e12)])
def test_extreme_ghosts_make_no_light(ghost: Ghost) -> None:
    camera = small_camera(140, 90)
    light = np.ones((140, 90), np.float32)
    frame = expose(light, camera, (ghost,), exposure_s=0.01).astype(float) - camera.sensor.black_level
    electrons = frame * camera.sensor.electrons_per_count
    assert np.isfinite(electrons).all() and electrons.min() > 0.99
    assert electrons.sum() <= (1 + ghost.share) * light.sum() * 1.001


def test_a_ghost_is_told_by_whether_it_meets_the_cutout() -> None:
    near, far = small_plan(), small_plan(4.0, small_camera(160, 800), anchor=(70.0, 640.0))
    for plan, meets in ((near, True), (far, False)):
        estimate = Ghost(0.05).estimate(outlook_of(plan, 0))
        camera = SimulatedCamera(plan, (*BASE, Ghost(0.05)), sampling=FAST)
        plain = SimulatedCamera(plan, BASE, sampling=FAST)
        _, y, x = camera.position(40)
        row, column = (round(a + d) for a, d in zip(plan.anchor, (y, x), strict=True))
        nt, ns = plan.cutout
        part = np.s_[row - nt // 2 : row + nt // 2 + 1, column - ns // 2 : column + ns // 2 + 1]
        black = plan.camera.sensor.black_level
        measured = difference(*(c.read(40)[part].astype(float) - black for c in (plain, camera)))
        assert 0.5 * measured <= estimate.error + 1e-9 and estimate.error <= 2 * measured + 1e-9
        assert (measured > 0.01) == meets and ("outside" in estimate.formula) == (not meets)
    row = plan_effects(far, effects=(Ghost(0.05),)).row("ghost")
    assert not row.on and "not on H" in row.reason
