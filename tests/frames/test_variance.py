"""The variance that a source states of its samples is that of repeated frames, through every correction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.camera import ScanPlan, preset
from lfcal.frames import ArraySource, CorrectionChain, Dark, Exposure, White, corrected
from lfcal.frames.aligned import ShiftedSource
from lfcal.frames.corrections.steps import Background
from lfcal.frames.described import DescribedSource, sensor_noise, stated_noise
from lfcal.frames.source import Noise
from tests.frames.photon_transfer.sensor_model import Truth, micro_images, vignetting

SHAPE = (60, 80)
REPEATS = 160
SENSOR = Truth(gain=0.2, read_e=8.0, black=64.0, dsnu_e=0.0, prnu=0.0, dark_e_s=40.0, shape=SHAPE)
NOISE = Noise((8 * 0.2) ** 2 + 1 / 12, 0.2, 64.0)
SCENE = 0.8 * SENSOR.full_e * micro_images(SHAPE)


def plan_of(marks: dict[str, str] | None = None, **sensor: object) -> ScanPlan:
    bench = preset("bench")
    values = {"shape": SHAPE, "bit_depth": 12, "black_level": 64.0, "read_noise_e": 8.0, "full_well_e": 4031 / 0.2}
    camera = replace(bench, sensor=replace(bench.sensor, **(values | sensor)), marks=bench.marks)
    marked = camera.marks
    for path, mark in (marks or {}).items():
        marked = marked.marked([path], mark)
    return ScanPlan.for_camera(replace(camera, marks=marked), virtual_depths=[3.0], cutout=21)


def excess(values: np.ndarray, predicted: np.ndarray, light: np.ndarray, levels: int = 4) -> np.ndarray:
    """Return measured over predicted variance of pixels of like light, ``(levels,)``; 1 for a true prediction."""
    order = np.array_split(np.argsort(light.ravel()), levels)
    ratio = (values.var(axis=0, ddof=1) / predicted).ravel()
    return np.array([ratio[part].mean() for part in order])


@pytest.mark.parametrize("exposure_s", [0.5, 2.0])
def test_dark_white_exposure_and_background_pass_the_variance_on_pixel_by_pixel(exposure_s: float) -> None:
    """Every repeat with a dark of its own, so that the darks' noise shows; the white changes from pixel to pixel."""
    white = White(1000 * vignetting(SHAPE, 0.8) ** 2, 0.0, floor=0.1)
    values, predicted = [], []
    for k in range(REPEATS):
        darks = SENSOR.darks(3, exposure_s, key=50_000 + 10 * k)
        chain = CorrectionChain(
            (Dark(np.mean(darks, axis=0), count=3), white, Exposure(1.0), Background("constant", 3.0))
        )
        frame = SENSOR.frame(SCENE, exposure_s, key=k)
        raw = ArraySource(frame[None], [(0, 0, 0)], exposures_s=[exposure_s], metadata={"noise": NOISE})
        found = corrected(raw, chain).samples(0)
        assert found.noise is not None
        values.append(found.values)
        predicted.append(found.noise.variance(found.values))
    ratios = excess(np.array(values), np.mean(predicted, axis=0), SCENE)
    chance = np.sqrt(2 / (REPEATS - 1) / (np.prod(SHAPE) / 4))
    np.testing.assert_allclose(ratios, 1.0, atol=0.01 + 4 * chance)
    # the counter-test: without the darks' own noise and the pixels' own gains the dim quarter is far off
    assert abs(excess(np.array(values), np.full(SHAPE, np.mean(predicted)), SCENE)[0] - 1) > 0.5


def test_black_is_no_light() -> None:
    """Raw samples count from zero, light from the black level: 64 counts of black have no photon noise."""
    frames = np.array([SENSOR.frame(0.0, key=k) for k in range(40)])
    source = ArraySource(frames, [(0, 0, k) for k in range(40)], metadata={"noise": NOISE})
    noise = source.samples(0).noise
    assert noise is not None
    # noise above the black level is taken for light: sqrt(1/2 pi) of it on the mean, which is 5 % here
    assert frames.var(axis=0, ddof=1).mean() == pytest.approx(noise.variance(frames[0]).mean(), rel=0.08)
    level = corrected(source, CorrectionChain((Dark(level=64.0),))).samples(0)
    assert level.noise is not None and level.noise.constant == pytest.approx(NOISE.constant)
    assert level.noise.variance(level.values).mean() == pytest.approx(frames.var(axis=0, ddof=1).mean(), rel=0.08)


def test_a_hot_pixel_brings_its_own_photon_noise() -> None:
    dark = np.full(SHAPE, 64.0, np.float32)
    dark[3, 4] = 1064.0
    for black in (64.0, None):
        source = ArraySource(
            np.full((1, *SHAPE), 1100, np.uint16), [(0, 0, 0)], metadata={"noise": NOISE._replace(black=black)}
        )
        noise = corrected(source, CorrectionChain((Dark(dark),))).samples(0).noise
        assert noise is not None and isinstance(noise.constant, np.ndarray)
        assert noise.constant[3, 4] == pytest.approx(NOISE.constant + 0.2 * 1000)
        assert noise.constant[0, 0] == pytest.approx(NOISE.constant), "black without a known level is no light either"


def test_assumed_noise_is_not_stated() -> None:
    raw = ArraySource(np.full((1, *SHAPE), 100, np.uint16), [(0, 0, 0)])
    stated = DescribedSource(raw, plan_of()).samples(0).noise
    assert stated == sensor_noise(plan_of().camera.sensor) == stated_noise(plan_of().camera)
    for path in ("sensor.read_noise_e", "sensor.full_well_e"):
        assert DescribedSource(raw, plan_of({path: "assumed"})).samples(0).noise is None
        assert DescribedSource(raw, plan_of({path: "measured"})).samples(0).noise == stated


def test_saturation_below_the_highest_value_is_the_sensors() -> None:
    raw = np.full((1, *SHAPE), 100, np.uint16)
    raw[0, 1, 2:6] = 3000, 3001, 3500, 4095
    source = DescribedSource(ArraySource(raw, [(0, 0, 0)]), plan_of(saturation=3001.0))
    found = source.samples(0)
    assert found.saturated == 3 and source.metadata.saturation == 3001.0
    assert found.valid is not None and found.valid[1, 2] and not found.valid[1, 3]


def test_left_aligned_noise_is_moved_down_with_the_samples() -> None:
    raw = ArraySource(np.full((1, 4, 4), 1600, np.uint16), [(0, 0, 0)], metadata={"noise": NOISE.scaled(16.0)})
    noise = ShiftedSource(raw, 4).samples(0).noise
    assert noise is not None and (noise.constant, noise.slope, noise.black) == pytest.approx(NOISE)
