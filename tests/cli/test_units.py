"""Long work in units: the same files by every executor, resumed after a stop, within its threads."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
import typer.main
from threadpoolctl import threadpool_info

from lfcal.acquire import RedoList
from lfcal.acquire.session import record as record_session
from lfcal.base.errors import InputError, StorageError
from lfcal.base.progress import drain
from lfcal.base.threads import WORKERS
from lfcal.cli._app import build_app
from lfcal.fit.files import iter_write_model
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.reconstruct.volumes import load_volume
from lfcal.work import RunChoice, iter_run, parts_folder
from lfcal.work.executors.threads import Threads
from tests.acquire.rigs import CAREFUL, rig_for
from tests.acquire.rigs import small_plan as recorded_plan
from tests.cli._building import alike, two_planes
from tests.cli.conftest import Lfcal, small_plan
from tests.cli.test_options import walk
from tests.cli.writing import WRITERS
from tests.fit.commands import undrawn
from tests.fit.common import few_patterns
from tests.judge.plain_report import undrawn as without_pictures
from tests.psf.test_joining import contents
from tests.reconstruct.oracles import lenslet_psf
from tests.work.tasks import unit


# -- Long work in units on the command line: the same files by every executor, resumed after a stop, and its status --
@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder, the current one, with a scan plan, an H and three frames."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plan.json").write_text(small_plan().to_json())
    H = lenslet_psf(2, 5, 15).astype(np.float32)
    save(PSFMatrix(H, anchor=(1.0, 2.0), depths=(-5.0, 5.0)), tmp_path / "H.h5")
    frames = np.random.default_rng(0).poisson(50.0, (3, 30, 31)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "frames.tif", frames, photometric="minisblack")
    return tmp_path


def interrupted(out: Path) -> None:
    """Leave what a run that was stopped leaves: one of its two units done."""
    folder = parts_folder(out)
    units = [unit("plane 0"), unit("plane 1", "refuse")]
    with pytest.raises(ValueError, match="open the shutter"):
        drain(iter_run(units, folder, Threads(1), title=f"make {out.name}"))


def said(path: Path) -> Any:
    """Return what a volume says of how it was made."""
    with tifffile.TiffFile(path) as file:
        assert file.imagej_metadata is not None
        return json.loads(file.imagej_metadata["lfcal"])


IN_UNITS = (
    ("simulate plan.json --level geometric", ".h5"),
    ("transpose H.h5 --method exact", ".h5"),
    ("reduce H.h5", ".h5"),
    ("export H.h5", ".mat"),
)
MORE_IN_UNITS = (
    ("transpose H.h5 --method paper", ".h5"),
    *(("export H.h5", suffix) for suffix in (".h5", ".npy")),
    ("reconstruct H.h5 frames.tif -n 2 --method polyphase:2x2", ".npy"),
)


@pytest.mark.parametrize(
    ("executor", "commands"),
    [
        ("threads", IN_UNITS),
        pytest.param("threads", MORE_IN_UNITS, marks=pytest.mark.long),
        pytest.param("processes", (*IN_UNITS, *MORE_IN_UNITS), marks=pytest.mark.long),
    ],
    ids=["threads", "threads-more", "processes"],
)
def test_every_executor_writes_the_same_file(
    lfcal: Lfcal, place: Path, executor: str, commands: tuple[tuple[str, str], ...]
) -> None:
    for words, suffix in commands:
        one, two = place / f"one{suffix}", place / f"two{suffix}"
        lfcal(*words.split(), "-o", one, "--force").ok()
        lfcal(*words.split(), "-o", two, "--executor", executor, "--workers", 2, "--force").ok()
        assert listing(one) == listing(two), (words, suffix)
        assert not parts_folder(two).exists()


def test_ht_is_transposed_to_h_in_units(lfcal: Lfcal, place: Path) -> None:
    for one, two, said in (("H.h5", "HT.h5", "HT.h5: HT (2, "), ("HT.h5", "H2.h5", "H2.h5: H (2, ")):
        assert said in lfcal("transpose", one, "-o", two, "--executor", "threads").ok().out
    with open_psf(place / "H.h5") as H, open_psf(place / "H2.h5") as H2:
        np.testing.assert_array_equal(H2[:], H[:])


@pytest.mark.parametrize("more", [(), pytest.param(("--warm",), marks=pytest.mark.long)])
def test_volumes_of_a_series_are_the_same_in_units(lfcal: Lfcal, place: Path, more: tuple[str, ...]) -> None:
    words = ("reconstruct", "H.h5", "frames.tif", "-n", 3, "--method", "direct", "-o")
    lfcal(*words, "one", *more).ok()
    assert lfcal(*words, "two", *more, "--executor", "threads").ok().out.count("3 iterations") == 3
    for name in ("frames_0000.tif", "frames_0001.tif", "frames_0002.tif"):
        one, two = (place / folder / name for folder in ("one", "two"))
        np.testing.assert_array_equal(load_volume(one), load_volume(two))
        assert said(one) == said(two)
    assert not (place / "two.parts").exists()
    refused = lfcal(*words, "three", "--warm", "--executor", "processes")
    refused.refused("start each frame from the beginning")


def test_a_series_in_one_ome_zarr(lfcal: Lfcal, place: Path) -> None:
    """The same volumes as in separate files, whether or not the work was in units."""
    zarr = pytest.importorskip("zarr", reason="zarr is not installed")
    words = ("reconstruct", "H.h5", "frames.tif", "-n", 2, "--method", "sparse", "--warm", "-o")
    for out, by in (("one.ome.zarr", ()), ("two.ome.zarr", ("--executor", "threads")), ("single", ())):
        lfcal(*words, out, *by).ok()
    single = np.stack([load_volume(place / "single" / f"frames_000{k}.tif") for k in range(3)])
    for name in ("one", "two"):
        found = zarr.open_group(place / f"{name}.ome.zarr", mode="r")
        np.testing.assert_array_equal(found["0"][...], single)
        assert found.attrs["lfcal"]["details"]["frames"] == [f"frames_000{k}" for k in range(3)]
    lfcal(*words, "one.ome.zarr").refused("one.ome.zarr: exists; add --force to replace it")


ENDED = (
    ("reconstruct H.h5 frames.tif -n 1 --format .npy", "out", "lfcal.reconstruct.volumes.replace_whole"),
    ("reconstruct H.h5 frames.tif -n 1", "out.npy", "lfcal.work.choice.discard"),
    ("transpose H.h5", "ht.h5", "lfcal.work.choice.discard"),
    ("simulate plan.json --level geometric", "h.h5", "lfcal.work.choice.discard"),
)


@pytest.mark.parametrize(
    ("words", "out", "writer"), [ENDED[0], ENDED[2], *(pytest.param(*ENDED[k], marks=pytest.mark.long) for k in (1, 3))]
)
def test_a_run_that_ended_while_writing_is_resumed(
    lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch, words: str, out: str, writer: str
) -> None:
    """Part or all of its output is there: it is its own, and ``--resume`` does not ask for ``--force``."""
    command = (*words.split(), "--workers", 1, "--executor", "threads", "-o")
    lfcal(*command, f"whole_{out}").ok()
    module, _, name = writer.rpartition(".")
    real, count = getattr(importlib.import_module(module), name), iter(range(9))

    def ended(path: Any) -> Any:
        if name == "discard" or next(count) == 1:
            raise StorageError(f"{path}: the disk is gone")
        return real(path)

    with monkeypatch.context() as patch:
        patch.setattr(writer, ended)
        lfcal(*command, out).refused("the disk is gone")
    assert (place / out).exists() and parts_folder(place / out).exists()
    lfcal(*command, out).refused()
    lfcal(*command, out, "--resume").ok()
    assert listing(place / out) == listing(place / f"whole_{out}") and not parts_folder(place / out).exists()
    lfcal(*command, out, "--resume").refused("exists; add --force")


def listing(path: Path) -> Any:
    """Return the contents of a file, or of the files of a folder."""
    if path.suffix in (".h5", ".mat"):
        return contents(path)
    return path.read_bytes() if path.is_file() else {one.name: one.read_bytes() for one in sorted(path.iterdir())}


def test_a_resumed_run_projects_as_it_was_begun(lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is quickest differs from moment to moment: volumes of one run are all made in one way."""
    words = ("reconstruct", "H.h5", "frames.tif", "-n", 1, "--executor", "threads", "-o", "out", "--resume")
    read = importlib.import_module("lfcal.reconstruct._frame_units").read_frame

    def damaged(file: Path, page: int, shape: tuple[int, int]) -> Any:
        if page == 2:
            raise StorageError("the third frame cannot be read")
        return read(file, page, shape)

    with monkeypatch.context() as patch:
        patch.setattr("lfcal.reconstruct.projectors.projector.Projector.recipe", "sparse")
        patch.setattr("lfcal.reconstruct._frame_units.read_frame", damaged)
        assert "the third frame cannot be read" in lfcal(*words).err
    monkeypatch.setattr("lfcal.reconstruct.projectors.projector.Projector.recipe", "direct")
    lfcal(*words).ok()
    assert [said(place / "out" / f"frames_000{k}.tif")["method"] for k in range(3)] == ["sparse"] * 3


