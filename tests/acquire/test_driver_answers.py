"""Drivers that answer nonsense, raise anything or hang: each fault is named with its device, and never a frame."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire.control import Control
from lfcal.acquire.errors import AcquisitionStopped
from lfcal.acquire.preview import Preview
from lfcal.acquire.session import record
from lfcal.acquire.setup.live import iter_live
from lfcal.devices import calling, checked
from lfcal.devices.errors import DeviceError, DeviceLost
from lfcal.devices.protocols import Frame, Roi, Setting
from lfcal.devices.rig import Rig
from lfcal.errors import LfcalError
from tests.acquire.rigs import CAREFUL, frames_of, rig_for, small_plan

PLAN = small_plan(planes=1)
OPTIONS = replace(CAREFUL, darks=1, retries=0)
Answer = Callable[[Any], Any]
"""What a driver answers in place of the right value."""


def framed(**values: Any) -> Answer:
    """Return a frame with some values replaced."""
    return lambda frame: replace(frame, **values)


def taken(actual: Any) -> Answer:
    """Return a setting with another actual value."""
    return lambda setting: Setting(setting.requested, actual)


def plain(value: Any) -> Answer:
    """Return a value whatever the right one is."""
    return lambda _: value


NAN, INF = math.nan, math.inf
CAMERA: dict[str, list[Answer]] = {
    "grab": [
        *map(plain, (None, 0, "frame", {"data": 1}, np.zeros((96, 96), np.uint16))),
        *(framed(number=value) for value in (None, "7", 1.5, NAN, True, -1)),
        *(framed(exposure_s=value) for value in (None, "0.01", NAN, INF, -0.01)),
        *(framed(started_s=value) for value in ("now", NAN, True)),
        *(framed(status=value) for value in (None, 0)),
        *(framed(data=value) for value in (None, [[1, 2]], "data", np.float32(1))),
        *(framed(data=np.zeros(shape, np.uint16)) for shape in ((96,), (96, 96, 3), (0, 0), (95, 96))),
        *(framed(data=np.zeros((96, 96), dtype)) for dtype in (np.complex64, object, np.bool_, np.float32, ">u2")),
    ],
    "set_exposure": [*map(plain, (None, 0.01, "ok")), *map(taken, (None, "0.01", NAN, INF, 0.0, -1.0))],
    "set_roi": [
        *map(plain, (None, Roi(0, 0, 96, 96), "ok")),
        *map(taken, (None, (0, 0, 96, 96), Roi(0, 0, 0, 96), Roi(-1, 0, 97, 96), Roi(0.5, 0, 96, 96))),  # type: ignore[arg-type]
    ],
    "sensor_shape": list(map(plain, (None, 96, "96x96", (96,), (0, 96), ("a", "b"), (96.5, 96)))),
    "bit_depth": list(map(plain, (None, "12", 0, 64, 12.5))),
    "max_value": list(map(plain, (None, "4095", 0, 1 << 20, NAN))),
    "fixed_settings": [
        *map(plain, (None, "Off", ["GainAuto"], {"GainAuto": "Off"}, {7: Setting("Off", "Off")})),
        *(plain({"Gain": setting}) for setting in (Setting(None, 6.0), Setting(1, "1"), Setting("Off", None))),
    ],
    "name": list(map(plain, (None, "", 5))),
}
STAGE: dict[str, list[Answer]] = {
    "position": list(map(plain, (None, 0.0, "0,0,0", (0.0, 0.0), (None, 0.0, 0.0), ("0", "0", "0"), (NAN, 0.0, 0.0)))),
    "moving": list(map(plain, (None, "no", (False, False)))),
    "limits": list(map(plain, (None, 5.0, ((0, 1), (0, 1)), ((1, 0),) * 3, (("a", "b"),) * 3, ((NAN, NAN),) * 3))),
    "name": list(map(plain, (None, "", 5))),
}
TABLE = [
    (device, call, answer)
    for device, calls in (("camera", CAMERA), ("stage", STAGE))
    for call, answers in calls.items()
    for answer in answers
]
RAISED = (RuntimeError("bus reset"), OSError(5, "I/O"), SystemExit(3), GeneratorExit(), KeyboardInterrupt())
CALLS = [
    *(("camera", call) for call in ("grab", "set_exposure", "set_roi", "sensor_shape", "bit_depth", "max_value")),
    ("camera", "fixed_settings"),
    *(("stage", call) for call in ("move", "moving", "position", "limits")),
    ("light", "switch"),
]


class Wrong:
    """A device around another one, in which one call or attribute is wrong."""

    waits = True

    def __init__(self, device: Any, call: str, answer: Callable[[Callable[[], Any]], Any]) -> None:
        self._device, self._call, self._answer = device, call, answer

    def __getattribute__(self, name: str) -> Any:
        if name.startswith("_") or name in ("waits", "moves"):
            return super().__getattribute__(name)
        found = getattr(self._device, name)
        if name != self._call:
            return found
        if not callable(found):
            return self._answer(lambda: found)
        return lambda *arguments: self._answer(lambda: found(*arguments))


def wrong_rig(device: str, call: str, answer: Callable[[Callable[[], Any]], Any]) -> Rig:
    rig = rig_for(PLAN)
    parts: dict[str, Any] = {name: getattr(rig, name).device for name in ("camera", "stage", "light")}
    parts[device] = Wrong(parts[device], call, answer)
    return Rig(**parts, time=rig.time)


def recorded(folder: Path, device: str, call: str, answer: Callable[[Callable[[], Any]], Any]) -> str:
    """Record with a wrong device, and return the message that ends it, in one line; nothing but lfcal's errors."""
    with pytest.raises((AcquisitionStopped, DeviceError, LfcalError)) as caught:
        with wrong_rig(device, call, answer) as rig:
            record(folder, PLAN, rig, OPTIONS)
    message = str(caught.value)
    assert "\n" not in message
    if isinstance(caught.value, AcquisitionStopped):
        assert caught.value.acknowledged == 0
    return message


