"""Results in folders: what each is follows from its content, and nothing large is read."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError, StorageError
from lfcal.base.h5.reading import H5Data
from lfcal.base.progress import drain
from lfcal.judge.results import (
    MOST_IMAGES,
    ListingProgress,
    ResultList,
    detailed,
    find_results,
    iter_find_results,
    picture_of,
    read_result,
)
from lfcal.psf import PSFMatrix, export, save
from lfcal.reconstruct import save_volume
from lfcal.simulate import sample_recording
from tests.judge.test_trend import write_fit

DEPTHS = (-2000.0, -1000.0)
QUALITY = {"format": "lfcal-quality", "metrics": [], "verdict": "This H is good.", "merit": "good", "model": None}


def matrix(light: float = 1.0) -> PSFMatrix:
    values = np.full((2, 3, 4, 5, 5), light, np.float32)
    values[1] *= 2
    return PSFMatrix(values, depths=DEPTHS)


@pytest.fixture
def one_of_each(tmp_path: Path) -> Path:
    """Return a folder with a result of every kind, in folders of its own where it has one."""
    shutil.copytree(sample_recording(), tmp_path / "may" / "recorded")
    H = matrix()
    save(H, tmp_path / "may" / "H.h5")
    (tmp_path / "exports").mkdir()
    for name in ("H.mat", "H.npy", "H.tif"):
        export(H, tmp_path / "exports" / name)
    write_fit(tmp_path / "fit", 30, {"gap_um": 400.0})
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "quality.json").write_text(json.dumps(QUALITY | {"inspected": "2026-05-01T00:00:00+00:00"}))
    volume = np.arange(60.0).reshape(3, 4, 5)
    for name in ("v.tif", "v.ome.tif", "v.h5", "v.npy"):
        save_volume(tmp_path / name, volume, depths_um=[-10, 0, 10], voxel_um=1.4)
    return tmp_path


def kinds(found: ResultList) -> dict[str, str]:
    return {one.path.name: one.kind for one in found.results}


def check_pictures(found: ResultList) -> None:
    """Pictures of results are those of their middle plane, or their sum."""
    for one in found.results:
        picture = picture_of(one)
        if one.kind in ("fit", "report"):
            assert picture is None
        elif one.kind == "volume":
            np.testing.assert_array_equal(picture, np.arange(20.0, 40).reshape(4, 5))
        elif one.kind == "H":
            np.testing.assert_array_equal(picture, np.full((5, 5), 2.0 * 12))
        else:
            assert picture is not None and picture.ndim == 2 and picture.max() > 0, one.path


def test_each_kind_is_found_by_its_content_with_its_picture(one_of_each: Path) -> None:
    found = find_results(one_of_each)
    assert kinds(found) == {
        "recorded": "recording",
        "H.h5": "H",
        "H.mat": "export",
        "H.npy": "export",
        "H.tif": "export",
        "fit": "fit",
        "report": "report",
        **dict.fromkeys(("v.tif", "v.ome.tif", "v.h5", "v.npy"), "volume"),
    }
    by_name = {one.name: one for one in found.results}
    assert (by_name["report"].verdict, by_name["report"].merit) == ("This H is good.", "good")
    assert by_name["recorded"].verdict == "complete: 627 positions" and by_name["recorded"].dated
    assert by_name["H.h5"].verdict == "" and by_name["H.h5"].merit == "unknown", "judged nowhere"
    facts = {name: dict(one.facts) for name, one in by_name.items()}
    for name in ("H.h5", "H.mat", "H.npy"):
        assert (facts[name]["Period"], facts[name]["Cutout"], facts[name]["Planes"]) == ("3 × 4", "5 × 5", "2")
    assert facts["H.h5"]["Depths"] == "-2 mm to -1 mm" and facts["v.tif"]["Shape"] == "3 × 4 × 5"
    assert not found.notes and [one.when for one in found.results] == sorted(
        (one.when for one in found.results), reverse=True
    )
    assert json.loads(json.dumps(by_name["fit"].to_dict()))["facts"]["gap_um"].startswith("400 ±")
    check_pictures(found)


def test_an_ome_zarr_has_a_picture_and_a_missing_chunk_a_reason(tmp_path: Path) -> None:
    pytest.importorskip("zarr", reason="zarr is not installed")
    volume = np.arange(60.0).reshape(3, 4, 5)
    save_volume(tmp_path / "v.ome.zarr", volume, depths_um=[-10, 0, 10])
    (one,) = find_results(tmp_path).results
    assert one.kind == "volume" and dict(one.facts)["Depths"] == "-10 µm to 10 µm"
    np.testing.assert_array_equal(picture_of(one), volume[1])
    for chunk in (one.path / "0" / "0" / "1").rglob("*"):
        if chunk.is_file():
            chunk.write_bytes(b"damaged")
    with pytest.raises(FileFormatError, match="intact chunks"):
        picture_of(one)


def test_damaged_and_half_written_results_have_a_reason(one_of_each: Path) -> None:
    for name in ("may/H.h5", "exports/H.npy", "v.tif", "v.h5"):
        whole = (one_of_each / name).read_bytes()
        (one_of_each / name).write_bytes(whole[: len(whole) // 2])
    session = one_of_each / "may" / "recorded" / "session.json"
    session.write_text(session.read_text()[:500])
    (one_of_each / "fit" / "fit.json").write_text('{"format": "lfcal-fit"}')
    (one_of_each / "report" / "quality.json").write_text("[]")
    (one_of_each / "empty.h5").touch()
    found = {one.name: one for one in find_results(one_of_each).results}
    for name in ("H.h5", "H.npy", "v.tif", "v.h5", "recorded", "fit", "report", "empty.h5"):
        assert found[name].kind == "unreadable" and name in found[name].problem and "\n" not in found[name].problem
    assert found["H.mat"].kind == "export" and picture_of(found["H.h5"]) is None


def test_recordings_state_their_progress_light_and_missing_frames(tmp_path: Path) -> None:
    one = read_result(sample_recording())
    assert one is not None and "Light per frame" not in dict(one.facts), "read only on request"
    facts = dict(detailed(one).facts)
    assert facts["Light per frame"].endswith("%") and facts["Saturated frames"] == "0"
    folder = shutil.copytree(sample_recording(), tmp_path / "stopped")
    data = json.loads((folder / "session.json").read_text())
    data["runs"][0] |= {"how": "stopped", "acknowledged": 100}
    (folder / "session.json").write_text(json.dumps(data))
    stopped = read_result(folder)
    assert stopped is not None and (stopped.verdict, stopped.merit) == ("unfinished: 100 of 627 positions", "fair")
    (folder / "recording.h5").unlink()
    gone = read_result(folder)
    assert gone is not None and "recording.h5: expected the recorded frames" in gone.problem


def test_files_of_other_programs_are_left_out(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "theirs.h5", "w") as file:
        file["data"] = np.zeros(4)
    (tmp_path / "old.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    np.save(tmp_path / "frames.npy", np.zeros((4, 8, 8), np.uint16))
    tifffile.imwrite(tmp_path / "photo.tif", np.zeros((8, 8), np.uint16))
    (tmp_path / "notes.txt").write_text("lfcal")
    (tmp_path / "H.h5.parts").mkdir()
    save(matrix(), tmp_path / "H.h5.parts" / "plane.h5")
    assert find_results(tmp_path) == ResultList(())
    assert read_result(tmp_path) is None


def test_a_folder_of_frames_is_not_read_frame_by_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for k in range(3 * MOST_IMAGES):
        (tmp_path / f"{k:04d}.tif").write_bytes(b"II*\0")
    opened: list[Path] = []
    plain = Path.open
    monkeypatch.setattr(Path, "open", lambda self, *args, **kw: opened.append(self) or plain(self, *args, **kw))
    assert not find_results(tmp_path).results and len(set(opened)) == MOST_IMAGES


@pytest.mark.parametrize("count", [20, pytest.param(500, marks=pytest.mark.long)])
def test_many_are_listed_without_reading_a_matrix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    path = save(matrix(), tmp_path / "H.h5")
    for k in range(1, count):
        shutil.copy(path, tmp_path / f"H{k}.h5")
    (tmp_path / "other").mkdir()
    save(matrix(), tmp_path / "other" / "H.h5")
    find_results(tmp_path / "other")  # starts the process that reads files first
    read: list[str] = []
    plain = H5Data.read
    monkeypatch.setattr(H5Data, "read", lambda self, *index: read.append(self.name) or plain(self, *index))
    start, steps = time.process_time(), []
    found = drain(iter_find_results(tmp_path, depth=0), steps.append)
    assert count < 500 or time.process_time() - start < 0.02 * count, "10 s for 500"
    assert len(found.results) == count and set(read) == {"depths"}
    listed = [one for step in steps if isinstance(step, ListingProgress) for one in step.found]
    assert {one.path for one in listed} == {one.path for one in found.results} and len(listed) == count


def test_folders_and_files_that_vanish_are_noted(one_of_each: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = one_of_each / "may" / "H.h5"

    def lost(*_: object, **__: object) -> None:
        path.unlink()
        raise StorageError(f"{path}: no such file")

    with monkeypatch.context() as patch:
        patch.setattr("lfcal.judge.results.H5File", lost)
        found = find_results(path.parent)
        assert all(one.kind == "recording" for one in found.results) and "H.h5" in found.notes[0]
    assert "no such" in find_results(one_of_each / "nowhere").notes[0].lower()
    work = iter_find_results(one_of_each, one_of_each / "gone")
    next(work)
    shutil.rmtree(one_of_each)
    found = drain(work)
    assert found.notes and all("\n" not in note for note in found.notes)
    assert not any(one.kind == "unreadable" for one in found.results)


def test_deep_folders_are_noted_and_loops_end(tmp_path: Path) -> None:
    deep = tmp_path / "a" / "b"
    deep.mkdir(parents=True)
    save(matrix(), deep / "H.h5")
    (deep / "c").mkdir()
    (deep / "loop").symlink_to(tmp_path, target_is_directory=True)
    assert kinds(find_results(tmp_path)) == {"H.h5": "H"}
    shallow = find_results(tmp_path, depth=1)
    assert not shallow.results and "nested too deeply" in shallow.notes[0]


def test_the_size_of_a_zarr_volume_is_that_of_its_chunks(tmp_path: Path) -> None:
    pytest.importorskip("zarr")
    save_volume(tmp_path / "v.ome.zarr", np.random.default_rng(1).random((2, 64, 64)).astype(np.float32))
    found = read_result(tmp_path / "v.ome.zarr")
    assert found is not None and found.bytes > 16000, "the entry of the folder itself was counted"
