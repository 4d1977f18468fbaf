"""Devices with faults: wrong, missing and late answers, hangs, wrong frames, wrong moves, wrong light.

Each is named with its device, stops the session or makes no difference: none ends in a wrong H without a message.
"""

from __future__ import annotations

import itertools
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
from lfcal.acquire.live_quality import LiveQuality
from lfcal.acquire.options import Options
from lfcal.acquire.preview import Preview
from lfcal.acquire.redo import read_suspects
from lfcal.acquire.schedule import window_shape
from lfcal.acquire.session import record
from lfcal.acquire.setup.live import iter_live
from lfcal.base.errors import LfcalError
from lfcal.camera import ScanPlan, preset
from lfcal.devices import calling, checked
from lfcal.devices.errors import DeviceError, DeviceLost
from lfcal.devices.protocols import Frame, Point, Roi, Setting
from lfcal.devices.rig import Rig
from lfcal.frames.source import Position
from tests.acquire.rigs import (
    CAREFUL,
    assert_same_frames,
    deceived_rig,
    frames_of,
    intercept,
    rig_for,
    scaled,
    small_plan,
)

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
ANSWERS = [(device, call) for device, calls in (("camera", CAMERA), ("stage", STAGE)) for call in calls]
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


@pytest.mark.parametrize(("device", "call"), ANSWERS)
def test_a_wrong_answer_is_refused_with_the_name_of_its_device(tmp_path: Path, device: str, call: str) -> None:
    named = f"name of the {device}" if call == "name" else f"simulated {device}"
    shown = (named, "camera frame", "frame number", "stage axis", "camera region")
    for k, answer in enumerate({"camera": CAMERA, "stage": STAGE}[device][call]):
        message = recorded(tmp_path / str(k), device, call, lambda right, answer=answer: answer(right()))
        assert any(words in message for words in shown), (k, message)


@pytest.mark.parametrize(("device", "call"), CALLS)
def test_whatever_a_driver_raises_is_named(tmp_path: Path, device: str, call: str) -> None:
    for k, error in enumerate(RAISED if call in ("grab", "move", "switch") else RAISED[1:3]):

        def failing(_: Callable[[], Any], error: BaseException = error) -> Any:
            raise error

        message = recorded(tmp_path / str(k), device, call, failing)
        named = "light" if device == "light" else f"simulated {device}"
        assert f"{named}: " in message and type(error).__name__ in message, message


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let devices hang for a few hundredths of a second instead of seconds."""
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
    free, control = threading.Event(), Control()

    def hanging(_: Callable[[], Any]) -> None:
        threading.Timer(0.01, control.abort).start()
        free.wait(60)

    outcome = record(tmp_path / "s", PLAN, wrong_rig("stage", "move", hanging), CAREFUL, control=control)
    free.set()
    assert outcome.how == "aborted"


def test_a_session_is_complete_only_with_all_its_positions(tmp_path: Path) -> None:
    """A frame of None, as some makers' libraries return at a timeout, once ended a session as complete."""
    calls = itertools.count(1)

    def once(right: Callable[[], Any]) -> Frame | None:
        return None if next(calls) == 5 else right()

    with wrong_rig("camera", "grab", once) as rig:
        outcome = record(tmp_path / "s", PLAN, rig, replace(CAREFUL, retries=1))
    assert outcome.how == "complete" and outcome.acknowledged == len(frames_of(tmp_path / "s")) == PLAN.n_positions
    with wrong_rig("camera", "grab", lambda _: None) as rig:
        with pytest.raises(DeviceError, match="simulated camera: grab: expected a Frame, got None"):
            next(iter_live(rig, Preview(), Control(), 0.01))


# -- right answers of devices that do something else -------------------------------------------------------------------
SCAN = ScanPlan.for_camera(preset("bench"), virtual_depths=[2.0, 4.0])
ONLY = [Position(z, y, x) for z in range(2) for y in range(7, 12) for x in range(11, 19)]
SEEN = Options(darks=2, reference_every=8, keep_free_bytes=0, retries=1)
PIXEL_UM = SCAN.step_um(0)[0]
WRONG_H = 0.05
"""Error of H (NRMSE against the undisturbed session) that must be named."""
BEGIN = 50
"""Exposures before a fault of the camera or the light begins: the first are those of the check and of the darks."""
Spoil = Callable[[int, np.ndarray, np.ndarray], np.ndarray]
"""Makes of exposure number, its frame, and the one before what the camera hands out."""


def later(spoil: Callable[[np.ndarray, np.ndarray], np.ndarray], times: int = 10**6) -> Spoil:
    """Return a fault that begins late and lasts for so many exposures."""
    return lambda k, data, before: spoil(data, before) if BEGIN <= k < BEGIN + times else data


