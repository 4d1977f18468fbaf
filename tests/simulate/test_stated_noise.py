"""The noise that the simulated camera states is that of its frames, from frame to H."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.camera import ScanPlan, preset
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view
from lfcal.psf import assemble
from lfcal.psf.cutout import Cutout
from lfcal.simulate import expose
from lfcal.simulate.effects import DarkCurrent, FixedPattern, Quantisation, ReadNoise, Saturation, ShotNoise
from lfcal.simulate.effects.base import FrameEffect
from lfcal.simulate.sensor.camera_source import SimulatedCamera

REPEATS = 80


def camera_of(*effects: FrameEffect) -> SimulatedCamera:
    bench = preset("bench")
    camera = replace(bench, sensor=replace(bench.sensor, shape=(80, 90), read_noise_e=12.0))
    plan = ScanPlan.for_camera(camera, virtual_depths=[4.0], cutout=31, exposure_s=0.05)
    return SimulatedCamera(plan, effects, level="geometric", seed=1)


@pytest.mark.parametrize("rounded", [True, False])
def test_repeated_frames_scatter_as_stated_at_every_level(rounded: bool) -> None:
    effects = (FixedPattern(), DarkCurrent(2000.0), ShotNoise(), Saturation(), ReadNoise())
    effects += (Quantisation(),) if rounded else ()
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
    noise = camera_of(Saturation()).metadata.noise
    assert noise.constant == noise.slope == 0
    rounding = camera_of(Quantisation()).metadata.noise
    assert rounding.constant == pytest.approx(1 / 12) and rounding.slope == 0
