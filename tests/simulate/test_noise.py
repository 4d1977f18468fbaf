"""The sensor: order of effects, statistics, reproducibility, and the honesty of their estimates."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan
from lfcal.simulate.effects import (
    ColourFilter,
    CosFourth,
    DarkCurrent,
    FixedPattern,
    FrameEffect,
    Quantisation,
    ReadNoise,
    Saturation,
    ShotNoise,
    StrayLight,
)
from lfcal.simulate.effects._poisson import poisson_quantile
from lfcal.simulate.sensor.camera_source import SimulatedCamera
from lfcal.simulate.sensor.noise import FrameKind, expose, random_numbers
from lfcal.simulate.staging import outlook_of
from tests.simulate.common import BASE, FAST, difference, small_camera, small_plan


def flat(level: float, rows: int = 300, columns: int = 200) -> tuple[np.ndarray, object]:
    return np.full((rows, columns), level, np.float32), small_camera(rows, columns)


def test_no_effects_scale_electrons_to_counts() -> None:
    light, camera = flat(1000.0)
    frame = expose(light, camera, (), exposure_s=0.02)  # type: ignore[arg-type]
    sensor = camera.sensor  # type: ignore[attr-defined]
    assert frame.dtype == np.float32
    assert np.allclose(frame, 1000.0 / sensor.electrons_per_count + sensor.black_level)


def test_statistics_of_the_noise() -> None:
    light, camera = flat(2000.0)
    gain = camera.sensor.electrons_per_count  # type: ignore[attr-defined]
    for effects, variance in (
        ((ShotNoise(),), 2000.0),
        ((ReadNoise(30.0),), 900.0),
        ((ShotNoise(), ReadNoise(30.0)), 2900.0),
        ((FixedPattern(0.02),), (0.02 * 2000) ** 2),
        ((FixedPattern(0.0, 12.0),), 144.0),
        ((DarkCurrent(1e4), ShotNoise()), 2200.0),
    ):
        frame = expose(light, camera, effects, exposure_s=0.02, seed=4)  # type: ignore[arg-type]
        electrons = (frame.astype(float) - 64.0) * gain
        count = electrons.size
        assert electrons.var() == pytest.approx(variance, rel=5 * math.sqrt(2 / count)), effects
        mean = 2200.0 if isinstance(effects[0], DarkCurrent) else 2000.0
        assert electrons.mean() == pytest.approx(mean, abs=5 * math.sqrt(variance / count))
    excess = (electrons - electrons.mean()) ** 3
    assert excess.mean() > 0, "Poisson deviates are skewed"


def test_shot_noise_of_faint_light_is_whole_electrons() -> None:
    light, camera = flat(0.3)
    electrons = (expose(light, camera, (ShotNoise(),), exposure_s=1.0) - 64.0) * camera.sensor.electrons_per_count  # type: ignore[arg-type, attr-defined]
    assert np.allclose(electrons, np.rint(electrons), atol=1e-2)
    assert (np.rint(electrons) == 0).mean() == pytest.approx(math.exp(-0.3), abs=0.01)


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
    """Read noise is the same whatever shot noise drew before it; a pixel's noise does not depend on its neighbours."""
    light, camera = flat(900.0)
    read = expose(light, camera, (ReadNoise(),), exposure_s=0.02)  # type: ignore[arg-type]
    shot = expose(light, camera, (ShotNoise(),), exposure_s=0.02)  # type: ignore[arg-type]
    both = expose(light, camera, (ShotNoise(), ReadNoise()), exposure_s=0.02)  # type: ignore[arg-type]
    clean = expose(light, camera, (), exposure_s=0.02)  # type: ignore[arg-type]
    assert np.allclose(both - shot, read - clean, atol=1e-3)
    other = light.copy()
    other[0, :50] = 5.0
    changed = expose(other, camera, (ShotNoise(),), exposure_s=0.02)  # type: ignore[arg-type]
    assert np.array_equal(changed[1:], shot[1:]) and np.array_equal(changed[0, 50:], shot[0, 50:])


