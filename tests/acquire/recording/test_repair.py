"""A resumed session takes its damaged frames again; no whole frame is lost."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lfcal.acquire.control import Control
from lfcal.acquire.errors import AcquisitionStopped
from lfcal.acquire.finish import iter_assemble_session, iter_finish
from lfcal.acquire.recording._verify import verify
from lfcal.acquire.recording.recording_file import read_layout
from lfcal.acquire.runner import Outcome
from lfcal.acquire.session import iter_record, record
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import FileFormatError, InputError
from lfcal.base.progress import drain
from lfcal.camera import StageAxes
from lfcal.devices.simulated.faults import DeviceFault
from lfcal.frames.source import Position
from lfcal.psf import AssemblySettings, PSFMatrix
from tests.acquire.recording.sessions import FULL, PLAN, Find
from tests.acquire.rigs import rig_for
from tests.acquire.rotting import ROTS, cut, rot_frame, wipe
from tests.windows_rules import keep_open_files

SETTINGS = AssemblySettings(strict=True, dtype="float32")


def resume(folder: Path, control: Control | None = None, **options: object) -> Outcome:
    return record(folder, PLAN, rig_for(PLAN, **options), FULL, resume=True, control=control)


def matrix(folder: Path) -> PSFMatrix:
    return drain(iter_assemble_session(folder, settings=SETTINGS)).matrix


def assert_same_h(one: Path, two: Path) -> None:
    a, b = matrix(one), matrix(two)
    assert all(np.array_equal(a.plane(z), b.plane(z)) for z in range(3))


@pytest.mark.parametrize("rot", ROTS)
@pytest.mark.parametrize("how", ["in place", "packed"])
@pytest.mark.few(2)
def test_damaged_frames_are_taken_again(kept: Find, copied: Find, tmp_path: Path, how: str, rot: str) -> None:
    folder = copied(how, again=False)
    for file, slot in (("recording.h5", 0), ("recording.h5", 13), ("checks.h5", 3), ("checks.h5", 17)):
        ROTS[rot](folder / file, slot)
    outcome = resume(folder)
    assert (outcome.how, outcome.damaged) == ("complete", 4)
    assert verify(folder).ok
    assert_same_h(kept(how, again=False), folder)
    again = SessionFile.read(folder)
    assert again.redo == ((),) if how == "in place" else ((), ((0, 0, 0), (1, 1, 1)))
    assert resume(folder).damaged == 0
    assert SessionFile.read(folder).recordings == again.recordings


@pytest.mark.parametrize("how", ["in place", "packed"])
def test_damaged_darks_are_taken_again(kept: Find, copied: Find, tmp_path: Path, how: str) -> None:
    folder = copied(how, again=False)
    rot_frame(folder / "darks.h5", 0)
    with pytest.raises(FileFormatError, match=r"dark frame: darks\.h5\[0\]"):
        matrix(folder)
    assert resume(folder).damaged == 1
    assert verify(folder).ok
    drain(iter_finish(folder))
    assert np.allclose(matrix(folder).plane(1), matrix(kept(how, again=False)).plane(1), atol=25), (
        "noise of another dark frame"
    )


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="asks /proc what is open")
def test_damage_is_repaired_where_open_files_are_not_replaced(
    copied: Find, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on Windows: the packed recording is laid out in place again, and packed once more."""
    folder = copied("packed", again=False)
    rot_frame(folder / "checks.h5", 3)
    keep_open_files(monkeypatch, tmp_path)
    assert resume(folder).damaged == 1
    drain(iter_finish(folder))
    assert verify(folder).ok


@pytest.mark.long
def test_damage_of_a_recording_of_damage_is_taken_again(kept: Find, copied: Find, tmp_path: Path) -> None:
    folder = copied("packed", again=False)
    for number in range(3):
        rot_frame(folder / ("recording.h5", "recording-002.h5", "recording-003.h5")[number], 13 if number == 0 else 0)
        assert resume(folder).damaged == 1
        assert verify(folder).ok
        drain(iter_finish(folder))
        assert len(SessionFile.read(folder).recordings) == number + 2
    assert_same_h(kept("packed", again=False), folder)


def test_an_interrupted_repair_is_continued(kept: Find, copied: Find, tmp_path: Path) -> None:
    folder = copied("packed", again=False)
    for slot in (3, 13, 20):
        rot_frame(folder / "recording.h5", slot)
    control = Control()
    control.stop()
    assert resume(folder, control).how == "stopped"
    report = verify(folder)
    assert len(report.to_redo) == 3 and set(report.pending) == set(report.to_redo)
    rot_frame(folder / "recording.h5", 21)
    assert resume(folder).how == "complete"
    assert SessionFile.read(folder).redo[1:] == (((0, 1, 0), (1, 1, 1), (2, 0, 2)), ((2, 1, 0),))
    assert verify(folder).ok
    assert_same_h(kept("packed", again=False), folder)


@pytest.mark.parametrize("spoil", ["cut short", "header"])
def test_a_recording_in_place_gets_its_header_and_its_end_again(
    kept: Find, copied: Find, tmp_path: Path, spoil: str
) -> None:
    folder = copied("in place", again=False)
    path = folder / "recording.h5"
    layout = read_layout(path)
    if spoil == "cut short":
        cut(path, layout.frames_at + 20 * layout.frame_bytes + 5)
    else:
        wipe(path, 0)
    assert resume(folder).damaged == (7 if spoil == "cut short" else 0)
    assert verify(folder).ok
    assert_same_h(kept("in place", again=False), folder)


