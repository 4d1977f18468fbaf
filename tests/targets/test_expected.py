"""What noise leaves of a pattern, against the number of frames: held against frames with noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.simulate.accuracy.planner import plan_effects
from lfcal.simulate.sensor.camera_source import SimulatedCamera
from lfcal.simulate.sensor.noise import FrameKind
from lfcal.targets import Target, Wishes, error_forecast, plan_target
from lfcal.targets.expected import TOLERANCE, noise_share
from tests.targets.common import scan_of, small

SCAN = scan_of(small(160))


def test_the_share_of_noise_is_that_of_exposed_frames() -> None:
    noise = {"shot_noise": "on", "read_noise": "on"}
    effects = plan_effects(SCAN, TOLERANCE, noise, frames=True, peak=0.8).effects
    camera = SimulatedCamera(SCAN, effects, tolerance=TOLERANCE)
    sensor, shares = SCAN.camera.sensor, []
    for index in (0, 60, 130, 200, 250):
        light = camera.light(index)
        row, column = np.floor(np.array(camera.image_px(index)) + 0.5).astype(int)
        box = np.s_[row - 15 : row + 16, column - 15 : column + 16]
        frame = camera.expose(light, SCAN.exposures[0], FrameKind.LIGHT, index)[box].astype(float)
        electrons = (frame - sensor.black_level) * sensor.electrons_per_count
        shares.append(np.abs(electrons - light[box]).sum() / light[box].sum())
    # rounding to counts and the sensor's other traits are no part of it
    assert noise_share(SCAN, 0) == pytest.approx(np.mean(shares), rel=0.1)


def test_means_of_frames_are_better_by_their_root() -> None:
    four = replace(SCAN, frames_averaged=4)
    assert noise_share(four, 0) == pytest.approx(noise_share(SCAN, 0) / 2, rel=1e-6)


def test_error_and_coverage_against_frames() -> None:
    step = SCAN.camera.step_um(SCAN.depths_um[0])
    target = Target("square", (3, 3), (41 * step, 43 * step))
    plan = plan_target(SCAN, target, Wishes(most_frames=12, level="geometric"))
    found = error_forecast(plan, 0, single=0.1)
    assert found.single == 0.1 and len(found.shown) == len(found.error) == 12
    assert (np.diff(found.shown) >= 0).all() and found.shown[-1] == pytest.approx(plan.coverage(0))
    assert (found.error <= 0.1 + 1e-12).all()
    # the same frames again: twice the measurements of each position
    twice = replace(plan, offsets_px=(plan.offsets_px[0] * 2,))
    again = error_forecast(twice, 0, single=0.1)
    assert again.shown[-1] == found.shown[-1]
    assert again.error[-1] == pytest.approx(found.error[-1] / np.sqrt(2))
    none = error_forecast(replace(plan, offsets_px=((),)), 0, single=0.1)
    assert len(none.shown) == 0
