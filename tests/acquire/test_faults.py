"""The fault table: each fault ends in the right error or is mended, and never in a frame at a wrong position."""

from __future__ import annotations

import errno
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire._motion import LAST_POLL_S
from lfcal.acquire.errors import AcquisitionStopped
from lfcal.acquire.recording import recording_file as journal_module
from lfcal.acquire.recording.durable import FolderLock
from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.session import record
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import LfcalError, StorageError
from lfcal.base.system import write_at
from lfcal.devices.errors import (
    DeviceError,
    DeviceLost,
    FrameTimeout,
    IncompleteFrame,
    NotInPosition,
    StageError,
    StaleFrame,
    WrongFrame,
)
from lfcal.devices.simulated._stage import StageModel
from lfcal.devices.simulated.faults import DeviceFault
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, rig_for, small_plan

PLAN = small_plan()
# stage calls 8 and 11 are last approaches, not the detours before them
PASSING = [
    ("move fails", StageError),
    ("stops short", NotInPosition),
    ("drifts", NotInPosition),
    ("never arrives", StageError),
    ("times out", FrameTimeout),
    ("incomplete", IncompleteFrame),
    ("stale", StaleFrame),
    ("bumped", NotInPosition),  # on arrival all is well: only the read-back after the exposure sees it
]
LASTING = [("wrong shape", WrongFrame), ("vanishes", DeviceLost), ("stage vanishes", DeviceLost)]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[int, int, int], np.ndarray]:
    folder = tmp_path_factory.mktemp("undisturbed")
    record(folder, PLAN, rig_for(PLAN), CAREFUL)
    return frames_of(folder)


def check_places(folder: Path) -> None:
    """Every frame was taken where it belongs, by the read-back before and after the exposure."""
    tolerance = np.array(CAREFUL.motion(PLAN).tolerance_um)
    with RecordingSource(folder) as source:
        for k in range(len(source)):
            note = source.record(k)
            assert np.all(np.abs(note["stage_um"] - note["target_um"]) <= tolerance)
            assert np.allclose(note["target_um"], PLAN.stage_um(np.array(source.info(k).position)))


@pytest.mark.parametrize(("kind", "error"), PASSING)
def test_a_fault_that_passes_is_mended(
    tmp_path: Path, undisturbed: dict[Any, np.ndarray], kind: str, error: type[Exception]
) -> None:
    outcome = record(tmp_path, PLAN, rig_for(PLAN, DeviceFault(kind, 8)), CAREFUL)
    assert outcome.how == "complete"
    assert_same_frames(frames_of(tmp_path), undisturbed)
    check_places(tmp_path)
    with RecordingSource(tmp_path) as source:
        attempts = [int(source.record(k)["attempts"]) for k in range(len(source))]
    assert sorted(attempts) == [1] * 26 + [2]


@pytest.mark.parametrize(("kind", "error"), PASSING + LASTING)
def test_a_fault_that_stays_stops_safely_and_the_session_resumes(
    tmp_path: Path, undisturbed: dict[Any, np.ndarray], kind: str, error: type[Exception]
) -> None:
    rig = rig_for(PLAN, DeviceFault(kind, 11, 1000))
    with pytest.raises(AcquisitionStopped) as caught:
        record(tmp_path, PLAN, rig, CAREFUL)
    assert type(caught.value.cause) is error
    assert "\n" not in str(caught.value)
    assert 0 < caught.value.acknowledged < 27
    assert len(frames_of(tmp_path)) == caught.value.acknowledged
    check_places(tmp_path)
    last = SessionFile.read(tmp_path).runs[-1]
    assert last.how == "failed"
    assert last.message == str(caught.value)
    if kind != "stage vanishes":
        assert not rig.stage.moving()
    outcome = record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, resume=True)
    assert outcome.how == "complete"
    assert_same_frames(frames_of(tmp_path), undisturbed)
    check_places(tmp_path)


def test_a_jumping_clock_changes_nothing_but_the_time_of_day(
    tmp_path: Path, undisturbed: dict[Any, np.ndarray]
) -> None:
    record(tmp_path, PLAN, rig_for(PLAN, DeviceFault("clock jumps", 9)), CAREFUL)
    assert_same_frames(frames_of(tmp_path), undisturbed)
    with RecordingSource(tmp_path) as source:
        notes = sorted((source.record(k) for k in range(len(source))), key=lambda note: int(note["sequence"]))
    assert [int(note["sequence"]) for note in notes] == list(range(27))
    assert np.all(np.diff([float(note["elapsed_s"]) for note in notes]) > 0)
    assert np.diff([float(note["time_s"]) for note in notes]).min() < -80000