def test_a_file_of_which_nothing_is_left_is_not_recorded_again_unasked(copied: Find, tmp_path: Path) -> None:
    folder = copied("packed", again=False)
    for file in ("recording.h5", "checks.h5", "darks.h5"):
        kept = (folder / file).read_bytes()
        (folder / file).write_bytes(kept[:50])
        with pytest.raises(FileFormatError, match=rf"{file}.*restore it from a copy"):
            resume(folder)
        (folder / file).write_bytes(kept)
    assert sorted(p.name for p in folder.iterdir() if p.suffix == ".h5") == ["checks.h5", "darks.h5", "recording.h5"]


@pytest.mark.parametrize("how", [pytest.param("in place", marks=pytest.mark.long), "packed"])
def test_damage_is_repaired_by_resume_unless_the_origin_was_lost_or_by_a_redo_list(
    kept: Find, copied: Find, how: str
) -> None:
    step = PLAN.camera.step_um(PLAN.depths_um[0])
    folder = copied(how, again=False)
    rot_frame(folder / "recording.h5", 13)
    with pytest.raises(InputError, match="moved by"):
        resume(folder, axes=StageAxes(origin_um=(2 * step, 0.0, 0.0)))
    assert verify(folder).to_redo == (Position(1, 1, 1),)
    other = Path(shutil.copytree(folder, folder.with_name("list")))
    assert resume(folder).how == "complete" and verify(folder).ok
    record(other, PLAN, rig_for(PLAN), FULL, redo=verify(other).to_redo)
    assert verify(other).ok
    assert_same_h(kept(how, again=False), other)


def test_progress_shows_the_check_first(copied: Find, tmp_path: Path) -> None:
    folder = copied("packed", again=False)
    rot_frame(folder / "checks.h5", 4)
    stages = [p.stage for p in iter_record(folder, PLAN, rig_for(PLAN), FULL, resume=True)]
    assert list(dict.fromkeys(stages)) == ["check frames", "unpack checks.h5", "record"]
    assert not list(folder.glob(".*"))


@pytest.mark.long
def test_a_fault_while_damage_is_taken_again_leaves_what_was_whole(kept: Find, copied: Find, tmp_path: Path) -> None:
    folder = copied("in place", again=False)
    for slot in (3, 13, 20):
        rot_frame(folder / "recording.h5", slot)
    rig = rig_for(PLAN, DeviceFault("vanishes", at=2))
    with pytest.raises(AcquisitionStopped):
        record(folder, PLAN, rig, FULL, resume=True)
    left = verify(folder)
    assert 0 < len(left.damaged) < 3 and left.files[0].whole + len(left.damaged) == 27
    resume(folder)
    assert_same_h(kept("in place", again=False), folder)


CHILD = """
import os, sys
from pathlib import Path
from tests.acquire.recording.test_repair import FULL, PLAN
from tests.acquire.rigs import rig_for
from lfcal.acquire.session import iter_record
for count, progress in enumerate(iter_record(Path(sys.argv[1]), PLAN, rig_for(PLAN), FULL, resume=True)):
    if count == int(sys.argv[2]):
        os.kill(os.getpid(), 9)
"""


@pytest.mark.long
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no kill -9 on this platform")
@pytest.mark.parametrize(("how", "after"), [("packed", 14), ("packed", 2)])
def test_killed_while_it_is_repaired_loses_nothing(
    kept: Find, copied: Find, tmp_path: Path, how: str, after: int
) -> None:
    folder = copied(how, again=False)
    whole = verify(folder)
    for file, slot in (("recording.h5", 13), ("recording.h5", 20), ("checks.h5", 3)):
        rot_frame(folder / file, slot)
    before = {(d.file, d.slot) for d in verify(folder).damaged}
    done = subprocess.run([sys.executable, "-c", CHILD, str(folder), str(after)], capture_output=True, text=True)
    assert done.returncode == -9, done.stderr
    left = verify(folder)
    assert {(d.file, d.slot) for d in left.damaged} <= before
    assert sum(f.whole for f in left.files) >= sum(f.whole for f in whole.files) - 3
    resume(folder)
    assert verify(folder).ok
    assert_same_h(kept(how, again=False), folder)


@pytest.mark.parametrize("how", ["in place", pytest.param("packed", marks=pytest.mark.long)])
def test_a_lost_file_of_which_all_was_recorded_again_is_not_needed(
    kept: Find, copied: Find, tmp_path: Path, how: str
) -> None:
    folder = copied(how, again=False)
    (folder / "recording.h5").write_bytes(b"rotten to the core")
    with pytest.raises(
        FileFormatError, match=r"recording\.h5: .*copy the file again, or leave out the lost frames \(--skip-damaged\)"
    ):
        matrix(folder)
    everywhere = [Position(z, y, x) for z, y, x in np.ndindex(*PLAN.shape[:3])]
    record(folder, PLAN, rig_for(PLAN), FULL, redo=everywhere)
    packed = drain(iter_finish(folder))
    assert packed.bytes_gained > 0 and "recording.h5 is not packed" in packed.left[0]
    assert_same_h(kept(how, again=False), folder)