def test_fixed_pattern_is_fixed_and_noise_is_not() -> None:
    light, camera = flat(500.0)
    common = {"exposure_s": 0.02, "seed": 9}
    pattern = [expose(light, camera, (FixedPattern(0.05),), index=k, **common) for k in (0, 7)]  # type: ignore[arg-type]
    assert np.array_equal(pattern[0], pattern[1])
    assert not np.array_equal(pattern[0], expose(light, camera, (FixedPattern(0.05),), exposure_s=0.02, seed=10))  # type: ignore[arg-type]
    noise = [expose(light, camera, (ReadNoise(5.0),), index=k, **common) for k in (0, 7)]  # type: ignore[arg-type]
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.02
    strips = noise[0][:128] - noise[0][128:256]
    assert np.abs(strips).max() > 0, "strips must not repeat"


def test_frames_are_the_same_in_any_order_and_thread() -> None:
    light, camera = flat(300.0)
    effects = (ShotNoise(), ReadNoise(), FixedPattern(), Quantisation())

    def frame(k: int) -> bytes:
        return expose(light, camera, effects, exposure_s=0.02, seed=1, index=k).tobytes()  # type: ignore[arg-type]

    one = [frame(k) for k in range(6)]
    with ThreadPoolExecutor(3) as pool:
        assert list(pool.map(frame, reversed(range(6)))) == one[::-1]
    assert len(set(one)) == 6
    assert random_numbers(1, FrameKind.LIGHT, 2).random() != random_numbers(1, FrameKind.DARK, 2).random()


def test_order_of_effects_is_that_of_the_light() -> None:
    light, camera = flat(3e4)
    top = camera.sensor.max_value  # type: ignore[attr-defined]
    effects = (Quantisation(), ReadNoise(40.0), Saturation(), ShotNoise())
    frame = expose(light, camera, effects, exposure_s=0.02)  # type: ignore[arg-type]
    assert frame.dtype == np.uint16 and frame.max() == top
    assert (frame < top).mean() == pytest.approx(0.5, abs=0.05), "read noise comes after the full well"


def test_quantisation_never_wraps() -> None:
    light, camera = flat(0.0)
    light[:150] = 1e9
    light[150:200] = -1e9
    frame = expose(light, camera, (Quantisation(),), exposure_s=0.02)  # type: ignore[arg-type]
    assert (frame[:150] == camera.sensor.max_value).all() and (frame[150:200] == 0).all()  # type: ignore[attr-defined]
    assert (frame[200:] == 64).all()


def test_colour_filter_follows_the_sensor() -> None:
    camera = small_camera(301, 200, cfa="GRBG")
    light = np.full((301, 200), 1000.0, np.float32)
    electrons = (expose(light, camera, (ColourFilter(),), exposure_s=0.02) - 64.0) * camera.sensor.electrons_per_count
    green = np.zeros((301, 200), bool)
    green[::2, ::2] = green[1::2, 1::2] = True
    assert np.allclose(electrons[green], 1000.0, atol=0.1) and np.allclose(electrons[~green], 30.0, atol=0.1)


def test_cos_fourth_is_one_on_the_axis_and_even() -> None:
    camera = small_camera(301, 201)
    gain = CosFourth().gain(camera, 0, 301)
    assert gain[150, 100] == 1 and np.array_equal(gain, gain[::-1, ::-1])
    b = camera.optics.image_distance_um  # type: ignore[union-attr]
    corner = math.hypot(150, 100) * camera.sensor.pixel_um
    assert gain[0, 0] == pytest.approx(math.cos(math.atan(corner / b)) ** 4, rel=1e-6)
    assert np.array_equal(CosFourth().gain(camera, 128, 20), gain[128:148])


