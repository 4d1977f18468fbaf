"""Errors of the simulated devices name the simulated fault and a remedy, not cables that do not exist."""

from __future__ import annotations

import pytest

from lfcal.devices.errors import DeviceError, DeviceLost, FrameTimeout, StageError
from lfcal.devices.simulated.faults import DeviceFault
from tests.acquire.rigs import rig_for, small_plan

PLAN = small_plan()


@pytest.mark.parametrize(
    ("kind", "error", "remedy"),
    [
        ("times out", FrameTimeout, "try again"),
        ("vanishes", DeviceLost, "connect again"),
        ("move fails", StageError, "try again"),
        ("stage vanishes", DeviceLost, "connect again"),
    ],
)
def test_the_simulated_fault_is_named(kind: str, error: type[DeviceError], remedy: str) -> None:
    rig = rig_for(PLAN, DeviceFault(kind, 0))
    with pytest.raises(error, match=f"because of the simulated fault '{kind}'; {remedy}"):
        if error is StageError or kind.startswith("stage"):
            rig.stage.move((0.0, 0.0, 0.0))
        else:
            rig.camera.grab(0.1)
