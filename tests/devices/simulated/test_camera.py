"""The simulated camera's frames have the mean and the variance that its sensor states."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.devices.errors import DeviceLost, FrameTimeout, StageError
from lfcal.devices.protocols import Point, Roi
from lfcal.devices.simulated._camera import SPREAD, LightPatch, SimCamera
from lfcal.devices.simulated.faults import DeviceFault
from tests.acquire.rigs import rig_for, small_plan

PLAN = small_plan()
SENSOR = PLAN.camera.sensor
GAIN, READ = SENSOR.electrons_per_count, SENSOR.read_noise_e / SENSOR.electrons_per_count
FRAMES = 60


class Even:
    """The same light everywhere (counts)."""

    def __init__(self, counts: float) -> None:
        self.counts = counts

    def render(self, source_um: Point, exposure_s: float, roi: Roi) -> LightPatch:
        return LightPatch(0, 0, np.full(SENSOR.shape, self.counts, np.float32))


def camera_of(counts: float) -> SimCamera:
    camera = rig_for(PLAN).camera.device  # type: ignore[attr-defined]
    assert isinstance(camera, SimCamera)
    camera._renderer = Even(counts)
    return camera


@pytest.mark.parametrize("counts", [0.0, 0.3, 1.0, 30.0, 900.0])
def test_mean_and_variance_are_those_of_the_sensor(counts: float) -> None:
    """Read noise, photon noise, one rounding; dim light is not lost in a second one."""
    camera = camera_of(counts)
    frames = np.stack([camera.grab(1.0).data for _ in range(FRAMES)]).astype(np.float64) - SENSOR.black_level
    variance = READ**2 + 1 / 12 + counts / GAIN
    # all frames take their noise from one field, whose own mean and variance vary by so much
    drawn = (SENSOR.shape[0] + SPREAD) ** 2
    assert abs(frames.mean() - counts) < 4 * np.sqrt(variance / drawn)
    assert frames.var() / variance == pytest.approx(1.0, abs=4 * np.sqrt(2 / drawn))


def test_read_noise_and_photon_noise_are_independent() -> None:
    """In none of the frames is one drawn as the other, which would add sigmas instead of variances."""
    counts = READ**2 * GAIN  # the photon noise is as large as the read noise: of one draw the variance would double
    camera = camera_of(counts)
    single = [float(np.var(camera.grab(1.0).data.astype(np.float64))) for _ in range(8 * SPREAD)]
    assert max(single) / (2 * READ**2 + 1 / 12) < 1.25


def test_no_two_frames_have_the_noise_of_four_rows_in_common() -> None:
    """Two frames in 4096 had all their noise in common, which the content guard takes for one buffer."""
    camera = camera_of(0.0)
    frames = [camera.grab(1.0).data for _ in range(600)]
    rows = {frame[at].tobytes() for frame in frames for at in (slice(4), slice(-4, None))}
    assert len(rows) == 2 * len(frames)


# -- errors of the simulated devices name the simulated fault and a remedy -------------------------------
def test_the_simulated_fault_is_named() -> None:
    for kind, error, remedy in (
        ("times out", FrameTimeout, "try again"),
        ("vanishes", DeviceLost, "connect again"),
        ("move fails", StageError, "try again"),
        ("stage vanishes", DeviceLost, "connect again"),
    ):
        rig = rig_for(PLAN, DeviceFault(kind, 0))
        with pytest.raises(error, match=f"because of the simulated fault '{kind}'; {remedy}"):
            if error is StageError or kind.startswith("stage"):
                rig.stage.move((0.0, 0.0, 0.0))
            else:
                rig.camera.grab(0.1)