def test_stray_light_keeps_all_light() -> None:
    light = np.zeros((300, 200), np.float32)
    light[40, 50] = 1e4
    camera = small_camera(300, 200)
    frame = expose(light, camera, (StrayLight(0.05),), exposure_s=0.02)
    electrons = (frame.astype(float) - 64.0) * camera.sensor.electrons_per_count
    assert electrons.sum() == pytest.approx(1e4, rel=1e-3) and electrons[40, 50] == pytest.approx(9500.0, rel=1e-3)


def test_light_must_cover_the_sensor() -> None:
    with pytest.raises(InputError, match="every pixel of the sensor"):
        expose(np.zeros((3, 3), np.float32), small_camera(), (), exposure_s=0.02)


# -- estimates ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scenes() -> dict[float, tuple[ScanPlan, np.ndarray]]:
    """Noise-free light of a few frames, at two depths."""
    out = {}
    for v in (4.0, -3.0):
        plan = small_plan(v, small_camera(180, 180))
        camera = SimulatedCamera(plan, BASE, sampling=FAST)
        out[v] = (plan, np.stack([camera.light(k) for k in (0, 150, 320, 500)]))
    return out


FRAME_EFFECTS: list[tuple[FrameEffect, float]] = [
    (ShotNoise(), 1.0),
    (ReadNoise(), 1.0),
    (ReadNoise(2.0), 1.0),
    (FixedPattern(), 1.0),
    (DarkCurrent(20.0), 1.0),
    (StrayLight(0.02), 1.0),
    (Quantisation(), 1.0),
    (Saturation(), 3.0),
]


@pytest.mark.parametrize("v", [4.0, -3.0])
@pytest.mark.parametrize(("effect", "over"), FRAME_EFFECTS, ids=lambda p: repr(p))
@pytest.mark.few(8)
def test_frame_estimates_are_honest(
    scenes: dict[float, tuple[ScanPlan, np.ndarray]], v: float, effect: FrameEffect, over: float
) -> None:
    plan, light = scenes[v]
    camera, outlook = plan.camera, outlook_of(plan, 0, peak=0.8 * over)
    half = plan.cutout[0] // 2
    measured = []
    for k, one in zip((0, 150, 320, 500), light, strict=True):
        row, column = plan.image_px(plan.order_indices()[k]).astype(int)
        cut = slice(row - half, row + half + 1), slice(column - half, column + half + 1)
        frames = [
            expose(one * np.float32(over), camera, effects, exposure_s=plan.exposures[0], index=k)[cut]
            - camera.sensor.black_level
            for effects in ((), (effect,))
        ]
        measured.append(difference(frames[0], frames[1]))
    estimate = effect.estimate(outlook)
    assert 0.5 * np.mean(measured) <= estimate.error <= 2 * np.mean(measured), (np.mean(measured), estimate)


def test_cos_fourth_estimate_at_the_edge_of_a_wide_sensor() -> None:
    plan = small_plan(4.0, small_camera(180, 9000), anchor=(80.0, 8900.0))
    light = SimulatedCamera(plan, BASE, sampling=FAST).light(10)
    frames = [expose(light, plan.camera, e, exposure_s=0.02) - 64.0 for e in ((), (CosFourth(),))]
    estimate = CosFourth().estimate(outlook_of(plan, 0)).error
    assert estimate > 0.05 and 0.5 * estimate <= difference(frames[0], frames[1]) <= 2 * estimate


def test_colour_filter_estimate() -> None:
    plan = small_plan(4.0, small_camera(180, 180, cfa="GRBG"))
    light = SimulatedCamera(plan, BASE, sampling=FAST).light(10)
    frames = [expose(light, plan.camera, e, exposure_s=0.02) - 64.0 for e in ((), (ColourFilter(),))]
    estimate = ColourFilter().estimate(outlook_of(plan, 0)).error
    assert 0.5 * estimate <= difference(frames[0], frames[1]) <= 2 * estimate
