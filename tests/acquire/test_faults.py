"""The fault table: each fault ends in the right error or is corrected, and never in a frame at a wrong position."""

from __future__ import annotations

import errno
import itertools
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
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, intercept, rig_for, small_plan

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


@pytest.mark.parametrize("kind", [kind for kind, _ in PASSING])
def test_a_frame_with_a_passing_fault_is_taken_again(
    tmp_path: Path, undisturbed: dict[Any, np.ndarray], kind: str
) -> None:
    outcome = record(tmp_path, PLAN, rig_for(PLAN, DeviceFault(kind, 8)), CAREFUL)
    assert outcome.how == "complete"
    assert_same_frames(frames_of(tmp_path), undisturbed)
    check_places(tmp_path)
    with RecordingSource(tmp_path) as source:
        attempts = [int(source.record(k)["attempts"]) for k in range(len(source))]
    assert sorted(attempts) == [1] * 26 + [2]


@pytest.mark.parametrize(("kind", "error"), PASSING + LASTING)
def test_a_lasting_fault_stops_safely_and_the_session_resumes(
    tmp_path: Path, undisturbed: dict[Any, np.ndarray], kind: str, error: type[Exception]
) -> None:
    rig = rig_for(PLAN, DeviceFault(kind, 11, 1000))
    with pytest.raises(AcquisitionStopped) as caught:
        record(tmp_path, PLAN, rig, CAREFUL)
    assert type(caught.value.cause) is error and "\n" not in str(caught.value)
    assert 0 < caught.value.acknowledged == len(frames_of(tmp_path)) < 27
    last = SessionFile.read(tmp_path).runs[-1]
    assert (last.how, last.message) == ("failed", str(caught.value))
    assert kind == "stage vanishes" or not rig.stage.moving()
    assert record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, resume=True).how == "complete"
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
    calls = itertools.count(1)

    def filling(descriptor: int, data: bytes | memoryview, offset: int) -> int:
        if next(calls) > 20:
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
    folder, taken = tmp_path / "session", list[int]()

    def watch(*_: object) -> None:
        taken.append(1)
        if len(taken) == 5:
            shutil.rmtree(folder)

    with pytest.raises(AcquisitionStopped, match=r"removed while recording|folder is missing"):
        record(folder, PLAN, rig_for(PLAN), CAREFUL, observers=(watch,))
    # those in flight were safe before the folder went
    assert len(taken) <= 5 + 2 * 4 and not folder.exists()


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


def test_without_its_tolerance_the_frame_of_a_bumped_stage_is_kept_and_wrong(
    tmp_path: Path, undisturbed: dict[Any, np.ndarray]
) -> None:
    """The counter-test of the read-back after the exposure."""
    blind = replace(CAREFUL, tolerance_um=(1e3, 1e3, 1e3))
    record(tmp_path, PLAN, rig_for(PLAN, DeviceFault("bumped", 8)), blind)
    assert any(not np.array_equal(frame, undisturbed[key]) for key, frame in frames_of(tmp_path).items())


def test_the_read_back_that_is_recorded_is_that_after_the_exposure(tmp_path: Path) -> None:
    """A stage that creeps within its tolerance is farther off after the exposure than on arrival."""
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


@pytest.mark.parametrize(
    ("device", "call", "after", "named", "error"),
    [
        ("camera", "grab", 20, "simulated camera", OSError(errno.EIO, "Input/output error")),
        ("stage", "move", 20, "simulated stage", RuntimeError("transfer failed")),
        ("stage", "moving", 120, "simulated stage", OSError(errno.EIO, "Input/output error")),
        ("light", "switch", 3, "light", OSError(errno.EIO, "Input/output error")),
        ("camera", "grab", 20, "simulated camera", StorageError("/elsewhere/request.json: no space left")),
    ],
)
def test_an_error_of_a_driver_is_not_called_an_error_of_the_disk(
    tmp_path: Path, undisturbed: dict[Any, np.ndarray], device: str, call: str, after: int, named: str, error: Exception
) -> None:
    """Whatever a driver raises ends the session in order, under the device's name; the session can be resumed."""
    options, rig, calls = replace(CAREFUL, darks=2, dark_every=9), rig_for(PLAN), itertools.count(1)

    def failing(works: Any, *arguments: Any) -> Any:
        if next(calls) > after:
            raise error
        return works(*arguments)

    intercept(rig, device, call, failing)
    words = "/elsewhere" if isinstance(error, StorageError) else f"{type(error).__name__}: "
    with pytest.raises(AcquisitionStopped, match=rf"by the device: {named}: {words}") as caught:
        record(tmp_path, PLAN, rig, options)
    assert isinstance(caught.value.cause, DeviceError) and 0 < caught.value.acknowledged < 27
    assert SessionFile.read(tmp_path).runs[-1].how == "failed"
    record(tmp_path, PLAN, rig_for(PLAN), options, resume=True)
    assert_same_frames(frames_of(tmp_path), undisturbed)
