"""A damaged session as frames: refused with the position, or without what is damaged, and never silently."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.acquire.finish import iter_assemble_session, iter_finish
from lfcal.acquire.recording._recorded import RecordedFile
from lfcal.acquire.recording.records import Kind
from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.session import record
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import FileFormatError, InputError
from lfcal.base.progress import drain
from lfcal.frames import CorrectionRecipe
from lfcal.frames.source import Position
from lfcal.psf import AssemblyReport, AssemblySettings, open_psf
from tests.acquire.rigs import CAREFUL, rig_for, small_plan
from tests.acquire.rotting import ROTS, cut, rot_frame, wipe, wipe_record

PLAN = small_plan()
FULL = replace(CAREFUL, darks=2, dark_every=14, reference_every=9)
EXACT = AssemblySettings(dtype="float32")


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("damaged")
    record(folder / "in place", PLAN, rig_for(PLAN), FULL)
    record(folder / "in place", PLAN, rig_for(PLAN, seed=2), FULL, redo=[Position(0, 1, 2), Position(2, 0, 0)])
    shutil.copytree(folder / "in place", folder / "packed")
    drain(iter_finish(folder / "packed"))
    return {name: folder / name for name in ("in place", "packed")}


def copy_of(session: Path, to: Path) -> Path:
    return Path(shutil.copytree(session, to / "s"))


def assemble(folder: Path, out: Path | None = None, skip: bool = False, dark: str = "") -> AssemblyReport:
    recipe = CorrectionRecipe(dark=dark)
    return drain(iter_assemble_session(folder, out, recipe=recipe, settings=EXACT, skip_damaged=skip))


@pytest.mark.parametrize("rot", ROTS)
@pytest.mark.parametrize("how", ["in place", "packed"])
@pytest.mark.few(4)
def test_refused_with_the_position_or_left_out(sessions: dict[str, Path], tmp_path: Path, how: str, rot: str) -> None:
    folder = copy_of(sessions[how], tmp_path)
    ROTS[rot](folder / "recording.h5", 13)
    with pytest.raises(
        FileFormatError, match=r"recording\.h5\[13\], \(z, y, x\) = \(1, 1, 1\): .*--resume.*--skip-dam"
    ):
        assemble(folder)
    report = assemble(folder, tmp_path / "H.h5", skip=True)
    assert report.missing == (Position(1, 1, 1),)
    assert [(found.label, found.position) for found in report.left_out] == [("recording.h5[13]", (1, 1, 1))]
    whole = assemble(sessions[how]).matrix
    with open_psf(tmp_path / "H.h5", check=True) as matrix:
        assert matrix.recorded[1, 1, 1] == 0 and int(matrix.recorded.sum()) == 26
        (noted,) = matrix.provenance["left_out"]
        assert (noted["label"], noted["position"]) == ("recording.h5[13]", [1, 1, 1])
        for z in range(3):
            there = matrix.recorded[z] > 0
            assert np.array_equal(matrix.plane(z)[there], whole.plane(z)[there])


def test_a_frame_recorded_again_replaces_a_damaged_one_but_never_the_other_way(
    sessions: dict[str, Path], tmp_path: Path
) -> None:
    folder = copy_of(sessions["packed"], tmp_path)
    rot_frame(folder / "recording.h5", 5)  # recorded again since
    assert assemble(folder).missing == ()
    rot_frame(folder / "recording-002.h5", 1)  # (2, 0, 0): the older frame was not good enough
    with pytest.raises(FileFormatError, match=r"recording-002\.h5\[1\], \(z, y, x\) = \(2, 0, 0\)"):
        assemble(folder)
    assert assemble(folder, skip=True).missing == (Position(2, 0, 0),)


def test_a_whole_session_is_the_same_with_and_without(sessions: dict[str, Path], tmp_path: Path) -> None:
    one, two = assemble(sessions["packed"]), assemble(sessions["packed"], tmp_path / "H.h5", skip=True)
    assert two.left_out == () and "left_out" not in two.matrix.provenance
    with two.matrix as matrix:
        assert all(np.array_equal(one.matrix.plane(z), matrix.plane(z)) for z in range(3))


@pytest.mark.parametrize("rot", ROTS)
def test_darks_are_averaged_over_the_whole_ones(sessions: dict[str, Path], tmp_path: Path, rot: str) -> None:
    folder = copy_of(sessions["packed"], tmp_path)
    ROTS[rot](folder / "darks.h5", 1)
    with pytest.raises(FileFormatError, match=r"dark frame: darks\.h5\[1\]: .*--skip-damaged"):
        assemble(folder)
    report = assemble(folder, skip=True)
    assert [(found.label, found.position) for found in report.left_out] == [("darks.h5[1]", None)]
    session = SessionFile.read(folder)
    file = RecordedFile(folder, session, 0, session.schedule(0), Kind.DARK)
    with RecordingSource(folder, skip_damaged=True) as source:
        (dark,) = source.metadata.darks.values()
        assert np.array_equal(dark.frame, file.read(0))
    file.close()


def test_without_a_whole_dark_frame_nothing_is_subtracted_in_its_place(
    sessions: dict[str, Path], tmp_path: Path
) -> None:
    folder = copy_of(sessions["packed"], tmp_path)
    for slot in (0, 1):
        rot_frame(folder / "darks.h5", slot)
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


def test_what_a_short_or_lost_file_held_is_left_out(sessions: dict[str, Path], tmp_path: Path) -> None:
    folder = copy_of(sessions["in place"], tmp_path)
    path = folder / "recording.h5"
    whole = path.read_bytes()
    cut(path, len(whole) - 4096)
    with pytest.raises(
        FileFormatError, match=r"recording\.h5: the file is cut short: \d+ of \d+ bytes; .* lfcal verify lists"
    ):
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


def test_a_lost_record_of_a_complete_session_is_not_a_position_never_taken(
    sessions: dict[str, Path], tmp_path: Path
) -> None:
    folder = copy_of(sessions["in place"], tmp_path)
    wipe_record(folder / "recording.h5", 20)
    with RecordingSource(folder) as source:
        assert len(source) == 27
        info = source.info(20)
        assert (info.position, info.exposure_s, info.label) == (Position(2, 0, 2), 0.02, "recording.h5[20]")
        assert info.origin == source.info(11).origin, "where the plan has it"
        with pytest.raises(FileFormatError, match="expected the recorded bytes"):
            source.read(20)


def test_a_whole_session_opens_without_room_for_temporary_files(
    sessions: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryDirectory", full)
    for folder in sessions.values():
        with RecordingSource(folder) as source:
            assert source.read(0).size
