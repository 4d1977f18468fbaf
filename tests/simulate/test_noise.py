"""The sensor: order of effects, statistics, reproducibility, stated noise; nonlinearity and ghosts on known light."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base import InputError
from lfcal.camera import Camera, ScanPlan, preset
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view
from lfcal.psf import Cutout, assemble
from lfcal.simulate import SimulatedCamera, expose, outlook_of, plan_effects
from lfcal.simulate import effects as fx
from lfcal.simulate.effects._poisson import poisson_quantile
from lfcal.simulate.sensor import FrameKind
from lfcal.simulate.sensor.noise import random_numbers
from tests.simulate.common import BASE, FAST, difference, small_camera, small_plan


def flat(level: float, rows: int = 300, columns: int = 200) -> tuple[np.ndarray, Camera]:
    return np.full((rows, columns), level, np.float32), small_camera(rows, columns)


def test_electrons_are_scaled_to_counts_and_faint_light_is_whole_electrons() -> None:
    light, camera = flat(1000.0)
    frame, sensor = expose(light, camera, (), exposure_s=0.02), camera.sensor
    assert frame.dtype == np.float32 and np.allclose(frame, 1000.0 / sensor.electrons_per_count + sensor.black_level)
    electrons = seen(flat(0.3)[0], camera, fx.ShotNoise())
    assert np.allclose(electrons, np.rint(electrons), atol=1e-2)
    assert (np.rint(electrons) == 0).mean() == pytest.approx(math.exp(-0.3), abs=0.01)


def test_statistics_of_the_noise() -> None:
    light, camera = flat(2000.0)
    gain = camera.sensor.electrons_per_count
    for effects, variance in (
        ((fx.ShotNoise(),), 2000.0),
        ((fx.ReadNoise(30.0),), 900.0),
        ((fx.ShotNoise(), fx.ReadNoise(30.0)), 2900.0),
        ((fx.FixedPattern(0.02),), (0.02 * 2000) ** 2),
        ((fx.FixedPattern(0.0, 12.0),), 144.0),
        ((fx.DarkCurrent(1e4), fx.ShotNoise()), 2200.0),
    ):
        frame = expose(light, camera, effects, exposure_s=0.02, seed=4)
        electrons = (frame.astype(float) - 64.0) * gain
        count = electrons.size
        assert electrons.var() == pytest.approx(variance, rel=5 * math.sqrt(2 / count)), effects
        mean = 2200.0 if isinstance(effects[0], fx.DarkCurrent) else 2000.0
        assert electrons.mean() == pytest.approx(mean, abs=5 * math.sqrt(variance / count))
    excess = (electrons - electrons.mean()) ** 3
    assert excess.mean() > 0, "Poisson deviates are skewed"


def test_poisson_quantiles_against_scipy() -> None:
    from scipy.stats import poisson

    rng = np.random.default_rng(0)
    share = rng.random(4000)
    for mean in (0.0, 0.02, 0.9, 7.0, 59.9):
        assert np.array_equal(poisson_quantile(np.full(4000, mean), share), poisson.ppf(share, mean).clip(0))
    for mean in (60.5, 300.0, 15000.0):
        off = poisson_quantile(np.full(4000, mean), share) - poisson.ppf(share, mean)
        assert np.abs(off).max() <= 1 and (off != 0).mean() < 0.01
    assert not poisson_quantile(np.array([-3.0, np.float32(0)]), np.array([0.5, 0.999])).any()


def test_effects_do_not_share_random_numbers() -> None:
    """Read noise does not depend on shot noise, and a pixel's noise does not depend on its neighbours."""
    light, camera = flat(900.0)

    def frame(*effects: fx.FrameEffect, light: np.ndarray = light) -> np.ndarray:
        return expose(light, camera, effects, exposure_s=0.02)

    shot = frame(fx.ShotNoise())
    assert np.allclose(frame(fx.ShotNoise(), fx.ReadNoise()) - shot, frame(fx.ReadNoise()) - frame(), atol=1e-3)
    other = light.copy()
    other[0, :50] = 5.0
    changed = frame(fx.ShotNoise(), light=other)
    assert random_numbers(1, FrameKind.LIGHT, 2).random() != random_numbers(1, FrameKind.DARK, 2).random()
    assert np.array_equal(changed[1:], shot[1:]) and np.array_equal(changed[0, 50:], shot[0, 50:])


