"""Frames recorded by another program: only complete, fresh files are taken."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.acquire.errors import AcquisitionStopped
from lfcal.acquire.session import record
from lfcal.base.errors import InputError
from lfcal.devices.backends.folder import REQUEST
from lfcal.devices.errors import DeviceLost, FrameTimeout, IncompleteFrame
from lfcal.devices.registry import open_rig
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, rig_for, small_plan

PLAN = small_plan((2, 3), 1, settle_s=0.0)


def options_of(folder: Path, wait: str = "2", **more: str) -> dict[str, str]:
    return {"path": str(folder), "quiet": "0.01", "wait": wait, **more}


@contextmanager
def other_program(folder: Path, answer: Callable[[int, dict[str, object]], None]) -> Iterator[None]:
    """Call ``answer(number, request)`` for every request, in a thread."""
    done = threading.Event()

    def watch() -> None:
        last = 0
        while not done.is_set():
            try:
                request = json.loads((folder / REQUEST).read_text())
            except (FileNotFoundError, ValueError):
                request = {"number": 0}
            if request["number"] > last:
                last = request["number"]
                answer(last, request)
            time.sleep(0.002)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def camera_of() -> Callable[[dict[str, object]], np.ndarray]:
    """Return what the simulated camera sees where a request asks the source to be."""
    rig = rig_for(PLAN)

    def see(request: dict[str, object]) -> np.ndarray:
        place = request["stage_um"]
        assert isinstance(place, list)
        x, y, z = place
        for target in ((x - 20, y - 20, z - 20), (x, y, z)):
            rig.stage.move(target)
            rig.time.sleep(1e4)
        rig.camera.set_exposure(float(request["exposure_s"]))  # type: ignore[arg-type]
        return rig.camera.grab(1.0).data

    return see


def test_a_session_recorded_by_another_program_equals_one_of_our_own(tmp_path: Path) -> None:
    files = tmp_path / "files"
    files.mkdir()
    tifffile.imwrite(files / "old.tif", np.zeros((96, 96), np.uint16))
    see = camera_of()

    def answer(number: int, request: dict[str, object]) -> None:
        path = files / f"frame_{number:04d}.tif"
        whole = tmp_path / "whole.tif"
        tifffile.imwrite(whole, see(request))
        data = whole.read_bytes()
        with path.open("wb") as file:  # in two parts, as a slow program does
            file.write(data[: len(data) // 2])
            file.flush()
            time.sleep(0.005)
            file.write(data[len(data) // 2 :])

    with other_program(files, answer), open_rig(PLAN, "folder", options_of(files)) as rig:
        record(tmp_path / "s", PLAN, rig, CAREFUL)
    want = {}
    for position in PLAN.positions():
        place = PLAN.stage_um(np.array(position)).tolist()
        row, column = (int(v) - 10 for v in PLAN.image_px(np.array(position)))
        frame = see({"stage_um": place, "exposure_s": 0.02})
        want[tuple(position)] = frame[row : row + 21, column : column + 21]
    assert_same_frames(frames_of(tmp_path / "s"), want)
    assert not (files / REQUEST).exists()


def test_numbered_files_answer_their_own_request_only(tmp_path: Path) -> None:
    def late(number: int, _request: dict[str, object]) -> None:
        np.save(tmp_path / f"f{number - 1:03d}.npy", np.full((96, 96), number, np.uint16))

    options = options_of(tmp_path, "0.15", pattern="f{number:03d}.npy")
    with other_program(tmp_path, late), open_rig(PLAN, "folder", options) as rig:
        for _ in range(2):
            with pytest.raises(FrameTimeout, match=r"no complete image file .* within 0\.15 s; check .* file format$"):
                rig.camera.grab(0.1)


def test_unnumbered_files_that_come_too_late_end_the_session(tmp_path: Path) -> None:
    with open_rig(PLAN, "folder", options_of(tmp_path, "0.1")) as rig:
        with pytest.raises(DeviceLost, match=r"within 0\.2 s; check .*use \{number\} in the pattern"):
            rig.camera.grab(0.2)
        with pytest.raises(AcquisitionStopped):
            record(tmp_path / "s", PLAN, rig, replace(CAREFUL, grab_timeout_s=0.05))


def test_empty_half_and_wrong_files_are_never_taken_and_named(tmp_path: Path) -> None:
    def answer(number: int, _request: dict[str, object]) -> None:
        tifffile.imwrite(tmp_path / f"{number}.tif", np.ones((95 if number == 2 else 96, 96), np.uint16))
        data = (tmp_path / f"{number}.tif").read_bytes()
        (tmp_path / f"{number}.tif").write_bytes(data[: len(data) // {1: 2, 2: 1}.get(number, len(data) + 1)])

    with other_program(tmp_path, answer), open_rig(PLAN, "folder", options_of(tmp_path, "0.3")) as rig:
        for error, words in (
            (IncompleteFrame, "unreadable"),
            (IncompleteFrame, "correct the sensor of the plan"),
            (DeviceLost, r"no complete image file matching .* file format, and use \{number\}"),
        ):
            with pytest.raises(error, match=words):
                rig.camera.grab(0.1)


def test_a_file_written_again_counts_as_new(tmp_path: Path) -> None:
    def answer(number: int, _request: dict[str, object]) -> None:
        np.save(tmp_path / "latest.npy", np.full((96, 96), number, np.uint16))

    with other_program(tmp_path, answer), open_rig(PLAN, "folder", options_of(tmp_path)) as rig:
        assert [int(rig.camera.grab(1.0).data[0, 0]) for _ in range(3)] == [1, 2, 3]


def test_bad_options_are_refused() -> None:
    for options in ({}, {"path": "/nowhere"}, {"path": ".", "pattern": "a/b"}, {"path": ".", "bits": "x"}):
        with pytest.raises(InputError):
            open_rig(PLAN, "folder", options)
