"""Every kind of damage is found, named where it is, and refused or left out; whole frames are never named."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.acquire.finish import iter_assemble_session
from lfcal.acquire.recording._recorded import RecordedFile
from lfcal.acquire.recording._verify import iter_verify, verify
from lfcal.acquire.recording.recording_file import read_layout
from lfcal.acquire.recording.records import Kind
from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.session import iter_record, record
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import FileFormatError, InputError, StorageError
from lfcal.base.progress import drain
from lfcal.frames import CorrectionRecipe
from lfcal.frames.source import Position
from lfcal.psf import AssemblyReport, AssemblySettings, open_psf
from tests.acquire.recording.sessions import FULL, PLAN, Find
from tests.acquire.rigs import rig_for, stopped
from tests.acquire.rotting import PAGE, ROTS, cut, frames_on_page, rot_frame, rot_record, wipe, wipe_record

SAMPLE = Path(__file__).parents[3] / "sample_data" / "recorded"


@pytest.mark.parametrize("how", ["in place", "packed"])
def test_a_whole_session_is_whole(kept: Find, how: str) -> None:
    before = {p.name: p.read_bytes() for p in kept(how).iterdir()}
    report = verify(kept(how))
    assert report.ok and not report.damaged and not report.never_taken and not report.to_redo
    assert {f.file: (f.frames, f.whole) for f in report.files} == {
        "recording.h5": (27, 27),
        "checks.h5": (19, 19),
        "darks.h5": (2, 2),
        "recording-002.h5": (2, 2),
        "checks-002.h5": (2, 2),
    }
    assert {p.name: p.read_bytes() for p in kept(how).iterdir()} == before, "nothing is written"


@pytest.mark.parametrize("how", ["in place", "packed"])
def test_each_damage_is_named_where_it_is(copied: Find, how: str) -> None:
    for k, (rot, spoil) in enumerate(ROTS.items()):
        folder = copied(how, f"{k}")
        for file, slot in (("recording.h5", 13), ("checks.h5", 3), ("checks.h5", 17), ("darks.h5", 0)):
            spoil(folder / file, slot)
        spoil(folder / "recording-002.h5", 1)
        report = verify(folder)
        found = {(d.file, d.slot, d.kind, tuple(d.position)) for d in report.damaged}
        at_17 = next(tuple(d.position) for d in report.damaged if d.slot == 17)
        assert found == {
            ("recording.h5", 13, "position", (1, 1, 1)),
            ("checks.h5", 3, "reference", (1, 1, 1)),
            ("checks.h5", 17, "control", at_17),
            ("darks.h5", 0, "dark", (0, 0, 0)),
            ("recording-002.h5", 1, "position", (2, 0, 0)),
        }, rot
        assert not report.ok and not report.never_taken
        assert report.to_redo == ((1, 1, 1), (2, 0, 0)), "an older frame was to be replaced"


def test_a_damaged_frame_that_was_recorded_again_since_is_no_fault(copied: Find, tmp_path: Path) -> None:
    folder = copied("packed")
    rot_frame(folder / "recording.h5", 5)
    report = verify(folder)
    assert [(tuple(d.position), d.replaced) for d in report.damaged] == [((0, 1, 2), True)]
    assert report.ok and not report.to_redo


def test_lost_pages_ends_and_headers_name_the_frames_that_are_lost(copied: Find) -> None:
    folder = copied("in place")
    path = folder / "recording.h5"
    layout, whole = read_layout(path), path.read_bytes()
    for number in range(3):
        offset = layout.frames_at // PAGE * PAGE + number * PAGE
        lost = frames_on_page(path, offset)
        wipe(path, offset)
        assert {d.slot for d in verify(folder).damaged} == lost and 3 <= len(lost) <= 6, number
        path.write_bytes(whole)
    for kept in (26.5, 9.0, 1.0):
        cut(path, layout.frames_at + int(kept * layout.frame_bytes))
        report = verify(folder)
        assert report.files[0].fault.startswith("the file is cut short: ")
        assert [d.slot for d in report.damaged] == list(range(int(kept), 27)), kept
        assert {d.what for d in report.damaged} == {"lost"}
        path.write_bytes(whole)
    wipe(path, 0)
    report = verify(folder)
    assert report.files[0].fault == "its header is damaged" and report.files[0].whole == 27
    assert not report.ok and not report.damaged


@pytest.mark.parametrize("how", ["in place", "packed"])
def test_a_file_without_a_whole_frame_is_never_taken_for_one_in_place(copied: Find, tmp_path: Path, how: str) -> None:
    """A packed recording must not be restored in place: its records may lie where those of one in place do."""
    folder = copied(how)
    path = folder / "recording.h5"
    if how == "packed":
        wipe(path, 0, 600)
    else:
        cut(path, read_layout(path).frames_at + 40)
    report = verify(folder)
    assert report.files[0].whole == 0 and report.files[0].damaged == 27
    assert "cut short" not in report.files[0].fault and "header" not in report.files[0].fault


def test_a_file_of_which_nothing_is_left_is_lost_whole(copied: Find) -> None:
    folder = copied("packed")
    for file in ("recording.h5", "recording-002.h5", "checks.h5", "darks.h5"):
        whole = (folder / file).read_bytes()
        for spoil in (lambda p: cut(p, 100), lambda p: p.write_bytes(b"text"), Path.unlink):
            spoil(folder / file)
            report = verify(folder)
            (about,) = (f for f in report.files if f.file == file)
            assert about.fault and "expected" not in about.fault, "it is part of another sentence"
            assert about.whole == 0 and about.damaged == about.frames
            assert {d.file for d in report.damaged} == {file} and not report.ok
        (folder / file).write_bytes(whole)


def test_the_file_of_another_session_is_named(copied: Find, tmp_path: Path) -> None:
    folder = copied("in place")
    record(tmp_path / "other", PLAN, rig_for(PLAN), FULL)
    shutil.copy(tmp_path / "other" / "recording.h5", folder / "recording.h5")
    assert verify(folder).files[0].fault == "the file belongs to another session"


def test_positions_never_taken_are_not_called_damaged(tmp_path: Path) -> None:
    outcome = stopped(tmp_path, PLAN, 20, FULL)
    rot_record(tmp_path / "recording.h5", 0)
    report = verify(tmp_path)
    assert len(report.never_taken) == 27 - outcome.acknowledged > 0
    assert [tuple(d.position) for d in report.damaged] == [(0, 0, 0)]
    wipe_record(tmp_path / "recording.h5", 0)
    report = verify(tmp_path)
    assert not report.damaged and report.lacking == 1 and not report.ok, "a record of zeros is one never written"


@pytest.mark.long
def test_a_session_can_be_checked_while_it_is_recorded(tmp_path: Path) -> None:
    reports = []
    for progress in iter_record(tmp_path, PLAN, rig_for(PLAN), FULL):
        if progress.done % 5 == 0:
            reports.append(verify(tmp_path))
    assert len(reports) > 4 and all(r.ok for r in reports)
    assert len(reports[0].never_taken) > len(reports[-1].never_taken)


def test_the_sample_recording_is_whole_and_one_bit_of_it_is_found(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(SAMPLE, tmp_path / "s"))
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


def test_progress_counts_every_frame_and_the_work_can_be_closed(kept: Find) -> None:
    records = list(iter_verify(kept("packed"), workers=2))
    assert records[0].done == 0 and records[-1].done == records[-1].total == 52
    assert {r.stage for r in records} == {"check frames"}
    work = iter_verify(kept("packed"))
    next(work)
    work.close()


@pytest.mark.long
def test_random_damage_is_never_missed(copied: Find, tmp_path: Path) -> None:
    """Bits flipped anywhere in the frames or records in use: exactly the frames they belong to are named."""
    rng = np.random.default_rng(6)
    folder = copied("in place")
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


# -- a damaged session as a source of frames -------------------------------------------------------------
EXACT = AssemblySettings(dtype="float32")


def assemble(folder: Path, out: Path | None = None, skip: bool = False, dark: str = "") -> AssemblyReport:
    recipe = CorrectionRecipe(dark=dark)
    return drain(iter_assemble_session(folder, out, recipe=recipe, settings=EXACT, skip_damaged=skip))


@pytest.mark.parametrize("rot", ROTS)
@pytest.mark.parametrize("how", ["in place", "packed"])
@pytest.mark.few(1)
def test_a_damaged_frame_is_refused_with_its_position_or_left_out(
    kept: Find, copied: Find, tmp_path: Path, how: str, rot: str
) -> None:
    folder = copied(how)
    ROTS[rot](folder / "recording.h5", 13)
    words = r"recording\.h5\[13\], \(z, y, x\) = \(1, 1, 1\): .*--resume.*--skip-dam"
    with pytest.raises(FileFormatError, match=words):
        assemble(folder)
    report = assemble(folder, tmp_path / "H.h5", skip=True)
    assert report.missing == (Position(1, 1, 1),)
    assert [(found.label, found.position) for found in report.left_out] == [("recording.h5[13]", (1, 1, 1))]
    plain = assemble(kept(how), skip=True)
    assert plain.left_out == () and "left_out" not in plain.matrix.provenance
    whole = plain.matrix
    with open_psf(tmp_path / "H.h5", check=True) as matrix:
        assert matrix.recorded[1, 1, 1] == 0 and int(matrix.recorded.sum()) == 26
        (noted,) = matrix.provenance["left_out"]
        assert (noted["label"], noted["position"]) == ("recording.h5[13]", [1, 1, 1])
        for z in range(3):
            there = matrix.recorded[z] > 0
            assert np.array_equal(matrix.plane(z)[there], whole.plane(z)[there])


def test_a_frame_recorded_again_replaces_a_damaged_one_but_never_the_other_way(copied: Find, tmp_path: Path) -> None:
    folder = copied("packed")
    rot_frame(folder / "recording.h5", 5)  # recorded again since
    assert assemble(folder).missing == ()
    rot_frame(folder / "recording-002.h5", 1)  # (2, 0, 0): the older frame was not good enough
    with pytest.raises(FileFormatError, match=r"recording-002\.h5\[1\], \(z, y, x\) = \(2, 0, 0\)"):
        assemble(folder)
    assert assemble(folder, skip=True).missing == (Position(2, 0, 0),)


@pytest.mark.few(1)
@pytest.mark.parametrize("rot", ROTS)
def test_a_damaged_dark_is_refused_or_left_out(copied: Find, rot: str) -> None:
    folder = copied("packed")
    ROTS[rot](folder / "darks.h5", 1)
    with pytest.raises(FileFormatError, match=r"dark frame: darks\.h5\[1\]: .*--skip-damaged"):
        assemble(folder)
    report = assemble(folder, skip=True)
    assert [(found.label, found.position) for found in report.left_out] == [("darks.h5[1]", None)]
    session = SessionFile.read(folder)
    file = RecordedFile(folder, session, 0, session.schedule(0), Kind.DARK)
    with RecordingSource(folder, skip_damaged=True) as source:
        (dark,) = source.metadata.darks.values()
        assert np.array_equal(dark.frame, file.read(0)), "the mean of the whole ones"
    file.close()


def test_damaged_darks_are_never_replaced_by_nothing(copied: Find) -> None:
    folder = copied("packed")
    for rot, slot in (("record of zeros", 1), ("bit of a frame", 0)):
        ROTS[rot](folder / "darks.h5", slot)
    with pytest.raises(InputError, match=r"recorded dark frames: expected intact dark frames of 0\.02 s exposure"):
        assemble(folder, skip=True)
    (folder / "darks.h5").unlink()
    for skip in (False, True):
        with pytest.raises((InputError, OSError), match=r"darks\.h5|recorded dark frames"):
            assemble(folder, skip=skip)
    settings = replace(EXACT, keep_pedestal=True)
    recipe = CorrectionRecipe(dark="none")
    report = drain(iter_assemble_session(folder, recipe=recipe, settings=settings, skip_damaged=True))
    assert len(report.left_out) == 2 and not report.missing


def test_frames_of_a_short_or_lost_file_are_left_out(copied: Find, tmp_path: Path) -> None:
    folder = copied("in place")
    path = folder / "recording.h5"
    whole = path.read_bytes()
    cut(path, len(whole) - 4096)
    words = r"recording\.h5: the file is cut short: \d+ of \d+ bytes; .* lfcal verify lists"
    with pytest.raises(FileFormatError, match=words):
        assemble(folder)
    report = assemble(folder, skip=True)
    assert 1 <= len(report.missing) <= 6 and report.missing[-1] == Position(2, 2, 2)
    path.write_bytes(whole)
    wipe(path, 0)
    assert assemble(folder, skip=True).missing == (), "its header alone is gone"
    path.unlink()
    assert len(assemble(folder, skip=True).missing) == 25, "the recording of two positions is there"
    (folder / "recording-002.h5").unlink()
    with pytest.raises(FileFormatError, match="expected at least one readable frame, got only damaged ones"):
        assemble(folder, skip=True)


def test_a_lost_record_of_a_complete_session_is_not_a_position_never_taken(copied: Find, tmp_path: Path) -> None:
    folder = copied("in place")
    wipe_record(folder / "recording.h5", 20)
    with RecordingSource(folder) as source:
        assert len(source) == 27
        info = source.info(20)
        assert (info.position, info.exposure_s, info.label) == (Position(2, 0, 2), 0.02, "recording.h5[20]")
        assert info.origin == source.info(11).origin, "where the plan has it"
        with pytest.raises(FileFormatError, match="expected the recorded bytes"):
            source.read(20)


def test_a_whole_session_opens_without_room_for_temporary_files(kept: Find, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryDirectory", full)
    for how in ("in place", "packed"):
        with RecordingSource(kept(how)) as source:
            assert source.read(0).size