def test_fixed_pattern_is_fixed_and_noise_is_not() -> None:
    light, camera = flat(500.0)

    def frame(effect: fx.FrameEffect, index: int = 0, seed: int = 9) -> np.ndarray:
        return expose(light, camera, (effect,), exposure_s=0.02, seed=seed, index=index)

    pattern = frame(fx.FixedPattern(0.05))
    assert np.array_equal(pattern, frame(fx.FixedPattern(0.05), 7))
    assert not np.array_equal(pattern, frame(fx.FixedPattern(0.05), seed=10))
    noise = [frame(fx.ReadNoise(5.0), k) for k in (0, 7)]
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.02
    assert np.abs(noise[0][:128] - noise[0][128:256]).max() > 0, "strips must not repeat"


def test_order_of_effects_is_that_of_the_light() -> None:
    light, camera = flat(3e4)
    top = camera.sensor.max_value
    effects = (fx.Quantisation(), fx.ReadNoise(40.0), fx.Saturation(), fx.ShotNoise())
    frame = expose(light, camera, effects, exposure_s=0.02)
    assert frame.dtype == np.uint16 and frame.max() == top
    assert (frame < top).mean() == pytest.approx(0.5, abs=0.05), "read noise comes after the full well"


def test_quantisation_never_wraps() -> None:
    light, camera = flat(0.0)
    light[:150] = 1e9
    light[150:200] = -1e9
    frame = expose(light, camera, (fx.Quantisation(),), exposure_s=0.02)
    assert (frame[:150] == camera.sensor.max_value).all() and (frame[150:200] == 0).all()
    assert (frame[200:] == 64).all()


def test_colour_filter_follows_the_sensor() -> None:
    camera = small_camera(301, 200, cfa="GRBG")
    light = np.full((301, 200), 1000.0, np.float32)
    electrons = (
        expose(light, camera, (fx.ColourFilter(),), exposure_s=0.02) - 64.0
    ) * camera.sensor.electrons_per_count
    green = np.zeros((301, 200), bool)
    green[::2, ::2] = green[1::2, 1::2] = True
    assert np.allclose(electrons[green], 1000.0, atol=0.1) and np.allclose(electrons[~green], 30.0, atol=0.1)


def test_cos_fourth_is_one_on_the_axis_and_even() -> None:
    camera = small_camera(301, 201)
    gain = fx.CosFourth().gain(camera, 0, 301)
    assert gain[150, 100] == 1 and np.array_equal(gain, gain[::-1, ::-1])
    b = camera.optics.image_distance_um
    corner = math.hypot(150, 100) * camera.sensor.pixel_um
    assert gain[0, 0] == pytest.approx(math.cos(math.atan(corner / b)) ** 4, rel=1e-6)
    assert np.array_equal(fx.CosFourth().gain(camera, 128, 20), gain[128:148])


def test_stray_light_keeps_all_light() -> None:
    light, camera = np.zeros((300, 200), np.float32), small_camera(300, 200)
    light[40, 50] = 1e4
    electrons = seen(light, camera, fx.StrayLight(0.05))
    assert electrons.sum() == pytest.approx(1e4, rel=1e-3) and electrons[40, 50] == pytest.approx(9500.0, rel=1e-3)
    with pytest.raises(InputError, match="every pixel of the sensor"):
        expose(light[:3, :3], camera, (), exposure_s=0.02)


def seen(light: np.ndarray, camera: Camera, *effects: fx.FrameEffect) -> np.ndarray:
    """Return a frame in electrons."""
    frame = expose(light, camera, effects, exposure_s=0.01).astype(float)
    return (frame - camera.sensor.black_level) * camera.sensor.electrons_per_count