@pytest.mark.parametrize(
    "command",
    [
        "transpose H.h5",
        *(
            pytest.param(command, marks=pytest.mark.long)
            for command in (
                "simulate plan.json --level geometric",
                "reduce H.h5",
                "reconstruct H.h5 frames.tif -n 1",
            )
        ),
    ],
)
def test_what_an_earlier_run_left_is_continued_or_replaced(lfcal: Lfcal, place: Path, command: str) -> None:
    out = f"{command.split()[0]}.h5"
    words = (*command.split(), "-o", out)
    interrupted(place / out)
    lfcal(*words).refused("left 1 of 2 units finished; continue from them (--resume), or start again (--force)")
    status = lfcal("status", out).ok()
    assert f"make {out}: 1 of 2 units done; not running" in status.out
    assert "open the shutter" in status.out and "--resume" in status.out
    lfcal(*words, "--resume").ok()
    assert not parts_folder(place / out).exists()
    interrupted(place / out)
    lfcal(*words, "--force").ok()
    assert not parts_folder(place / out).exists()


def test_a_refusal_names_what_is_kept(lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The third frame is refused: what the first two made is kept, and the run continues once it is accepted."""
    (place / "frames").mkdir()
    for k in range(3):
        tifffile.imwrite(place / "frames" / f"t{k}.tif", np.full((30, 31), 50 + k, np.uint16))
    read = importlib.import_module("lfcal.reconstruct._frame_units").read_frame

    def refused(file: Path, page: int, shape: tuple[int, int]) -> Any:
        if file.name == "t2.tif":
            raise InputError("the third frame is refused")
        return read(file, page, shape)

    tifffile.imwrite(place / "dark.tif", np.full((30, 31), 10, np.uint16))
    words = ("reconstruct", "H.h5", "frames", "-n", 1, "--solver", "rl", "--dark", "dark.tif", "-o", "out")
    with monkeypatch.context() as patch:
        patch.setattr("lfcal.reconstruct._frame_units.read_frame", refused)
        run = lfcal(*words, "--executor", "threads")
    run.refused("kept: 2 of 3 units in out.parts; --resume continues with them")
    lfcal(*words, "--executor", "threads", "--resume").ok()
    assert sorted(path.name for path in (place / "out").iterdir()) == ["t0.tif", "t1.tif", "t2.tif"]


@pytest.fixture(params=[signal.SIGINT, signal.SIGTERM])
def number(request: pytest.FixtureRequest) -> Iterator[signal.Signals]:
    """Return a signal that is not ignored, as SIGINT is where the tests run in the background of a shell."""
    before = signal.signal(request.param, signal.SIG_DFL)
    yield request.param
    signal.signal(request.param, before)


def test_a_stop_names_what_is_kept(
    lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    """Before the first unit is done nothing stays, not even the folder; behind it the whole ones do."""
    words = ("reconstruct", "H.h5", "frames.tif", "-n", 1, "--executor", "threads", "-o", "out")
    begun = 0

    def stop(_: str) -> None:
        nonlocal begun
        begun += 1
        if begun == last:
            signal.raise_signal(number)

    monkeypatch.setattr("lfcal.reconstruct._frame_units._begun_from", stop)
    last = 1
    run = lfcal(*words)
    assert (run.code, run.err) == (128 + number, "lfcal: stopped; no incomplete output remains\n")
    assert not parts_folder(place / "out").exists()
    begun, last = 0, 2
    run = lfcal(*words)
    kept = "lfcal: kept: 1 of 3 units in out.parts; --resume continues with them"
    assert (run.code, run.err.splitlines()) == (128 + number, [kept, "lfcal: stopped; only complete units are kept"])
    monkeypatch.setattr("lfcal.work.runs.seal_of", lambda _: signal.raise_signal(number))
    run = lfcal(*words, "--resume")
    assert kept in run.err, "what an earlier run made stays, also where this one has not looked at it yet"
    monkeypatch.undo()
    monkeypatch.chdir(place)
    lfcal(*words, "--resume").ok()


def test_long_work_is_kept_automatically_but_not_before_its_first_unit(
    lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfcal.tasks.task.LONG", 0.0)
    run = lfcal("simulate", "plan.json", "--level", "geometric", "-o", "out.h5").ok()
    said = "intermediate results are kept in out.h5.parts plane by plane; a stopped run can continue from them (--res"
    assert said in run.err

    def gone(*_: object) -> None:
        raise StorageError("gone")

    monkeypatch.setattr("lfcal.reconstruct._frame_units.tool_for", gone)
    run = lfcal("reconstruct", "H.h5", "frames.tif", "-n", 1, "--executor", "threads", "-o", "v.tif")
    assert run.code == 2 and run.err == "lfcal: gone\n" and not parts_folder(place / "v.tif").exists()


@pytest.mark.parametrize("executor", ["threads", pytest.param("processes", marks=pytest.mark.long)])
def test_memory_is_that_of_all_planes_under_way(
    lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch, executor: str
) -> None:
    def told(*more: object) -> float:
        run = lfcal("simulate", "plan.json", "--level", "geometric", "-o", "out.h5", "--force", *more)
        found = re.search(r"at most ([\d.]+) MB of memory", run.err)
        assert run.code == 0 and found is not None, run.err
        return float(found[1])

    one = told("--workers", 1)
    assert told("--executor", "threads", "--workers", 1) == one
    assert told("--executor", executor, "--workers", 2) == pytest.approx(2 * one, rel=0.05)
    monkeypatch.setattr("lfcal.work.executors.threads.free_memory", lambda: 0)  # then one after the other
    assert told("--executor", "threads", "--workers", 2) == pytest.approx(one, rel=0.05)


def test_choices_that_do_not_go_together(lfcal: Lfcal, place: Path) -> None:
    far = "--scheduler tcp://a:1"
    for words, said in (
        ("simulate plan.json -o out.h5 --executor magic", "dask, processes or threads"),
        (f"simulate plan.json -o out.h5 --executor threads {far}", "an executor with a scheduler (dask)"),
        ("simulate plan.json --frames frames --executor threads", "done in units, got frames"),
        (f"transpose H.h5 -o out.h5 --executor processes {far}", "an executor with a scheduler (dask)"),
        (f"reduce H.h5 -o out.h5 --executor threads {far}", "an executor with a scheduler (dask)"),
        (f"export H.h5 -o out.h5 --executor threads {far}", "an executor with a scheduler (dask)"),
        (f"reconstruct H.h5 frames.tif -o out.h5 --executor processes {far}", "an executor with a scheduler (dask)"),
    ):
        lfcal(*words.split()).refused(said)
    assert not list(place.glob("out*"))


def test_status_of_what_is_whole_running_or_nothing(lfcal: Lfcal, place: Path) -> None:
    assert ": complete" in lfcal("status", "H.h5").ok().out
    assert lfcal("status", "H.h5", "--json").json == {"path": "H.h5", "whole": True}
    lfcal("status", "none.h5").refused("give the output file of the run")
    work = iter_run([unit("a"), unit("b", "endless", begun=str(place / "begun"))], place / "V.parts", Threads(1))
    for _ in work:
        if (place / "begun").exists():
            break
    running = lfcal("status", "V", "--json").json
    assert running["running"] and running["done"] == 1
    assert [one["state"] for one in running["units"]] == ["done", "under way"]
    shown = lfcal("status", place / "V.parts").out
    assert "1 of 2 units done; threads, 1 at work" in shown and "under way" in shown
    work.close()


# -- ``lfcal assemble`` in units of a plane: the same file by every executor, whatever was asked of the frames --
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
    "executor", ["threads", *(pytest.param(e, marks=pytest.mark.long) for e in ("processes", "dask"))]
)
def test_every_executor_assembles_the_same_file(lfcal: Lfcal, scan: Path, executor: str) -> None:
    if executor == "dask":
        pytest.importorskip("distributed", reason="dask.distributed is not installed")
    words = (*WORDS, "--dtype", "float32", "--pad", "--cutout", "39,11", "--interpolation", "linear")
    one = lfcal(*words, "-o", "one.h5").ok()
    two = lfcal(*words, "-o", "two.h5", "--executor", executor, "--workers", 2).ok()
    assert contents(scan / "one.h5") == contents(scan / "two.h5") and not parts_folder(scan / "two.h5").exists()
    told = [[line for line in run.out.splitlines() if line.startswith("This H ")] for run in (one, two)]
    assert told[0] == told[1] and "padded" in two.out and "damaged frames left out" in two.out
    assert one.err.splitlines()[-1] == two.err.splitlines()[-1] and "left out: " in two.err
    with open_psf("two.h5") as H:
        assert H.recorded[0, 1, 1] == 0 and H.recorded[1, 0, 2] == 2 and H.recorded[1, 2, 3] == 0


def test_listed_positions_are_left_out(lfcal: Lfcal, scan: Path) -> None:
    RedoList.of([(0, 2, 3), (1, 0, 2), (0, 1, 1)]).write(scan / "redo.json")
    lfcal(*WORDS, "-o", "whole.h5").ok()
    for out, more in (("one.h5", ()), ("two.h5", ("--executor", "threads", "--workers", 1))):
        run = lfcal(*WORDS, "-o", out, "--leave-out", "redo.json", *more).ok()
        assert "left out: " in run.err, "the damaged frame still is"
        with open_psf(out) as H, open_psf("whole.h5") as before:
            gone = np.argwhere((H.recorded == 0) & (before.recorded > 0)).tolist()
            assert gone == [[0, 2, 3], [1, 0, 2]], "all frames of a position, and no other"
            assert not H[0, 2, 3].any() and np.array_equal(H[0, 2, 2], before[0, 2, 2])
            assert H.provenance["positions_left_out"] == [[0, 2, 3], [1, 0, 2], [0, 1, 1]]
            assert len(H.provenance["left_out"]) == 1
    RedoList.of(list(np.ndindex(2, 3, 4))).write(scan / "redo.json")
    lfcal(*WORDS, "-o", "H.h5", "--leave-out", "redo.json").refused("positions to leave out; shorten the list")
    assert not Path("H.h5").exists()


@pytest.mark.long
def test_frames_of_every_source_are_the_same_in_units(
    lfcal: Lfcal, session: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(session)
    (session / "turned").mkdir()
    for path in (session / "frames").glob("*.png"):
        turned = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::-1, ::-1]
        cv2.imwrite(str(session / "turned" / path.name), turned)
    for words in (
        ("plan.json", "--channel", ""),
        ("turned", "--orientation", "rot180", "--strict", "--keep-pedestal"),
        ("frames/manifest.csv", "--background", "30", "--defects"),
    ):
        lfcal("assemble", *words, "-o", "one.h5", "--force").ok()
        lfcal("assemble", *words, "-o", "two.h5", "--executor", "processes", "--workers", 1, "--force").ok()
        assert contents(session / "one.h5") == contents(session / "two.h5"), words


def test_one_file_of_each_colour(lfcal: Lfcal, session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(session)
    (session / "rgb").mkdir()
    for path in (session / "frames").glob("*.png"):
        grey = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(session / "rgb" / path.name), np.dstack([grey // 3, grey, grey // 2]))
    (session / "rgb" / "manifest.csv").write_text((session / "frames" / "manifest.csv").read_text())
    words = ("assemble", "rgb", "--channel", "each", "--keep-pedestal")
    lfcal(*words, "-o", "one.h5").ok()
    lfcal(*words, "-o", "two.h5", "--executor", "threads", "--workers", 1).ok()
    for colour in "RGB":
        assert contents(session / f"one_{colour}.h5") == contents(session / f"two_{colour}.h5")


def test_a_damaged_frame_is_named_and_the_run_continues_once_it_is_fixed(
    lfcal: Lfcal, session: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(session)
    words = ("assemble", "frames", "--dark", "dark", "-o", "H.h5")
    lfcal(*words[:-1], "whole.h5").ok()
    damaged = session / "frames" / "z1_y0_x1.png"
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:200])
    said = ("(z, y, x) = (1, 0, 1)", "--skip-damaged")
    stopped = lfcal(*words, "--executor", "threads", "--orientation", "as-is")
    assert stopped.code == 2 and all(word in stopped.err for word in said)
    assert "kept: 1 of 2 units in H.h5.parts; --resume continues with them" in stopped.err
    assert not (session / "H.h5").exists()
    damaged.write_bytes(whole)
    lfcal(*words).refused("left 1 of 2 units")
    lfcal(*words, "--resume").ok()
    assert contents(session / "H.h5") == contents(session / "whole.h5") and not parts_folder(session / "H.h5").exists()


@pytest.mark.parametrize("more", [("--executor", "threads", "--workers", 1), pytest.param((), marks=pytest.mark.long)])
def test_a_small_file_is_within_its_tolerance(lfcal: Lfcal, scan: Path, more: tuple[object, ...]) -> None:
    """Every pattern lacks at most its share of what is stored in full, padded and missing ones too."""
    words = (*WORDS, "--pad", "--cutout", "39,11", "-o")
    lfcal(*words, "full.h5", "--dtype", "float32").ok()
    for out, by in (("one.h5", ()), ("small.h5", more)):
        lfcal(*words, out, "--store-tolerance", 0.01, *by).ok()
    with open_psf("full.h5") as H, open_psf("small.h5") as small:
        full, found = (np.asarray(one, np.float64) for one in (H, small))
        lacks, light = (np.abs(a).sum(axis=(3, 4)) for a in (found - full, full))
        assert (lacks <= 0.01 * light).all() and (lacks > 0).any()
        assert (light == 0).any()  # a position without a frame
        worst = (lacks / np.maximum(light, 1e-9)).max()
        # the bound adds two sums that are added in another order here
        assert small.facts.bound is not None and small.facts.bound.max() >= worst * (1 - 1e-14)
    assert contents(Path("one.h5")) == contents(Path("small.h5"))
    for given, said in (
        (("--store-tolerance", 2), "expected a number > 0 and < 1"),
        (("--store-tolerance", 0.01, "--dtype", "float32"), "expected --dtype rounded, got float32"),
    ):
        lfcal("assemble", "frames", "-o", "o.h5", *given).refused(said)
        assert not Path("o.h5").exists() and not parts_folder("o.h5").exists()


# -- ``lfcal inspect`` in units of a plane: the same numbers by every executor, kept until the report is written --
@pytest.fixture
def H(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write an H of three planes, one of them dark, with noise and a missing position."""
    rows, columns = np.mgrid[:21, :21]
    values = np.empty((3, 3, 4, 21, 21), np.float32)
    for place in np.ndindex(values.shape[:3]):
        values[place] = 500 * np.exp(-((rows - 10) ** 2 + (columns - 10 - 0.1 * place[2]) ** 2) / (7 + 2 * place[0]))
    values[2] = 0
    values += np.random.default_rng(0).normal(0, 1, values.shape).astype(np.float32)
    recorded = np.ones(values.shape[:3], int)
    values[0, 1, 2], recorded[0, 1, 2] = 0, 0
    save(PSFMatrix(values, depths=[-20e3, -15e3, -10e3], recorded=recorded), tmp_path / "H.h5")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "H.h5"


@pytest.mark.long
@pytest.mark.parametrize("executor", ["threads", "processes", "dask"])
def test_every_executor_writes_the_same_report(lfcal: Lfcal, H: Path, executor: str) -> None:
    if executor == "dask":
        pytest.importorskip("distributed", reason="dask.distributed is not installed")
    words = ("inspect", "H.h5", "--json", "--workers", 1, "--report")
    one, two = lfcal(*words, "one").ok(), lfcal(*words, "two", "--executor", executor).ok()
    assert alike(one.json, two.json) and not parts_folder(H.parent / "two").exists()
    assert (H.parent / "one" / "redo.json").read_text() == (H.parent / "two" / "redo.json").read_text()


@pytest.mark.long
def test_control_frames_are_inspected_the_same_in_units(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    without_pictures(monkeypatch)
    plan = recorded_plan()
    record_session(tmp_path / "session", plan, rig_for(plan), replace(CAREFUL, controls=1))
    lfcal("assemble", "session", "-o", "H.h5").ok()
    words = ("inspect", "H.h5", "--session", "session", "--seconds", 0, "--json", "--workers", 1, "--report")
    one, two = lfcal(*words, "one").ok(), lfcal(*words, "two", "--executor", "processes").ok()
    assert alike(one.json, two.json)


def test_planes_are_kept_until_the_report_is_written(lfcal: Lfcal, H: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ("inspect", "H.h5", "--report", "out", "--workers", 1, "--seconds", 0)
    without_pictures(monkeypatch)

    def full(*_: Any, **__: Any) -> Any:
        raise StorageError("out: no space is left")

    with monkeypatch.context() as patch:
        patch.setattr("lfcal.tasks.inspect.Inspect._iter_report", full)
        assert lfcal(*words, "--executor", "threads").code == 2
    status = lfcal("status", "out")
    assert "inspect H.h5: 3 of 3 units done; not running" in status.out
    lfcal(*words).refused("left 3 of 3 units finished; continue from them (--resume)")
    lfcal(*words, "--resume").ok()
    assert (H.parent / "out" / "index.html").exists() and not parts_folder(H.parent / "out").exists()


def test_without_a_report_nothing_is_kept(lfcal: Lfcal, H: Path) -> None:
    for words in (("--executor", "threads"), ("--resume",), ("--scheduler", "tcp://a:1")):
        lfcal("inspect", "H.h5", *words).refused("expected --report, got none")
    lfcal("inspect", "H.h5", "--report", "out", "--executor", "magic").refused("dask, processes or threads")
    assert {path.name for path in H.parent.iterdir()} == {"H.h5"}


# -- ``lfcal fit``: H of the fitted camera in units of a plane, the same by every executor and after a stop --


@pytest.mark.long
@pytest.mark.parametrize("executor", ["processes", "threads", "dask"])
def test_every_executor_computes_the_same_h_of_a_fit(tmp_path: Path, executor: str) -> None:
    if executor == "dask":
        pytest.importorskip("distributed", reason="dask.distributed is not installed")
    fit = two_planes()
    for name, run in (("one.h5", None), ("two.h5", RunChoice(executor, 1))):
        drain(iter_write_model(fit, tmp_path / name, workers=1, run=run))
    assert contents(tmp_path / "one.h5") == contents(tmp_path / "two.h5")
    assert not parts_folder(tmp_path / "two.h5").exists()


def test_a_stop_keeps_the_planes_of_a_fit(tmp_path: Path) -> None:
    fit, out = two_planes(), tmp_path / "H.h5"
    work = iter_write_model(fit, out, run=RunChoice("threads", 1))
    while not next(work).note.startswith("1 of"):
        pass
    work.close()
    kept = next(parts_folder(out).glob("*.h5"))
    stamp = kept.stat().st_mtime_ns
    again = iter_write_model(fit, out, run=RunChoice("threads", 1, begun="resume"))
    next(again)
    assert kept.stat().st_mtime_ns == stamp
    drain(again)
    drain(iter_write_model(fit, tmp_path / "one.h5", workers=1))
    assert contents(out) == contents(tmp_path / "one.h5")


@pytest.mark.long
def test_a_fit_that_ended_after_h_is_resumed(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The fit is made again, and H is the same to the last bit; only the report was missing."""
    save(few_patterns(), tmp_path / "few.h5")
    monkeypatch.chdir(tmp_path)
    undrawn(monkeypatch)
    words = ("fit", "few.h5", "--unknowns", "geometry", "--workers", 1, "-o")
    lfcal(*words, "one").ok()
    H = tmp_path / "two" / "H.h5"
    with monkeypatch.context() as full:

        def fails(*_: object) -> object:
            raise StorageError("no space left")
            yield

        full.setattr("lfcal.fit.files.iter_fit_report", fails)
        assert "no space left" in lfcal(*words, "two", "--executor", "threads").err
    assert H.exists() and parts_folder(H).exists()
    lfcal(*words, "two").refused()
    lfcal(*words, "two", "--resume").ok()
    assert (tmp_path / "two" / "fit.json").exists() and not parts_folder(H).exists()
    assert contents(tmp_path / "one" / "H.h5") == contents(H)


def test_what_has_no_units_is_refused(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(few_patterns(), tmp_path / "few.h5")
    monkeypatch.chdir(tmp_path)
    for words, said in (
        (("--hybrid", "--executor", "processes"), "got --hybrid; leave --executor or --hybrid out"),
        (("--no-h", "--resume"), "got --no-h; leave --resume or --no-h out"),
        (("--executor", "threads", "--scheduler", "tcp://a:1"), "an executor with a scheduler (dask)"),
    ):
        lfcal("fit", "few.h5", *words).refused(said)
    lfcal("fit", "check", "few.h5", "few.tif", "--scheduler", "tcp://a:1").refused("No such option: --scheduler")
    assert {path.name for path in tmp_path.iterdir()} == {"few.h5"}


# -- ``--workers`` and LFCAL_WORKERS bound every thread of every command that computes --
IDLE = {
    ("plan",),
    ("status",),
    ("solvers",),
    ("trend",),
    ("doctor",),
    ("install-desktop",),
    ("verify",),
    ("multiplex",),
    ("multiplex", "show"),
    ("bench",),
    (),
}
IDLE |= {("camera",), *(("camera", name) for name in ("new", "import", "show"))}
"""They compute nothing that takes time, or are groups; of the benchmarks, those that compare threads take them."""


def test_every_command_that_computes_takes_workers() -> None:
    commands = walk(typer.main.get_command(build_app()))
    without = {
        path for path, one in commands if path[:1] != ("bench",) and "workers" not in {p.name for p in one.params}
    }
    assert without <= IDLE


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Note the size of every pool, and the threads of BLAS and OpenCV while it is made."""
    sizes: list[int] = []
    real = ThreadPoolExecutor.__init__

    def init(self: ThreadPoolExecutor, max_workers: int | None = None, *more: Any, **options: Any) -> None:
        sizes.append(max_workers or 99)
        sizes.extend(int(found["num_threads"]) for found in threadpool_info())
        sizes.append(cv2.getNumThreads())
        real(self, max_workers, *more, **options)

    monkeypatch.setattr(ThreadPoolExecutor, "__init__", init)
    return sizes


def test_pools_and_libraries_keep_to_the_number_of_workers(
    lfcal: Lfcal, inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seen: list[int]
) -> None:
    shutil.copytree(inputs, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    before = threading.active_count(), cv2.getNumThreads(), os.environ.get(WORKERS)
    for name in ("transpose", "reduce", "export mat", "reconstruct npy", "camera sensor"):
        seen.clear()
        lfcal(*WRITERS[name].words("--workers", "1", "--force")).ok()
        with monkeypatch.context() as patch:
            patch.setenv(WORKERS, "1")
            lfcal(*WRITERS[name].words("--force")).ok()
        assert set(seen) <= {1}, name
        assert (threading.active_count(), cv2.getNumThreads(), os.environ.get(WORKERS)) == before, name


def test_a_wrong_variable_is_one_line(lfcal: Lfcal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(WORKERS, "all")
    run = lfcal("plan", "bench", "--virtual-depths", "3").refused()
    words = "LFCAL_WORKERS: expected a whole number of at least 1, got 'all'; set a whole number, or unset the variable"
    assert run.err == f"lfcal: {words}\n"


def test_the_doctor_shows_the_number_of_threads(lfcal: Lfcal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(WORKERS, "3")
    found = lfcal("doctor", "--json").json["machine"]
    assert found["threads used"] == "3 (LFCAL_WORKERS)"
    monkeypatch.delenv(WORKERS)
    found = lfcal("doctor", "--json").json["machine"]
    assert found["threads used"] == f"{found['processors']} (every processor this process may use)"
