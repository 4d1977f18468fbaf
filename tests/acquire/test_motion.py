"""Moves of the stage: backlash, limits, settling, drift."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.acquire._motion import Motion, Mover, check_limits
from lfcal.acquire.control import Aborted, Control
from lfcal.base.errors import InputError
from lfcal.devices.errors import LimitError, NotInPosition, StageError
from lfcal.devices.simulated._stage import SimStage, StageModel, VirtualTime
from lfcal.devices.simulated.faults import DeviceFault

PATH = [(float(x), float(y), float(z)) for z in (0, 50) for y in (0, 30, 10) for x in (0, 20, 40, 30, 10)]


def mover(stage: SimStage, time: VirtualTime, control: Control | None = None, **options: object) -> Mover:
    return Mover(stage, time, Motion(**options), control or Control())  # type: ignore[arg-type]


def true_errors(overshoot: float) -> np.ndarray:
    """Return the range of the true errors on each axis along a path of moves."""
    time = VirtualTime()
    stage = SimStage(time, StageModel(backlash_um=(4.0, 5.0, 6.0)))
    drive, errors = mover(stage, time, overshoot_um=(overshoot,) * 3), []
    for target in PATH:
        assert drive.go(target) == pytest.approx(target, abs=1e-3), "the read-back cannot show the backlash"
        errors.append(np.subtract(stage.true_position(), target))
    return np.ptp(errors, axis=0)


def test_backlash_is_taken_up_by_approaching_from_one_side() -> None:
    assert true_errors(20.0) == pytest.approx([0, 0, 0], abs=1e-9)
    assert true_errors(0.0)[:2] == pytest.approx([4.0, 5.0], abs=1e-9), "without the approach the backlash shows"


def test_moves_in_the_positive_sense_need_no_detour() -> None:
    time = VirtualTime()
    stage = SimStage(time)
    drive = mover(stage, time)
    for x in range(10):
        drive.go((10.0 * x, 0.0, 0.0))
    assert stage.moves == 10 + 1
    drive.go((0.0, 0.0, 0.0))
    assert stage.moves == 10 + 1 + 2


def test_arrival_is_waited_for_and_ringing_dies_out() -> None:
    time = VirtualTime()
    stage = SimStage(time, StageModel(velocity_um_s=100.0, ringing_um=5.0, ringing_s=0.02))
    mover(stage, time, settle_s=0.3, overshoot_um=(0.0,) * 3).go((300.0, 0.0, 0.0))
    assert time.monotonic() >= 3.3
    assert stage.position()[0] == pytest.approx(300.0, abs=0.01)
    with pytest.raises(NotInPosition, match=r"400 ± 0\.1 µm, got 40\d"):
        mover(stage, time, settle_s=0.0, overshoot_um=(0.0,) * 3, tolerance_um=(0.1,) * 3).go((400.0, 0.0, 0.0))


def test_limits_are_checked_with_the_approach_and_before_anything_moves() -> None:
    limits = ((0.0, 100.0), (0.0, 100.0), (0.0, 100.0))
    targets = np.array([[10.0, 50.0, 50.0], [60.0, 50.0, 50.0]])
    check_limits(targets, limits, (10.0, 10.0, 10.0))
    with pytest.raises(LimitError, match=r"axis x.*-1 to 60"):
        check_limits(targets, limits, (11.0, 10.0, 10.0))
    with pytest.raises(LimitError, match="axis z"):
        check_limits(targets + np.array([0, 0, 51]), limits, (0.0, 0.0, 0.0))
    time = VirtualTime()
    stage = SimStage(time, StageModel(limits=limits))
    with pytest.raises(InputError):
        mover(stage, time).go((5.0, 50.0, 50.0))
    assert stage.moves == 0


def test_faults_of_the_stage_are_detected() -> None:
    for kind, error in (
        ("move fails", StageError),
        ("stops short", NotInPosition),
        ("drifts", NotInPosition),
        ("never arrives", StageError),
    ):
        time = VirtualTime()
        with pytest.raises(error):
            stage = SimStage(time, faults=[DeviceFault(kind, 1)])
            mover(stage, time, timeout_s=5.0, settle_s=0.1).go((100.0, 100.0, 100.0))


def test_abort_is_heard_on_the_way() -> None:
    class Impatient(VirtualTime):
        def sleep(self, seconds: float) -> None:
            super().sleep(seconds)
            if self.monotonic() > 1.0:
                control.abort()

    control, time = Control(), Impatient()
    stage = SimStage(time, StageModel(velocity_um_s=1.0))
    with pytest.raises(Aborted):
        mover(stage, time, control).go((1000.0, 0.0, 0.0))
    assert time.monotonic() < 1.1


def test_stopped_stage_stays_where_it_was_stopped() -> None:
    time = VirtualTime()
    stage = SimStage(time, StageModel(velocity_um_s=100.0))
    stage.move((100.0, -50.0, 0.0))
    time.sleep(0.4)
    stage.stop()
    time.sleep(10.0)
    assert not stage.moving()
    assert stage.position() == pytest.approx((40.0, -40.0, 0.0))
    stage.home()
    time.sleep(10.0)
    assert stage.position() == (0.0, 0.0, 0.0)
