"""``lfcal assemble`` in units of a plane: the same file by every executor, whatever was asked of the frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfcal.acquire import RedoList
from lfcal.camera import ScanPlan
from lfcal.frames import CorrectionRecipe
from lfcal.psf import open_psf
from lfcal.records import from_dict
from lfcal.tasks import Assemble
from lfcal.work import parts_folder
from tests.cli.conftest import Run
from tests.psf.test_joining import contents

Lfcal = Callable[..., Run]


@pytest.fixture
def scan(session: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a session, the current folder, that lacks a position, has one twice, and has a damaged frame."""
    monkeypatch.chdir(session)
    frames = session / "frames"
    manifest = frames / "manifest.csv"
    lines = [line for line in manifest.read_text().splitlines() if not line.startswith("z0_y1_x1")]
    again = cv2.imread(str(frames / "z1_y0_x2.png"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(frames / "again.png"), again + np.uint16(7))
    manifest.write_text("\n".join([*lines, "again.png,1,0,2"]) + "\n")
    damaged = frames / "z1_y2_x3.png"
    damaged.write_bytes(damaged.read_bytes()[:200])
    return session


WORDS = ("assemble", "frames", "--dark", "dark", "--white", "white", "--white-mode", "pixels", "--skip-damaged")


@pytest.mark.parametrize(
    ("dtype", "executor"),
    [
        ("float32", "processes"),
        pytest.param("rounded", "threads", marks=pytest.mark.long),
        pytest.param("rounded", "dask", marks=pytest.mark.long),
        pytest.param("float32", "threads", marks=pytest.mark.long),
        pytest.param("rounded", "processes", marks=pytest.mark.long),
        pytest.param("float32", "dask", marks=pytest.mark.long),
    ],
)
def test_the_same_file_by_whoever(lfcal: Lfcal, scan: Path, dtype: str, executor: str) -> None:
    if executor == "dask":
        pytest.importorskip("distributed", reason="dask.distributed is not installed")
    words = (*WORDS, "--dtype", dtype, "--pad", "--cutout", "39,11", "--interpolation", "linear")
    one = lfcal(*words, "-o", "one.h5")
    assert one.code == 0, one.err
    two = lfcal(*words, "-o", "two.h5", "--executor", executor, "--workers", 2)
    assert two.code == 0, two.err
    assert contents(scan / "one.h5") == contents(scan / "two.h5")
    assert not parts_folder(scan / "two.h5").exists()

    def told(text: str) -> list[str]:
        return [line for line in text.splitlines() if line.startswith("This H ")]

    assert told(one.out) == told(two.out) and "padded" in two.out and "damaged frames left out" in two.out
    assert [one.err.splitlines()[-1]] == [two.err.splitlines()[-1]] and "left out: " in two.err
    with open_psf("two.h5") as H:
        assert H.recorded[0, 1, 1] == 0 and H.recorded[1, 0, 2] == 2 and H.recorded[1, 2, 3] == 0


@pytest.mark.parametrize("more", [(), ("--executor", "processes", "--workers", 1)], ids=["at once", "in units"])
def test_positions_that_are_left_out(lfcal: Lfcal, scan: Path, more: tuple[object, ...]) -> None:
    RedoList.of([(0, 2, 3), (1, 0, 2), (0, 1, 1)]).write(scan / "redo.json")
    run = lfcal(*WORDS, "-o", "H.h5", "--leave-out", "redo.json", *more)
    assert run.code == 0, run.err
    whole = lfcal(*WORDS, "-o", "whole.h5")
    assert whole.code == 0 and "left out: " in run.err, "the damaged frame still is"
    with open_psf("H.h5") as H, open_psf("whole.h5") as before:
        gone = np.argwhere((H.recorded == 0) & (before.recorded > 0)).tolist()
        assert gone == [[0, 2, 3], [1, 0, 2]], "all frames of a position, and no other"
        assert not H[0, 2, 3].any() and np.array_equal(H[0, 2, 2], before[0, 2, 2])
        assert H.provenance["positions_left_out"] == [[0, 2, 3], [1, 0, 2], [0, 1, 1]]
        assert len(H.provenance["left_out"]) == 1


def test_a_list_of_all_positions_is_refused(lfcal: Lfcal, session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(session)
    RedoList.of(list(np.ndindex(*ScanPlan.from_json(Path("plan.json").read_text()).shape[:3]))).write(Path("redo.json"))
    run = lfcal("assemble", "frames", "-o", "H.h5", "--leave-out", "redo.json")
    assert run.code == 2 and "positions to leave out; shorten the list" in run.err and not Path("H.h5").exists()


@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        ("plan.json", "--channel", ""),
        ("frames", "--orientation", "rot180", "--strict", "--keep-pedestal"),
        ("frames/manifest.csv", "--background", "30", "--defects"),
    ],
    ids=["simulated", "turned", "listed"],
)
def test_frames_that_are_opened_otherwise(
    lfcal: Lfcal, session: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(session)
    if "rot180" in words:
        for path in (session / "frames").glob("*.png"):
            cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::-1, ::-1])
    one = lfcal("assemble", *words, "-o", "one.h5")
    assert one.code == 0, one.err
    two = lfcal("assemble", *words, "-o", "two.h5", "--executor", "processes", "--workers", 1)
    assert two.code == 0, two.err
    assert contents(session / "one.h5") == contents(session / "two.h5")