def mixed(data: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return every other row of each frame."""
    data = data.copy()
    data[::2] = before[::2]
    return data


def lost(data: np.ndarray, _: np.ndarray) -> np.ndarray:
    """Return a frame that lost an eighth of its rows: the others moved up."""
    rows = len(data) // 8
    return np.vstack([data[: 3 * rows], data[4 * rows :], data[-rows:]])


def torn(data: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the upper half of each frame, above the lower half of the one before."""
    return np.vstack([data[: len(data) // 2], before[len(data) // 2 :]])


def even(level: int) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    return lambda data, _: np.full_like(data, level)


def stray(share: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    return lambda data, _: np.minimum(data + np.uint16(share * 4095), 4095).astype(data.dtype)


def gain(factor: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return a camera or a lamp that changed its gain."""
    return lambda data, _: np.clip(64 + factor * (data - 64.0), 0, 4095).astype(data.dtype)


CAMERA_DOES: dict[str, Spoil] = {
    "column moved by a pixel": later(lambda data, _: np.roll(data, 1, axis=1)),
    "row moved by a pixel": later(lambda data, _: np.roll(data, 1, axis=0)),
    "moved by three": later(lambda data, _: np.roll(data, (3, -3), (0, 1))),
    "moved by a pixel once": later(lambda data, _: np.roll(data, 1, axis=1), 1),
    "frame before": later(lambda _, before: before),
    "frame before, once": later(lambda _, before: before, 1),
    "torn": later(torn),
    "torn, once": later(torn, 1),
    "mixed": later(mixed),
    "rows lost": later(lost),
    "rows black": later(
        lambda data, _: np.where(np.arange(len(data))[:, None] % 160 < 150, data, 64).astype(data.dtype)
    ),
    "blank": later(even(64)),
    "blank, once": later(even(64), 1),
    "full": later(even(4095)),
    "mirrored": later(lambda data, _: data[:, ::-1].copy()),
    "turned": later(lambda data, _: data[::-1, ::-1].copy()),
    "bytes swapped": later(lambda data, _: data.byteswap()),
    "shifted by four bits": later(lambda data, _: (data << 4).astype(data.dtype)),
    "stray light": later(stray(0.05)),
    "gain doubled": later(gain(2.0)),
    "gain 1.3": later(gain(1.3)),
    "light 0.7": later(gain(0.7)),
    "light fades": lambda k, data, _: gain(max(0.4, 1 - k / 400))(data, data),
    "level creeps": lambda k, data, _: (data + np.uint16(k // 2)).astype(data.dtype),
    "hot pixel": lambda k, data, _: _lit(data, 160, 160, 4000 if k >= BEGIN else 0),
}


def _lit(data: np.ndarray, row: int, column: int, counts: int) -> np.ndarray:
    """Return a frame of the whole sensor, or of the region about its middle, with light at one of its pixels."""
    data = data.copy()
    at = row - (320 - len(data)) // 2, column - (320 - data.shape[1]) // 2
    data[at] = max(int(data[at]), counts)
    return data


def displaced(away: Callable[[int], Point]) -> Callable[[int, Point], Point]:
    """Return a stage that is off by so many pixels (x, y) and micrometres (z) at each move."""

    def true(move: int, at: Point) -> Point:
        x, y, z = away(move)
        return at[0] + x * PIXEL_UM, at[1] + y * PIXEL_UM, at[2] + z

    return true


def jumps(pixels: float) -> Callable[[int, Point], Point]:
    """Return a stage that lost steps in the middle of the session."""
    return displaced(lambda move: (pixels * (move > 70), 0.0, 0.0))


def drifts(x: float, y: float) -> Callable[[int, Point], Point]:
    """Return a stage that drifts so far over the session (pixels)."""
    return displaced(lambda move: (x * move / 130, y * move / 130, 0.0))


def jitters(pixels: float) -> Callable[[int, Point], Point]:
    rng = np.random.default_rng(8)
    return displaced(lambda _: (*(pixels * rng.standard_normal(2)), 0.0))


def stands(after: int) -> Callable[[int, Point], Point]:
    """Return a stage that no longer moves, though its encoders do."""
    last: list[Point] = []

    def true(move: int, at: Point) -> Point:
        last[:] = last if move > after and last else [at]
        return last[0]

    return true


STAGE_DOES: dict[str, Callable[[int, Point], Point]] = {
    **{f"scale {k}": scaled(k, k, 1.0) for k in (1.01, 1.02, 1.09, 1.5, 0.98, 0.9, 0.5)},
    "scale of x": scaled(1.03, 1.0, 1.0),
    "scale of y": scaled(1.0, 0.97, 1.0),
    **{f"depth scale {k}": scaled(1.0, 1.0, k) for k in (0.5, 0.9, 1.1, 2.0, -1.0)},
    "x reversed": scaled(-1.0, 1.0, 1.0),
    "y reversed": scaled(1.0, -1.0, 1.0),
    "x and y swapped": lambda _, at: (at[1], at[0], at[2]),
    "x and z swapped": lambda _, at: (at[2], at[1], at[0]),
    "x stands still": lambda _, at: (0.0, at[1], at[2]),
    "y stands still": lambda _, at: (at[0], 0.0, at[2]),
    "z stands still": lambda _, at: (at[0], at[1], SCAN.depths_um[0]),
    "nothing moves": stands(0),
    "stands from the middle on": stands(80),
    **{f"jitter {k}": jitters(k) for k in (0.5, 1.0, 3.0)},
    **{f"drift {x}, {y}": drifts(x, y) for x, y in ((2.0, 0.0), (0.0, 2.0), (-1.0, 1.0), (8.0, 0.0))},
    **{f"jump {k}": jumps(k) for k in (1.0, 2.0, -5.0)},
}
DOES: dict[str, tuple[str, Any]] = {
    **{f"camera: {kind}": ("camera", spoil) for kind, spoil in CAMERA_DOES.items()},
    **{f"stage: {kind}": ("stage", true) for kind, true in STAGE_DOES.items()},
    "light: stays on": ("light", None),
}
QUICKLY = (
    "camera: column moved by a pixel",
    "camera: mixed",
    "camera: light fades",
    "camera: hot pixel",
    "stage: drift 2.0, 0.0",
    "light: stays on",
)
"""One of each kind for a plain run; wrong scales, signs and jitter of a stage are in `test_stage_check`."""


def rig_that_does(device: str, does: Any) -> Rig:
    if device == "stage":
        return deceived_rig(SCAN, does)
    rig = rig_for(SCAN)
    if device == "light":
        intercept(rig, "light", "switch", lambda *_: None)
        return rig
    count, before = itertools.count(1), np.zeros((0, 0), np.uint16)

    def grab(works: Any, timeout_s: float) -> Frame:
        nonlocal before
        frame = works(timeout_s)
        before, latest = frame.data, before if before.shape == frame.data.shape else frame.data
        return replace(frame, data=does(next(count), frame.data, latest))

    intercept(rig, "camera", "grab", grab)
    return rig


def reported(folder: Path, rig: Rig) -> tuple[list[str], dict[tuple[int, int, int], np.ndarray]]:
    """Record; return what the user is shown, and the frames of a complete session. Only lfcal's errors may end it."""
    quality = LiveQuality(SCAN, window_shape(SCAN, SEEN))
    try:
        outcome = record(folder, SCAN, rig, SEEN, only=ONLY, observers=(quality,))
    except LfcalError as error:
        assert "\n" not in str(error)
        return [str(error)], {}
    frames = frames_of(folder)
    assert outcome.how == "complete" and len(frames) == outcome.acknowledged == len(ONLY)
    suspects = read_suspects(folder).reasons
    return [*outcome.notes, *suspects, *(alarm.kind for alarm in quality.state().alarms)], frames


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[int, int, int], np.ndarray]:
    said, frames = reported(tmp_path_factory.mktemp("undisturbed") / "s", rig_for(SCAN))
    assert said == []
    return frames


def error_of_h(frames: dict[Any, np.ndarray], clean: dict[Any, np.ndarray]) -> float:
    """Return the relative L2 error of the patterns above black."""
    ours, theirs = (np.stack([np.asarray(one[at], float) - 64 for at in sorted(clean)]) for one in (frames, clean))
    return float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs))


@pytest.mark.parametrize(
    "kind", [kind if kind in QUICKLY else pytest.param(kind, marks=pytest.mark.long) for kind in DOES]
)
def test_a_fault_with_a_wrong_h_is_named(
    tmp_path: Path, undisturbed: dict[tuple[int, int, int], np.ndarray], kind: str
) -> None:
    said, frames = reported(tmp_path / "s", rig_that_does(*DOES[kind]))
    assert said or error_of_h(frames, undisturbed) <= WRONG_H


def test_late_answers_make_no_difference(tmp_path: Path) -> None:
    """A session in which every call of every device answers late."""

    class Late:
        waits = True

        def __init__(self, device: Any) -> None:
            self._device = device

        def __getattr__(self, name: str) -> Any:
            found = getattr(self._device, name)
            return (lambda *arguments: (time.sleep(0.002), found(*arguments))[1]) if callable(found) else found

    rig = rig_for(PLAN)
    camera, stage, light = (Late(one.device) for one in (rig.camera, rig.stage, rig.light))
    with Rig(camera, stage, light, rig.time) as late:
        assert record(tmp_path / "s", PLAN, late, OPTIONS).how == "complete"
    record(tmp_path / "clean", PLAN, rig_for(PLAN), OPTIONS)
    assert_same_frames(frames_of(tmp_path / "s"), frames_of(tmp_path / "clean"))