def test_a_disk_that_fills_stops_safely(
    tmp_path: Path, undisturbed: dict[Any, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = 0

    def filling(descriptor: int, data: bytes | memoryview, offset: int) -> int:
        nonlocal calls
        calls += 1
        if calls > 20:
            os.pwrite(descriptor, memoryview(data)[: len(data) // 2], offset)
            raise OSError(errno.ENOSPC, "No space left on device")
        return write_at(descriptor, data, offset)

    with monkeypatch.context() as patch:
        patch.setattr(journal_module, "write_at", filling)
        with pytest.raises(AcquisitionStopped, match=r"by the disk: .*free some space") as caught:
            record(tmp_path, PLAN, rig_for(PLAN), CAREFUL)
    assert isinstance(caught.value.cause, StorageError)
    assert len(frames_of(tmp_path)) == caught.value.acknowledged == 9
    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, resume=True)
    assert_same_frames(frames_of(tmp_path), undisturbed)


def test_a_removed_folder_stops_at_once(tmp_path: Path) -> None:
    folder = tmp_path / "session"
    taken = 0

    def watch(*_: object) -> None:
        nonlocal taken
        taken += 1
        if taken == 5:
            shutil.rmtree(folder)

    with pytest.raises(AcquisitionStopped, match=r"removed while recording|folder is missing"):
        record(folder, PLAN, rig_for(PLAN), CAREFUL, observers=(watch,))
    assert taken <= 5 + 2 * 4  # those in flight were safe before the folder went
    assert not folder.exists()


def test_a_second_program_is_refused_and_the_first_undisturbed(
    tmp_path: Path, undisturbed: dict[Any, np.ndarray]
) -> None:
    refused = []

    def second(*_: object) -> None:
        if len(refused) < 2:
            for options in ({"resume": True}, {}):
                with pytest.raises(LfcalError, match=r"no other program records|expected a new folder") as caught:
                    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, **options)
                refused.append(type(caught.value))

    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, observers=(second,))
    assert refused[0] is StorageError
    assert_same_frames(frames_of(tmp_path), undisturbed)
    FolderLock(tmp_path).release()


def test_a_stage_that_moves_during_the_exposure_spoils_the_frame(tmp_path: Path) -> None:
    """The counter-test: with a tolerance that sees nothing, the frame of the bumped stage is kept, and differs."""
    blind = replace(CAREFUL, tolerance_um=(1e3, 1e3, 1e3))
    record(tmp_path / "a", PLAN, rig_for(PLAN), blind)
    record(tmp_path / "b", PLAN, rig_for(PLAN, DeviceFault("bumped", 8)), blind)
    a, b = frames_of(tmp_path / "a"), frames_of(tmp_path / "b")
    assert any(not np.array_equal(a[key], b[key]) for key in a)


def test_the_read_back_that_is_recorded_is_that_after_the_exposure(tmp_path: Path) -> None:
    """A stage that creeps within its tolerance stands farther off after the exposure than on arrival."""
    plan = small_plan(exposure_s=0.1, settle_s=0.2)
    creep = (1.0, 0.5, -2.0)
    record(tmp_path, plan, rig_for(plan, model=StageModel(ringing_um=0.0, drift_um_s=creep)), CAREFUL)
    with RecordingSource(tmp_path) as source:
        for k in range(len(source)):
            note = source.record(k)
            # time since arrival: at most one poll late, then settling and the exposure
            seconds = (note["stage_um"] - note["target_um"]) / creep
            assert np.ptp(seconds) == pytest.approx(0.0, abs=1e-9)
            assert 0.3 - 1e-9 <= seconds[0] <= 0.3 + LAST_POLL_S


@pytest.mark.parametrize("error", [RuntimeError("transfer failed"), OSError(errno.EIO, "Input/output error")])
@pytest.mark.parametrize(
    ("device", "call", "after", "named"),
    [
        ("camera", "grab", 20, "simulated camera"),
        ("stage", "move", 20, "simulated stage"),
        ("stage", "moving", 120, "simulated stage"),
        ("light", "switch", 3, "light"),
    ],
)
def test_errors_of_a_driver_are_the_devices_and_not_the_disks(
    tmp_path: Path, undisturbed: dict[Any, np.ndarray], device: str, call: str, after: int, named: str, error: Exception
) -> None:
    """Whatever a driver raises ends the session in order, under the device's name; the session can be resumed."""
    options = replace(CAREFUL, darks=2, dark_every=9)
    rig = rig_for(PLAN)
    calls = 0
    works = getattr(getattr(rig, device).device, call)

    def failing(*arguments: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > after:
            raise error
        return works(*arguments)

    setattr(getattr(rig, device).device, call, failing)
    with pytest.raises(AcquisitionStopped, match=rf"by the device: {named}: {type(error).__name__}: ") as caught:
        record(tmp_path, PLAN, rig, options)
    assert isinstance(caught.value.cause, DeviceError)
    assert 0 < caught.value.acknowledged < 27
    assert SessionFile.read(tmp_path).runs[-1].how == "failed"
    record(tmp_path, PLAN, rig_for(PLAN), options, resume=True)
    assert_same_frames(frames_of(tmp_path), undisturbed)


def test_a_device_that_cannot_write_its_own_file_is_not_the_recordings_disk(tmp_path: Path) -> None:
    rig = rig_for(PLAN)

    def full(_timeout_s: float) -> Any:
        raise StorageError("/elsewhere/request.json: no space left; free some space")

    rig.camera.device.grab = full  # type: ignore[attr-defined]
    with pytest.raises(AcquisitionStopped, match="by the device: simulated camera: /elsewhere"):
        record(tmp_path, PLAN, rig, CAREFUL)