def test_a_nonlinear_sensor_reads_what_the_curve_says() -> None:
    """In electrons before the gain: half full, and 3 % missing at full well, are 1.5 % missing."""
    camera = small_camera(40, 40, read_noise_e=0.0)
    full = camera.sensor.full_well_e
    light = np.full((40, 40), 0.5 * full, np.float32)
    light[0, :4] = 0.0, full, 3 * full, 1.0
    for effects, most in (((fx.SensorNonlinearity(0.03),), 3), ((fx.SensorNonlinearity(0.03), fx.Saturation()), 1)):
        electrons = seen(light, camera, *effects)
        assert electrons[20, 20] == pytest.approx(0.5 * full * 0.985, rel=1e-5)
        assert electrons[0, 0] == pytest.approx(0.0, abs=1e-2) and electrons[0, 1] == pytest.approx(0.97 * full)
        assert electrons[0, 2] == pytest.approx(0.97 * full * most, rel=1e-5)
    ramp = np.linspace(0, 2 * full, 1600, dtype=np.float32).reshape(40, 40)
    for share in (-0.5, 0.5):
        assert (np.diff(seen(ramp, camera, fx.SensorNonlinearity(share)).ravel()) >= 0).all()


@pytest.mark.parametrize("scale", [1.0, 0.3, 2.5])
def test_a_point_s_ghost_lies_across_the_axis(scale: float) -> None:
    """A blot of light: its ghost's place and light, by the law of the mirrored, scaled and displaced image."""
    camera, px = small_camera(301, 401), small_camera().sensor.pixel_um
    light = np.zeros((301, 401), np.float32)
    light[180:190, 150:166] = 100.0
    ghost = seen(light, camera, fx.Ghost(0.1, scale, 12.0 * px, -7.0 * px)) - light
    assert ghost.sum() == pytest.approx(0.1 * light.sum(), rel=1e-3)
    row, column = camera.sensor.centre_px
    y, x = np.indices(ghost.shape)
    at = (ghost * y).sum() / ghost.sum(), (ghost * x).sum() / ghost.sum()
    assert at == pytest.approx((row - scale * (184.5 - row) + 12, column - scale * (157.5 - column) - 7), abs=0.05)
    spread = np.sqrt((ghost * (x - at[1]) ** 2).sum() / ghost.sum())
    assert spread == pytest.approx(scale * 16 / np.sqrt(12), rel=0.1)


def test_ghosts_mirror_the_frame_and_add_no_more_light_than_their_share() -> None:
    """Of scale 1 about the middle of a sensor of odd sides, over several strips."""
    camera, light = small_camera(301, 401), np.random.default_rng(0).random((301, 401), np.float32)
    assert np.abs(seen(light, camera, fx.Ghost(1.0)) - light - light[::-1, ::-1]).max() < 1e-3
    even = np.ones((140, 90), np.float32)
    for ghost in (fx.Ghost(0.5, 100.0, 1e9), fx.Ghost(1.0, 0.01), fx.Ghost(1.0, 100.0), fx.Ghost(1.0, 1.0, -1e12)):
        electrons = seen(even, small_camera(140, 90), ghost)
        assert np.isfinite(electrons).all() and electrons.min() > 0.99, ghost
        assert electrons.sum() <= (1 + ghost.share) * even.sum() * 1.001


def ghost_plans() -> tuple[ScanPlan, ScanPlan]:
    """Return a plan whose ghosts meet the cutout, and one whose ghosts lie outside."""
    return small_plan(), small_plan(4.0, small_camera(160, 800), anchor=(70.0, 640.0))


def test_the_estimate_of_a_ghost_depends_on_whether_it_meets_the_cutout() -> None:
    near, far = (fx.Ghost(0.05).estimate(outlook_of(plan, 0)) for plan in ghost_plans())
    assert "outside" not in near.formula and "outside" in far.formula


