"""A driver that does not return from a call blocks nothing, and its late frame is dropped."""

from __future__ import annotations

import subprocess
import sys
import threading
import weakref
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from lfcal.acquire.control import Control
from lfcal.acquire.preview import Preview
from lfcal.acquire.session import record
from lfcal.acquire.setup.live import iter_live
from lfcal.devices import calling
from lfcal.devices.calling import Caller
from lfcal.devices.errors import DeviceError, DeviceLost, FrameTimeout
from lfcal.devices.protocols import Frame
from lfcal.devices.rig import Rig
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, intercept, rig_for, small_plan

PLAN = small_plan()


@dataclass
class Hanging:
    """A camera around another one, whose grab waits for `free` at call ``at``."""

    camera: Any
    at: int
    free: threading.Event = field(default_factory=threading.Event)
    inside: threading.Event = field(default_factory=threading.Event)
    calls: int = 0
    closed: bool = False
    waits = True

    def __getattr__(self, name: str) -> Any:
        return getattr(self.camera, name)

    def grab(self, timeout_s: float) -> Frame:
        self.calls += 1
        if self.calls == self.at:
            self.inside.set()
            self.free.wait()
        frame: Frame = self.camera.grab(timeout_s)
        return frame

    def close(self) -> None:
        self.closed = True


def hanging_rig(at: int) -> tuple[Rig, Hanging]:
    rig = rig_for(PLAN)
    camera = Hanging(rig.camera.device, at)  # type: ignore[attr-defined]
    return Rig(camera, rig.stage, rig.light, rig.time), camera


def abort_inside(camera: Hanging, control: Control) -> threading.Thread:
    def act() -> None:
        camera.inside.wait()
        control.abort()

    thread = threading.Thread(target=act)
    thread.start()
    return thread


def failing_with(error: Exception) -> Any:
    def failing(*_: object) -> Any:
        raise error

    return failing


def test_an_abort_ends_a_session_whose_driver_hangs_and_the_late_frame_is_dropped(tmp_path: Path) -> None:
    record(tmp_path / "whole", PLAN, rig_for(PLAN), CAREFUL)
    rig, camera = hanging_rig(9)
    control = Control()
    thread = abort_inside(camera, control)
    outcome = record(tmp_path / "s", PLAN, rig, CAREFUL, control=control)
    thread.join()
    assert outcome.how == "aborted" and len(frames_of(tmp_path / "s")) == outcome.acknowledged == 8
    assert not rig.stage.moving() and rig.camera.hangs
    camera.free.set()
    # with the same camera: the frame of the abandoned call comes first and must not be taken for a new one
    assert record(tmp_path / "s", PLAN, rig, CAREFUL, resume=True).how == "complete"
    assert_same_frames(frames_of(tmp_path / "s"), frames_of(tmp_path / "whole"))
    rig.close()
    assert camera.closed


def test_a_driver_that_never_comes_back_is_lost_and_left_to_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calling, "SLICE_S", 0.001)
    monkeypatch.setattr(calling, "ANSWER_S", 0.003)
    rig, camera = hanging_rig(1)
    assert rig.camera.grab(5.0, camera.inside.is_set) is None  # type: ignore[call-arg]
    with pytest.raises(DeviceLost, match=r"simulated camera: an earlier call of .* has not returned"):
        rig.camera.grab(0.003)
    rig.close()
    assert not camera.closed
    camera.free.set()


def test_errors_of_the_driver_come_through_its_thread_which_a_camera_that_never_waits_lacks() -> None:
    threads: list[threading.Thread] = []

    def failing(timeout_s: float) -> Frame:
        threads.append(threading.current_thread())
        raise FrameTimeout(f"no frame in {timeout_s:g} s")

    for waits in (True, False):
        sim = rig_for(PLAN)
        camera = Hanging(sim.camera.device, 0)
        camera.grab, camera.waits = failing, waits
        with pytest.raises(FrameTimeout, match="in 2 s"):
            Rig(camera, sim.stage).camera.grab(2.0)
    assert [one is threading.current_thread() for one in threads] == [False, True]


def test_the_thread_ends_with_its_rig() -> None:
    _, camera = hanging_rig(0)
    caller = Caller(camera, "camera")
    caller.call("grab", camera.grab, 1.0)
    thread, gone = caller._thread, weakref.ref(caller)
    assert thread is not None and thread.daemon
    del caller
    assert gone() is None
    thread.join(30)
    assert not thread.is_alive()


def test_the_live_view_stops_inside_a_call_and_names_the_device() -> None:
    rig, camera = hanging_rig(2)
    control = Control()
    live = iter_live(rig, Preview(), control, 0.01)
    assert next(live).levels is not None
    thread = abort_inside(camera, control)
    assert list(live) == []
    thread.join()
    camera.free.set()
    rig = rig_for(PLAN)
    intercept(rig, "camera", "set_exposure", failing_with(RuntimeError("bus reset")))
    with pytest.raises(DeviceError, match="simulated camera: RuntimeError: bus reset"):
        next(iter_live(rig, Preview(), Control(), 0.01))


def test_a_device_that_cannot_be_released_is_named_and_the_others_are_released() -> None:
    rig, camera = hanging_rig(0)
    intercept(rig, "stage", "close", failing_with(OSError("gone")))
    with pytest.raises(DeviceError, match="simulated stage: OSError: gone"):
        rig.close()
    assert camera.closed


def test_a_program_ends_although_a_driver_hangs(tmp_path: Path) -> None:
    code = """
from tests.devices.test_calling import hanging_rig
rig, camera = hanging_rig(1)
with rig:
    assert rig.camera.grab(5.0, camera.inside.is_set) is None
print("ended")
"""
    root = Path(__file__).parents[2]
    found = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=False)
    assert (found.returncode, found.stdout) == (0, "ended\n"), found.stderr