@pytest.mark.parametrize(("device", "call", "answer"), TABLE, ids=[f"{d}-{c}-{k}" for k, (d, c, _) in enumerate(TABLE)])
def test_a_wrong_answer_is_refused_with_the_name_of_its_device(
    tmp_path: Path, device: str, call: str, answer: Answer
) -> None:
    message = recorded(tmp_path / "s", device, call, lambda right: answer(right()))
    named = f"name of the {device}" if call == "name" else f"simulated {device}"
    shown = ("camera frame", "frame number", "stage axis", "camera region")
    assert named in message or any(words in message for words in shown), message


@pytest.mark.parametrize("error", RAISED, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize(("device", "call"), CALLS)
def test_whatever_a_driver_raises_is_named(tmp_path: Path, device: str, call: str, error: BaseException) -> None:
    def failing(_: Callable[[], Any]) -> Any:
        raise error

    message = recorded(tmp_path / "s", device, call, failing)
    named = "light" if device == "light" else f"simulated {device}"
    assert f"{named}: " in message and type(error).__name__ in message, message


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let devices hang for a few hundredths of a second in place of seconds."""
    monkeypatch.setattr(calling, "SLICE_S", 0.002)
    monkeypatch.setattr(calling, "ANSWER_S", 0.1)
    for name in ("SETTING_S", "LIGHT_S"):
        monkeypatch.setattr(checked, name, 0.0)


@pytest.mark.parametrize(("device", "call"), CALLS)
@pytest.mark.usefixtures("quick")
def test_a_call_that_hangs_ends_the_session_and_is_named(tmp_path: Path, device: str, call: str) -> None:
    free = threading.Event()

    def hanging(right: Callable[[], Any]) -> Any:
        free.wait(60)
        return right()

    options, began = replace(OPTIONS, move_timeout_s=0.1, grab_timeout_s=0.1), time.monotonic()
    with pytest.raises((AcquisitionStopped, DeviceLost), match=rf"(simulated {device}|light): .* {call} ") as caught:
        with wrong_rig(device, call, hanging) as rig:
            record(tmp_path / "s", PLAN, rig, options)
    assert "complete" not in str(caught.value) and time.monotonic() - began < 30
    free.set()


@pytest.mark.parametrize(("device", "call"), [("stage", "stop"), ("stage", "close"), ("camera", "close")])
@pytest.mark.usefixtures("quick")
def test_a_device_that_hangs_at_the_end_is_named(tmp_path: Path, device: str, call: str) -> None:
    free = threading.Event()
    rig, control = wrong_rig(device, call, lambda _: free.wait(60)), Control()
    control.abort()
    if call == "stop":  # of an abort: the session ends all the same
        assert record(tmp_path / "s", PLAN, rig, OPTIONS, control=control).how == "aborted"
        rig.close()
    else:
        with pytest.raises(DeviceLost, match=f"simulated {device}: no answer to close within"):
            rig.close()
        rig.close()  # is left to the system
    free.set()


@pytest.mark.usefixtures("quick")
def test_an_abort_ends_a_move_that_hangs(tmp_path: Path) -> None:
    free, inside, control = threading.Event(), threading.Event(), Control()

    def hanging(_: Callable[[], Any]) -> None:
        inside.set()
        free.wait(60)

    def abort() -> None:
        inside.wait(60)
        control.abort()

    thread = threading.Thread(target=abort)
    thread.start()
    outcome = record(tmp_path / "s", PLAN, wrong_rig("stage", "move", hanging), CAREFUL, control=control)
    thread.join()
    free.set()
    assert outcome.how == "aborted"


def test_a_session_is_complete_only_with_all_its_positions(tmp_path: Path) -> None:
    """A frame of None, as some makers' libraries return at a timeout, once ended a session as complete."""
    calls = 0

    def once(right: Callable[[], Any]) -> Frame | None:
        nonlocal calls
        calls += 1
        return None if calls == 5 else right()

    with wrong_rig("camera", "grab", once) as rig:
        outcome = record(tmp_path / "s", PLAN, rig, replace(CAREFUL, retries=1))
    assert outcome.how == "complete" and outcome.acknowledged == len(frames_of(tmp_path / "s")) == PLAN.n_positions


def test_the_live_view_names_a_wrong_frame() -> None:
    with wrong_rig("camera", "grab", lambda _: None) as rig:
        with pytest.raises(DeviceError, match="simulated camera: grab: expected a Frame, got None"):
            next(iter_live(rig, Preview(), Control(), 0.01))