@pytest.mark.long
def test_the_estimate_of_a_ghost_is_right_within_a_factor_of_two() -> None:
    near, far = ghost_plans()
    for plan, meets in ((near, True), (far, False)):
        estimate = fx.Ghost(0.05).estimate(outlook_of(plan, 0))
        cameras = [SimulatedCamera(plan, effects, sampling=FAST) for effects in (BASE, (*BASE, fx.Ghost(0.05)))]
        _, y, x = cameras[0].position(40)
        row, column = (round(a + d) for a, d in zip(plan.anchor, (y, x), strict=True))
        nt, ns = plan.cutout
        part = np.s_[row - nt // 2 : row + nt // 2 + 1, column - ns // 2 : column + ns // 2 + 1]
        measured = difference(*(c.read(40)[part].astype(float) - plan.camera.sensor.black_level for c in cameras))
        assert 0.5 * measured <= estimate.error + 1e-9 and estimate.error <= 2 * measured + 1e-9
        assert (measured > 0.01) == meets and ("outside" in estimate.formula) == (not meets)


def test_effects_on_frames_are_no_part_of_h() -> None:
    plan = small_plan(cutout=31)
    row = plan_effects(plan, frames=True).row("nonlinearity")
    assert not row.on and "unknown for this camera" in row.reason
    for row in (
        plan_effects(plan, overrides={"nonlinearity": "on"}).row("nonlinearity"),
        plan_effects(plan, effects=(fx.Ghost(0.05),)).row("ghost"),
    ):
        assert not row.on and "not on H" in row.reason


REPEATS = 60


def camera_of(*effects: fx.FrameEffect) -> SimulatedCamera:
    bench = preset("bench")
    camera = replace(bench, sensor=replace(bench.sensor, shape=(80, 90), read_noise_e=12.0))
    plan = ScanPlan.for_camera(camera, virtual_depths=[4.0], cutout=31, exposure_s=0.05)
    return SimulatedCamera(plan, effects, level="geometric", seed=1)


@pytest.mark.parametrize("rounded", [True, False])
def test_repeated_frames_scatter_as_stated_at_every_level(rounded: bool) -> None:
    effects = (fx.FixedPattern(), fx.DarkCurrent(2000.0), fx.ShotNoise(), fx.Saturation(), fx.ReadNoise())
    effects += (fx.Quantisation(),) if rounded else ()
    source = camera_of(*effects)
    light = source.light(0)
    frames = np.stack([expose(light, source.camera, effects, exposure_s=0.05, seed=1, index=k) for k in range(REPEATS)])
    noise = source.metadata.noise
    measured, stated = frames.var(axis=0, ddof=1), noise.variance(frames.mean(axis=0))
    for part in np.array_split(np.argsort(light.ravel()), 5):
        chance = np.sqrt(2 / (REPEATS - 1) / part.size)
        assert (measured / stated).ravel()[part].mean() == pytest.approx(1, abs=4 * chance + 0.01)
    facts = replace(source.metadata, plan=None, plan_shape=None)
    raw = ArraySource(frames, [(0, 0, 0)] * REPEATS, metadata=facts)
    view = corrected_view(raw, CorrectionRecipe(black_level=64.0))
    cutout = Cutout((31, 31), (39.0, 44.0))
    single = np.stack([view.read(k)[24:55, 29:60] for k in range(REPEATS)])
    mean = assemble(view, (1, 1, 1), cutout).matrix
    of_mean = mean.variance(0, 0, 0)
    assert of_mean is not None
    assert (single.var(axis=0, ddof=1) / of_mean).mean() == pytest.approx(REPEATS, rel=0.03)


def test_a_camera_without_noise_states_none() -> None:
    noise = camera_of(fx.Saturation()).metadata.noise
    assert noise.constant == noise.slope == 0
    rounding = camera_of(fx.Quantisation()).metadata.noise
    assert rounding.constant == pytest.approx(1 / 12) and rounding.slope == 0
