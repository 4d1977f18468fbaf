"""``lfcal verify``, and what `acquire` and `assemble` do with what it finds."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.acquire.redo import RedoList
from lfcal.frames.source import Position
from lfcal.psf import PSFMatrix, open_psf, save
from tests.acquire.rigs import small_plan
from tests.acquire.rotting import flip, rot_frame
from tests.cli.conftest import Run

Lfcal = Callable[..., Run]
SAMPLE = Path(__file__).parents[2] / "sample_data" / "recorded"


@pytest.fixture
def sample(tmp_path: Path) -> Path:
    return Path(shutil.copytree(SAMPLE, tmp_path / "recorded"))


def test_a_whole_session_and_its_h(lfcal: Lfcal, sample: Path, tmp_path: Path) -> None:
    run = lfcal("verify", sample)
    assert (run.code, run.out, run.err) == (0, f"{sample}: This session is intact in 636 of 636 frames.\n", "")
    assert lfcal("assemble", sample, "-o", tmp_path / "H.h5").code == 0
    run = lfcal("verify", tmp_path / "H.h5", "--workers", 1)
    assert run.code == 0 and "This H file is intact in 1 of 1 plane (compared with their checksums)" in run.out


@pytest.mark.parametrize("name", ["gone.npy", "gone.h5", "recording.h5", "gone"])
def test_what_is_not_there_is_said_first(lfcal: Lfcal, tmp_path: Path, name: str) -> None:
    for more in ((), ("--redo", tmp_path / "redo.json")):
        run = lfcal("verify", tmp_path / name, *more)
        assert (run.code, run.err) == (2, f"lfcal: {tmp_path / name}: no such file or folder; check the path\n")


def test_one_damaged_frame_is_named_listed_and_left_out(lfcal: Lfcal, sample: Path, tmp_path: Path) -> None:
    rot_frame(sample / "recording.h5", 400)
    run = lfcal("verify", sample, "--redo", tmp_path / "redo.json")
    assert run.code == 1 and run.err == ""
    assert "What remains is intact in 635 of 636 frames." in run.out
    assert "should not be used as it is: damaged position frames. Damaged position frames: 1 frame in rec" in run.out
    assert "position (z, y, x) = (0, 12, 4), recording.h5[400]: frame damaged" in run.out
    assert "Record these frames again (lfcal acquire --resume)." in run.out and "1 position to record again" in run.out
    assert RedoList.read(tmp_path / "redo.json").positions == (Position(0, 12, 4),)
    refused = lfcal("assemble", sample, "-o", tmp_path / "H.h5")
    assert refused.code == 2 and refused.err.count("\n") == 1
    assert "recording.h5[400], (z, y, x) = (0, 12, 4): " in refused.err
    assert "--resume" in refused.err and "--skip-damaged" in refused.err
    assert not (tmp_path / "H.h5").exists()
    kept = lfcal("assemble", sample, "-o", tmp_path / "H.h5", "--skip-damaged")
    assert kept.code == 0 and "left out: recording.h5[400], (z, y, x) = (0, 12, 4)" in kept.err
    assert lfcal("verify", sample, "--redo", tmp_path / "redo.json").code == 2, "an earlier list is not replaced"
    assert lfcal("verify", sample, "--redo", tmp_path / "redo.json", "--force").code == 1
    data: Any = lfcal("assemble", sample, "-o", tmp_path / "H.h5", "--force", "--skip-damaged", "--json").json
    assert data["missing"] == [[0, 12, 4]] and data["left_out"][0]["position"] == [0, 12, 4]
    with open_psf(tmp_path / "H.h5") as matrix:
        assert matrix.recorded[0, 12, 4] == 0
    assert (
        "Positions never recorded: 1 position. Record these positions, or fill them"
        in lfcal("verify", tmp_path / "H.h5").out
    )


def test_json_lists_everything(lfcal: Lfcal, sample: Path) -> None:
    for slot in range(30):
        rot_frame(sample / "recording.h5", slot)
    text = lfcal("verify", sample).out
    assert "and 10 more (--json lists all)" in text and text.count("frame damaged") == 20
    run = lfcal("verify", sample, "--json")
    found: Any = run.json
    assert run.code == 1 and not found["ok"] and len(found["damaged"]) == len(found["to_redo"]) == 30
    assert found["damaged"][0] == {
        "file": "recording.h5",
        "slot": 0,
        "kind": "position",
        "position": [0, 0, 0],
        "what": "frame damaged",
        "replaced": False,
    }


@pytest.mark.long
def test_resume_takes_damaged_frames_again(lfcal: Lfcal, tmp_path: Path) -> None:
    plan, session = tmp_path / "plan.json", tmp_path / "session"
    plan.write_text(small_plan().to_json())
    options = ("acquire", plan, "--out", session, "--no-check-stage")
    assert lfcal(*options, "--assemble", tmp_path / "H.h5").code == 0
    rot_frame(session / "recording.h5", 13)
    rot_frame(session / "checks.h5", 1)
    assert lfcal("verify", session).code == 1
    run = lfcal(*options, "--resume", "--assemble", tmp_path / "again.h5")
    assert run.code == 0 and "2 damaged frames were found; those recorded now replace them" in run.out
    run = lfcal("verify", session)
    assert run.code == 0 and "recording.h5[13]: frame damaged, but recorded again since then" in run.out
    with open_psf(tmp_path / "H.h5") as before, open_psf(tmp_path / "again.h5") as after:
        assert all(np.array_equal(before.plane(z), after.plane(z)) for z in range(3))


@pytest.mark.long
def test_a_redo_list_of_verify_is_recorded(lfcal: Lfcal, tmp_path: Path) -> None:
    plan, session, redo = tmp_path / "plan.json", tmp_path / "session", tmp_path / "redo.json"
    plan.write_text(small_plan().to_json())
    options = ("acquire", plan, "--out", session, "--no-check-stage")
    assert lfcal(*options).code == 0
    assert (
        "not written, because there are no positions" in lfcal("verify", session, "--redo", redo).out
        and not redo.exists()
    )
    rot_frame(session / "recording.h5", 13)
    assert lfcal("verify", session, "--redo", redo).code == 1
    assert lfcal(*options, "--redo", redo).code == 0
    assert lfcal("verify", session).code == 0


def test_damage_of_h_is_located(lfcal: Lfcal, tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((2, 3, 3, 9, 9)).astype(np.float32)
    path = save(PSFMatrix(values), tmp_path / "H.h5")

    with h5py.File(path) as file:
        info = file["H"].id.get_chunk_info_by_coord((1, 2, 0, 0, 0))
    flip(path, int(info.byte_offset) + 20)
    run = lfcal("verify", path)
    assert run.code == 1 and "plane 1: damaged at (z, y, x) = (1, 2, 0)" in run.out
    found: Any = lfcal("verify", path, "--json").json
    assert found["damaged"] == [{"region": "", "z": 1, "what": "damaged", "positions": [[1, 2, 0]]}]


def test_what_cannot_be_checked_is_refused_in_one_line(lfcal: Lfcal, sample: Path, tmp_path: Path) -> None:
    (tmp_path / "text.h5").write_text("text")
    (tmp_path / "empty").mkdir()
    cases: list[tuple[object, ...]] = [
        (tmp_path / "none",),
        (tmp_path / "text.h5",),
        (tmp_path / "empty",),
        (sample / "recording.h5",),
        (sample / "session.json",),
        (tmp_path / "text.h5", "--redo", tmp_path / "r.json"),
    ]
    for arguments in cases:
        run = lfcal("verify", *arguments)
        assert run.code == 2 and run.err.count("\n") == 1 and not run.out, arguments
    rot_frame(sample / "recording.h5", 3)
    before = (sample / "session.json").read_bytes()
    run = lfcal("verify", sample, "--redo", sample / "session.json")
    assert run.code == 2 and run.err.count("\n") == 1
    assert (sample / "session.json").read_bytes() == before, "what is no list is never replaced by one"
    assert "name its folder" in lfcal("verify", sample / "recording.h5").err


def test_a_file_that_is_not_as_specified_is_told_where(lfcal: Lfcal, tmp_path: Path) -> None:
    H = PSFMatrix(np.ones((2, 3, 3, 5, 5), np.float32))
    path = save(H, tmp_path / "H.h5")
    save(H.T, tmp_path / "HT.h5")
    assert lfcal("verify", path).code == lfcal("verify", tmp_path / "HT.h5").code == 0
    with h5py.File(path, "r+") as file:
        del file["used_window"], file.attrs["region"]
    run = lfcal("verify", path)
    assert run.code == 1 and "deviation from the format: /used_window: missing" in run.out
    assert "deviation from the format: , attribute" not in run.out and "/, attribute region: missing" in run.out
    found: Any = lfcal("verify", path, "--json").json
    assert not found["ok"] and len(found["deviations"]) == 2
