"""Every kind of damage is found and named where it is; what is whole is never named."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.acquire.control import Control
from lfcal.acquire.finish import iter_finish
from lfcal.acquire.recording._verify import iter_verify, verify
from lfcal.acquire.recording.recording_file import read_layout
from lfcal.acquire.session import iter_record, record
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import FileFormatError, StorageError
from lfcal.base.progress import drain
from lfcal.frames.source import Position
from tests.acquire.rigs import CAREFUL, rig_for, small_plan
from tests.acquire.rotting import PAGE, ROTS, cut, frames_on_page, rot_frame, rot_record, wipe, wipe_record

PLAN = small_plan()
FULL = replace(CAREFUL, darks=2, reference_every=5, controls=1)
SAMPLE = Path(__file__).parents[3] / "sample_data" / "recorded"


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("verified")
    record(folder / "in place", PLAN, rig_for(PLAN), FULL)
    record(folder / "in place", PLAN, rig_for(PLAN, seed=2), FULL, redo=[Position(0, 1, 2), Position(2, 0, 0)])
    shutil.copytree(folder / "in place", folder / "packed")
    drain(iter_finish(folder / "packed"))
    return {name: folder / name for name in ("in place", "packed")}


def copy_of(session: Path, to: Path) -> Path:
    return Path(shutil.copytree(session, to / "s"))


@pytest.mark.parametrize("how", ["in place", "packed"])
def test_a_whole_session_is_whole(sessions: dict[str, Path], how: str) -> None:
    before = {p.name: p.read_bytes() for p in sessions[how].iterdir()}
    report = verify(sessions[how])
    assert report.ok and not report.damaged and not report.never_taken and not report.to_redo
    assert {f.file: (f.frames, f.whole) for f in report.files} == {
        "recording.h5": (27, 27),
        "checks.h5": (19, 19),
        "darks.h5": (1, 1),
        "recording-002.h5": (2, 2),
        "checks-002.h5": (2, 2),
    }
    assert {p.name: p.read_bytes() for p in sessions[how].iterdir()} == before, "nothing is written"


@pytest.mark.parametrize("rot", ROTS)
@pytest.mark.parametrize("how", ["in place", "packed"])
def test_each_damage_is_named_where_it_is(sessions: dict[str, Path], tmp_path: Path, how: str, rot: str) -> None:
    folder = copy_of(sessions[how], tmp_path)
    for file, slot in (("recording.h5", 13), ("checks.h5", 3), ("checks.h5", 17), ("darks.h5", 0)):
        ROTS[rot](folder / file, slot)
    ROTS[rot](folder / "recording-002.h5", 1)
    report = verify(folder)
    found = {(d.file, d.slot, d.kind, tuple(d.position)) for d in report.damaged}
    at_17 = next(tuple(d.position) for d in report.damaged if d.slot == 17)
    assert found == {
        ("recording.h5", 13, "position", (1, 1, 1)),
        ("checks.h5", 3, "reference", (1, 1, 1)),
        ("checks.h5", 17, "control", at_17),
        ("darks.h5", 0, "dark", (0, 0, 0)),
        ("recording-002.h5", 1, "position", (2, 0, 0)),
    }
    assert not report.ok and not report.never_taken
    assert report.to_redo == ((1, 1, 1), (2, 0, 0)), "an older frame was to be replaced"


def test_a_damaged_frame_that_was_recorded_again_since_is_no_fault(sessions: dict[str, Path], tmp_path: Path) -> None:
    folder = copy_of(sessions["packed"], tmp_path)
    rot_frame(folder / "recording.h5", 5)
    report = verify(folder)
    assert [(tuple(d.position), d.replaced) for d in report.damaged] == [((0, 1, 2), True)]
    assert report.ok and not report.to_redo


@pytest.mark.parametrize("number", range(3))
def test_a_page_of_zeros_names_the_frames_on_it(sessions: dict[str, Path], tmp_path: Path, number: int) -> None:
    folder = copy_of(sessions["in place"], tmp_path)
    path = folder / "recording.h5"
    offset = read_layout(path).frames_at // PAGE * PAGE + number * PAGE
    lost = frames_on_page(path, offset)
    wipe(path, offset)
    assert {d.slot for d in verify(folder).damaged} == lost
    assert 3 <= len(lost) <= 6


@pytest.mark.parametrize("kept", [26.5, 9.0, 1.0])
def test_a_file_cut_short_names_what_is_lost(sessions: dict[str, Path], tmp_path: Path, kept: float) -> None:
    folder = copy_of(sessions["in place"], tmp_path)
    path = folder / "recording.h5"
    layout = read_layout(path)
    cut(path, layout.frames_at + int(kept * layout.frame_bytes))
    report = verify(folder)
    assert report.files[0].fault.startswith("the file is cut short: ")
    assert [d.slot for d in report.damaged] == list(range(int(kept), 27))
    assert {d.what for d in report.damaged} == {"lost"}


@pytest.mark.parametrize("how", ["in place", "packed"])
def test_a_file_without_a_whole_frame_is_never_taken_for_one_in_place(
    sessions: dict[str, Path], tmp_path: Path, how: str
) -> None:
    """What is restored must not be a packed recording: its records may lie where those of one in place do."""
    folder = copy_of(sessions[how], tmp_path)
    path = folder / "recording.h5"
    if how == "packed":
        wipe(path, 0, 600)
    else:
        cut(path, read_layout(path).frames_at + 40)
    report = verify(folder)
    assert report.files[0].whole == 0 and report.files[0].damaged == 27
    assert "cut short" not in report.files[0].fault and "header" not in report.files[0].fault


def test_a_header_of_zeros_loses_no_frame(sessions: dict[str, Path], tmp_path: Path) -> None:
    folder = copy_of(sessions["in place"], tmp_path)
    wipe(folder / "recording.h5", 0)
    report = verify(folder)
    assert report.files[0].fault == "its header is damaged" and report.files[0].whole == 27
    assert not report.ok and not report.damaged


@pytest.mark.parametrize("file", ["recording.h5", "recording-002.h5", "checks.h5", "darks.h5"])
def test_a_file_of_which_nothing_is_left_is_lost_whole(sessions: dict[str, Path], tmp_path: Path, file: str) -> None:
    folder = copy_of(sessions["packed"], tmp_path)
    for spoil in (lambda p: cut(p, 100), lambda p: p.write_bytes(b"text"), Path.unlink):
        spoil(folder / file)
        report = verify(folder)
        (about,) = (f for f in report.files if f.file == file)
        assert about.fault and "expected" not in about.fault, "it stands within another sentence"
        assert about.whole == 0 and about.damaged == about.frames
        assert {d.file for d in report.damaged} == {file} and not report.ok


def test_the_file_of_another_session_is_named(sessions: dict[str, Path], tmp_path: Path) -> None:
    folder = copy_of(sessions["in place"], tmp_path)
    record(tmp_path / "other", PLAN, rig_for(PLAN), FULL)
    shutil.copy(tmp_path / "other" / "recording.h5", folder / "recording.h5")
    assert verify(folder).files[0].fault == "the file belongs to another session"


def test_what_was_never_taken_is_told_from_what_is_damaged(tmp_path: Path) -> None:
    control = Control()
    seen: list[object] = []

    def stop(*step: object) -> None:
        seen.append(step)
        if len(seen) == 20:
            control.stop()

    outcome = record(tmp_path, PLAN, rig_for(PLAN), FULL, control=control, observers=(stop,))
    rot_record(tmp_path / "recording.h5", 0)
    report = verify(tmp_path)
    assert len(report.never_taken) == 27 - outcome.acknowledged > 0
    assert [tuple(d.position) for d in report.damaged] == [(0, 0, 0)]
    wipe_record(tmp_path / "recording.h5", 0)
    report = verify(tmp_path)
    assert not report.damaged and report.lacking == 1 and not report.ok, "a record of zeros is one never written"


def test_a_session_can_be_checked_while_it_is_recorded(tmp_path: Path) -> None:
    reports = []
    for progress in iter_record(tmp_path, PLAN, rig_for(PLAN), FULL):
        if progress.done % 5 == 0:
            reports.append(verify(tmp_path))
    assert len(reports) > 4 and all(r.ok for r in reports)
    assert len(reports[0].never_taken) > len(reports[-1].never_taken)


def test_the_sample_recording_is_whole_and_one_bit_of_it_is_found(tmp_path: Path) -> None:
    folder = copy_of(SAMPLE, tmp_path)
    assert verify(folder).ok
    rot_frame(folder / "recording.h5", 400)
    (found,) = verify(folder).damaged
    assert (found.slot, found.what, *found.position) == (400, "frame damaged", 0, *divmod(400, 33))


def test_a_folder_that_is_no_session_or_has_a_damaged_description_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="expected a session folder"):
        verify(tmp_path)
    (tmp_path / "session.json").write_text("{")
    with pytest.raises(FileFormatError, match="restore it"):
        verify(tmp_path)


def test_progress_counts_every_frame_and_the_work_can_be_closed(sessions: dict[str, Path]) -> None:
    records = list(iter_verify(sessions["packed"], workers=2))
    assert records[0].done == 0 and records[-1].done == records[-1].total == 51
    assert {r.stage for r in records} == {"check frames"}
    work = iter_verify(sessions["packed"])
    next(work)
    work.close()


def test_random_damage_is_never_missed(sessions: dict[str, Path], tmp_path: Path) -> None:
    """Bits flipped anywhere in the frames or records in use: exactly the frames they belong to are named."""
    rng = np.random.default_rng(6)
    folder = copy_of(sessions["in place"], tmp_path)
    path = folder / "recording.h5"
    layout, clean = read_layout(path), path.read_bytes()
    for _ in range(10):
        slots = set(rng.choice(27, 3, replace=False).tolist())
        for slot in slots:
            if rng.random() < 0.5:
                at = layout.frames_at + slot * layout.frame_bytes + int(rng.integers(layout.frame_bytes))
            else:
                at = layout.records_at + slot * 128 + int(rng.integers(128))
            data = bytearray(path.read_bytes())
            data[at] ^= 1 << int(rng.integers(8))
            path.write_bytes(data)
        report = verify(folder)
        assert {d.slot for d in report.damaged if d.file == "recording.h5"} == slots
        assert SessionFile.read(folder).recordings
        path.write_bytes(clean)
