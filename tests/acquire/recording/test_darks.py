"""The dark frames of a session: of how many exposures each is the mean, and the variance that they bring in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.session import record
from lfcal.devices.protocols import Point, Roi
from lfcal.devices.simulated._camera import LightPatch
from lfcal.frames import CorrectionRecipe, corrected_view
from tests.acquire.rigs import CAREFUL, rig_for, small_plan

LIGHT = 40.0


class Steps:
    """An even light on the upper half of the sensor, none below."""

    def render(self, source_um: Point, exposure_s: float, roi: Roi) -> LightPatch:
        return LightPatch(0, 0, np.repeat([LIGHT, 0.0], 48)[:, None] * np.ones((1, 96), np.float32))


@pytest.mark.parametrize("count", [pytest.param(1, marks=pytest.mark.long), 8])
def test_the_stated_variance_is_that_of_the_corrected_frames(tmp_path: Path, count: int) -> None:
    """One recorded dark is the mean of as many exposures as were asked for: its noise is divided by them."""
    plan = small_plan((6, 6), 2)
    rig = rig_for(plan)
    rig.camera.device._renderer = Steps()  # type: ignore[attr-defined]
    record(tmp_path, plan, rig, replace(CAREFUL, darks=count))
    squares = {LIGHT: np.zeros(2), 0.0: np.zeros(2)}
    with RecordingSource(tmp_path) as recording:
        (dark,) = recording.metadata.darks.values()
        assert dark.count == count
        view = corrected_view(recording, CorrectionRecipe(), plan)
        for k in range(len(view)):
            found, origin = view.samples(k), view.info(k).origin
            assert found.noise is not None
            rows = np.arange(origin[0], origin[0] + found.values.shape[0])
            light = np.where(rows < 48, LIGHT, 0.0)[:, None] * np.ones(found.values.shape)
            variance = found.noise.variance(light)
            for level, sums in squares.items():
                sums += np.square(found.values - light)[light == level].sum(), variance[light == level].sum()
    for light, (measured, stated) in squares.items():
        # one dark serves all frames, so that its own draw of 31 x 31 pixels does not average out
        assert measured / stated == pytest.approx(1.0, abs=0.06), light