def test_one_file_of_each_colour(lfcal: Lfcal, session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(session)
    (session / "rgb").mkdir()
    for path in (session / "frames").glob("*.png"):
        grey = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(session / "rgb" / path.name), np.dstack([grey // 3, grey, grey // 2]))
    (session / "rgb" / "manifest.csv").write_text((session / "frames" / "manifest.csv").read_text())
    words = ("assemble", "rgb", "--channel", "each", "--keep-pedestal")
    assert lfcal(*words, "-o", "one.h5").code == 0
    run = lfcal(*words, "-o", "two.h5", "--executor", "threads", "--workers", 1)
    assert run.code == 0, run.err
    for colour in "RGB":
        assert contents(session / f"one_{colour}.h5") == contents(session / f"two_{colour}.h5")


def test_a_frame_that_is_damaged_ends_in_a_line_and_is_mended(
    lfcal: Lfcal, session: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(session)
    words = ("assemble", "frames", "--dark", "dark", "-o", "H.h5")
    assert lfcal(*words[:-1], "whole.h5").code == 0
    damaged = session / "frames" / "z1_y0_x1.png"
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:200])
    stopped = lfcal(*words, "--executor", "threads", "--orientation", "as-is")
    assert stopped.code == 2 and "(z, y, x) = (1, 0, 1)" in stopped.err and "--skip-damaged" in stopped.err
    assert "kept: 1 of 2 units in H.h5.parts; --resume continues with them" in stopped.err
    assert not (session / "H.h5").exists()
    damaged.write_bytes(whole)
    refused = lfcal(*words)
    assert refused.code == 2 and "left 1 of 2 units" in refused.err
    assert lfcal(*words, "--resume").code == 0
    assert contents(session / "H.h5") == contents(session / "whole.h5")
    assert not parts_folder(session / "H.h5").exists()


def test_bad_input_leaves_nothing(lfcal: Lfcal, session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(session)
    before = {path.name for path in session.iterdir()}
    for words, said in (
        (("--strict", "--cutout", "41,11"), "rows"),
        (("--dark", "nowhere"), "nowhere"),
        (("--executor", "magic"), "dask, processes or threads"),
        (("--scheduler", "tcp://127.0.0.1:1", "--executor", "processes"), "an executor with a scheduler (dask)"),
    ):
        chosen = () if "--executor" in words else ("--executor", "processes", "--workers", 1)
        run = lfcal("assemble", "frames", "-o", "H.h5", "--keep-pedestal", *words, *chosen)
        assert run.code == 2 and said in run.err and "Traceback" not in run.err, run.err
        assert {path.name for path in session.iterdir()} == before


def test_frames_are_opened_again_from_plain_values(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    corrections = CorrectionRecipe(dark="d")
    given = Assemble(frames=Path("frames"), out=Path("H.h5"), pattern="z{z}.png", first=1, corrections=corrections)
    told = given.to_dict(absolute=True)
    assert told.pop("task") == "assemble" and told["corrections"]["dark"] == str(tmp_path / "d")
    same = from_dict(Assemble, told)
    assert same.frames == tmp_path / "frames" and (same.pattern, same.first) == (given.pattern, 1)


@pytest.mark.parametrize("more", [(), ("--executor", "threads", "--workers", 1), ("--executor", "processes")])
@pytest.mark.few(2)
def test_assembled_into_a_small_file(lfcal: Lfcal, scan: Path, more: tuple[object, ...]) -> None:
    """Every pattern lacks at most its share of what is stored in full, padded and missing ones too."""
    words = (*WORDS, "--pad", "--cutout", "39,11", "-o")
    assert lfcal(*words, "full.h5", "--dtype", "float32").code == 0
    run = lfcal(*words, "small.h5", "--store-tolerance", 0.01, *more)
    assert run.code == 0, run.err
    with open_psf("full.h5") as H, open_psf("small.h5") as small:
        full, found = (np.asarray(one, np.float64) for one in (H, small))
        lacks, light = (np.abs(a).sum(axis=(3, 4)) for a in (found - full, full))
        assert (lacks <= 0.01 * light).all() and (lacks > 0).any()
        assert (light == 0).any()  # a position that nobody recorded
        worst = (lacks / np.maximum(light, 1e-9)).max()
        # the bound adds two sums that are added in another order here
        assert small.facts.bound is not None and small.facts.bound.max() >= worst * (1 - 1e-14)
    if more:
        assert lfcal(*words, "one.h5", "--store-tolerance", 0.01).code == 0
        assert contents(Path("one.h5")) == contents(Path("small.h5"))


def test_a_store_tolerance_that_fits_nothing(lfcal: Lfcal, scan: Path) -> None:
    for given in (("--store-tolerance", 2), ("--store-tolerance", 0.01, "--dtype", "float32")):
        run = lfcal("assemble", "frames", "-o", "o.h5", *given)
        assert run.code == 2 and run.err.count("\n") == 1
        assert "expected a number > 0 and < 1" in run.err or "expected --dtype rounded, got float32" in run.err
        assert not Path("o.h5").exists() and not parts_folder("o.h5").exists()
