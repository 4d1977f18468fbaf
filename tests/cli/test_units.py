"""Long work in units on the command line: the same files by every executor, resumed after a stop, and its status."""

from __future__ import annotations

import importlib
import json
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from lfcal.base.errors import StorageError
from lfcal.base.progress import drain
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.reconstruct.volumes import load_volume
from lfcal.work import iter_run, parts_folder
from lfcal.work.executors.threads import Threads
from tests.cli.conftest import Run, small_plan
from tests.psf.test_joining import contents
from tests.reconstruct.oracles import lenslet_psf
from tests.work.tasks import unit

Lfcal = Callable[..., Run]


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


@pytest.mark.parametrize("executor", ["threads", pytest.param("processes", marks=pytest.mark.long)])
def test_simulate(lfcal: Lfcal, place: Path, executor: str) -> None:
    words = ("simulate", "plan.json", "--level", "geometric", "-o")
    assert lfcal(*words, "one.h5").code == 0
    run = lfcal(*words, "two.h5", "--executor", executor, "--workers", 2)
    assert run.code == 0 and "written: two.h5" in run.out
    assert contents(place / "one.h5") == contents(place / "two.h5")
    assert not parts_folder(place / "two.h5").exists()


@pytest.mark.parametrize("method", ["exact", "paper"])
def test_transpose(lfcal: Lfcal, place: Path, method: str) -> None:
    words = ("transpose", "H.h5", "--method", method, "-o")
    assert lfcal(*words, "one.h5").code == 0
    run = lfcal(*words, "two.h5", "--executor", "threads")
    assert run.code == 0 and "two.h5: HT (2, " in run.out
    assert contents(place / "one.h5") == contents(place / "two.h5")
    back = lfcal("transpose", "two.h5", "-o", "H2.h5", "--executor", "threads")
    assert back.code == 0
    if method == "exact":
        assert "H2.h5: H (2, " in back.out
        with open_psf(place / "H.h5") as H, open_psf(place / "H2.h5") as H2:
            np.testing.assert_array_equal(H2[:], H[:])


@pytest.mark.parametrize(
    ("executor", "warm"),
    [
        ("threads", False),
        ("processes", True),
        pytest.param("threads", True, marks=pytest.mark.long),
        pytest.param("processes", False, marks=pytest.mark.long),
    ],
)
def test_reconstruct(lfcal: Lfcal, place: Path, executor: str, warm: bool) -> None:
    more = ("--warm",) if warm else ()
    words = ("reconstruct", "H.h5", "frames.tif", "-n", 3, "--method", "direct", *more, "-o")
    assert lfcal(*words, "one").code == 0
    run = lfcal(*words, "two", "--executor", executor)
    if warm and executor == "processes":
        assert run.code == 2 and "start each frame from the beginning" in run.err
        return
    assert run.code == 0 and run.out.count("3 iterations") == 3
    for name in ("frames_0000.tif", "frames_0001.tif", "frames_0002.tif"):
        one, two = (place / folder / name for folder in ("one", "two"))
        np.testing.assert_array_equal(load_volume(one), load_volume(two))
        assert said(one) == said(two)
    assert not (place / "two.parts").exists()


def test_all_volumes_in_one_file(lfcal: Lfcal, place: Path) -> None:
    words = ("reconstruct", "H.h5", "frames.tif", "-n", 2, "--method", "polyphase:2x2", "-o")
    assert lfcal(*words, "one.tif").code == 0
    assert lfcal(*words, "two.tif", "--executor", "threads").code == 0
    np.testing.assert_array_equal(tifffile.imread(place / "one.tif"), tifffile.imread(place / "two.tif"))


@pytest.mark.parametrize("warm", [False, True])
def test_a_series_in_one_ome_zarr(lfcal: Lfcal, place: Path, warm: bool) -> None:
    """The same volumes as in files of their own, whether or not the work was in units."""
    zarr = pytest.importorskip("zarr", reason="zarr is not installed")
    more = ("--warm",) if warm else ()
    words = ("reconstruct", "H.h5", "frames.tif", "-n", 2, "--method", "sparse", *more, "-o")
    for out, by in (("one.ome.zarr", ()), ("two.ome.zarr", ("--executor", "threads")), ("single", ())):
        run = lfcal(*words, out, *by)
        assert run.code == 0, run.err
    one, two = (zarr.open_group(place / f"{name}.ome.zarr", mode="r") for name in ("one", "two"))
    single = np.stack([load_volume(place / "single" / f"frames_000{k}.tif") for k in range(3)])
    for found in (one, two):
        np.testing.assert_array_equal(found["0"][...], single)
        assert found.attrs["lfcal"]["details"]["frames"] == [f"frames_000{k}" for k in range(3)]
    refused = lfcal(*words, "one.ome.zarr")
    assert refused.code == 2 and "one.ome.zarr: exists; add --force to replace it" in refused.err
    assert lfcal(*words, "one.ome.zarr", "--force").code == 0


@pytest.mark.parametrize(
    ("words", "out", "writer"),
    [
        ("reconstruct H.h5 frames.tif -n 1 --format .npy", "out", "lfcal.reconstruct.volumes.replace_whole"),
        ("reconstruct H.h5 frames.tif -n 1", "out.npy", "lfcal.work.choice.discard"),
        ("transpose H.h5", "out.h5", "lfcal.work.choice.discard"),
        ("simulate plan.json --level geometric", "out.h5", "lfcal.work.choice.discard"),
    ],
)
def test_ended_while_it_writes_what_was_made(
    lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch, words: str, out: str, writer: str
) -> None:
    """A part of what it makes is there, or all of it: that is its own, and ``--resume`` asks for no ``--force``."""
    command = (*words.split(), "--workers", 1, "--executor", "threads", "-o")
    assert lfcal(*command, f"whole_{out}").code == 0
    with monkeypatch.context() as patch:
        real, count = attribute(writer), iter(range(9))

        def ended(path: Any) -> Any:
            if writer.endswith("discard") or next(count) == 1:
                raise StorageError(f"{path}: the disk is gone")
            return real(path)

        patch.setattr(writer, ended)
        assert lfcal(*command, out).code == 2
    assert (place / out).exists() and parts_folder(place / out).exists()
    refused = lfcal(*command, out)
    assert refused.code == 2 and not refused.err.startswith("Traceback")
    run = lfcal(*command, out, "--resume")
    assert run.code == 0, run.err
    assert listing(place / out) == listing(place / f"whole_{out}")
    assert not parts_folder(place / out).exists()
    over = lfcal(*command, out, "--resume")
    assert over.code == 2 and "exists; add --force" in over.err


def attribute(name: str) -> Any:
    module, _, what = name.rpartition(".")
    return getattr(importlib.import_module(module), what)


def listing(path: Path) -> Any:
    """Return what a file or the files of a folder hold."""
    if path.suffix == ".h5":
        return contents(path)
    return path.read_bytes() if path.is_file() else {one.name: one.read_bytes() for one in sorted(path.iterdir())}


def test_a_run_that_goes_on_projects_as_it_was_begun(
    lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is quickest differs from moment to moment: volumes of one run are all made in one way."""
    words = ("reconstruct", "H.h5", "frames.tif", "-n", 1, "--executor", "threads", "-o", "out", "--resume")
    read = importlib.import_module("lfcal.reconstruct._frame_units").read_frame

    def damaged(file: Path, page: int | None) -> Any:
        if page == 2:
            raise StorageError("the third frame cannot be read")
        return read(file, page)

    with monkeypatch.context() as patch:
        patch.setattr("lfcal.reconstruct.projectors.projector.Projector.recipe", "sparse")
        patch.setattr("lfcal.reconstruct._frame_units.read_frame", damaged)
        assert "the third frame cannot be read" in lfcal(*words).err
    monkeypatch.setattr("lfcal.reconstruct.projectors.projector.Projector.recipe", "direct")
    run = lfcal(*words)
    assert run.code == 0, run.err
    assert [said(place / "out" / f"frames_000{k}.tif")["method"] for k in range(3)] == ["sparse"] * 3


@pytest.mark.parametrize(
    ("command", "out"),
    [
        ("simulate plan.json --level geometric -o out.h5", "out.h5"),
        ("transpose H.h5 -o out.h5", "out.h5"),
        ("reconstruct H.h5 frames.tif -n 1 -o out", "out"),
    ],
)
def test_what_an_earlier_run_left(lfcal: Lfcal, place: Path, command: str, out: str) -> None:
    words = command.split()
    interrupted(place / out)
    refused = lfcal(*words)
    assert (
        refused.code == 2
        and "left 1 of 2 units finished; continue from them (--resume), or start again (--force)" in refused.err
    )
    status = lfcal("status", out)
    assert status.code == 0 and f"make {out}: 1 of 2 units done; not running" in status.out
    assert "open the shutter" in status.out and "--resume" in status.out
    assert lfcal(*words, "--resume").code == 0
    assert not parts_folder(place / out).exists()
    interrupted(place / out)
    assert lfcal(*words, "--force").code == 0
    assert not parts_folder(place / out).exists()


def test_a_refusal_says_what_is_kept(lfcal: Lfcal, place: Path) -> None:
    """The third frame is damaged: what the first two made stays, and mending it goes on from there."""
    (place / "frames").mkdir()
    for k in range(3):
        tifffile.imwrite(place / "frames" / f"t{k}.tif", np.full((30, 31), 50 + k, np.uint16))
    damaged = place / "frames" / "t2.tif"
    whole = damaged.read_bytes()
    tifffile.imwrite(damaged, np.full((30, 30), 50, np.uint16))
    words = (
        "reconstruct",
        "H.h5",
        "frames",
        "-n",
        1,
        "--solver",
        "rl",
        "-o",
        "out",
        "--executor",
        "threads",
    )
    dark = np.full((30, 31), 10, np.uint16)
    tifffile.imwrite(place / "dark.tif", dark)
    stopped = lfcal(*words, "--dark", "dark.tif")
    assert stopped.code == 2 and "kept: 2 of 3 units in out.parts; --resume continues with them" in stopped.err
    damaged.write_bytes(whole)
    assert lfcal(*words, "--dark", "dark.tif", "--resume").code == 0
    assert sorted(path.name for path in (place / "out").iterdir()) == ["t0.tif", "t1.tif", "t2.tif"]


@pytest.fixture(params=[signal.SIGINT, signal.SIGTERM])
def number(request: pytest.FixtureRequest) -> Iterator[signal.Signals]:
    """Return a signal that is not ignored, as SIGINT is where the tests run in the background of a shell."""
    before = signal.signal(request.param, signal.SIG_DFL)
    yield request.param
    signal.signal(request.param, before)


def test_a_stop_says_what_stays_and_no_more(
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
    assert lfcal(*words, "--resume").code == 0


def test_a_run_that_failed_before_its_first_unit_leaves_nothing(
    lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tifffile.imwrite(place / "frame.tif", np.full((30, 31), 50, np.uint16))
    monkeypatch.setattr(
        "lfcal.reconstruct._frame_units.tool_for", lambda *_: (_ for _ in ()).throw(StorageError("gone"))
    )
    run = lfcal("reconstruct", "H.h5", "frame.tif", "-n", 1, "--executor", "threads", "-o", "v.tif")
    assert run.code == 2 and run.err == "lfcal: gone\n" and not parts_folder(place / "v.tif").exists()


def test_long_work_is_kept_without_being_asked(lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfcal.tasks.task.LONG", 0.0)
    run = lfcal("simulate", "plan.json", "--level", "geometric", "-o", "out.h5")
    assert (
        run.code == 0
        and "intermediate results are kept in out.h5.parts plane by plane; a stopped run can continue from them (--res"
        in run.err
    )


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
    simulate = ("simulate", "plan.json", "--level", "geometric")
    for words, said in (
        ((*simulate, "-o", "out.h5", "--executor", "magic"), "dask, processes or threads"),
        ((*simulate, "-o", "out.h5", "--executor", "threads", "--scheduler", "tcp://a:1"), "one that has"),
        ((*simulate, "--frames", "frames", "--executor", "threads"), "done in units, got frames"),
    ):
        run = lfcal(*words)
        assert run.code == 2 and run.err.count("\n") <= 2, run.err
        assert said in run.err or "an executor with a scheduler (dask)" in run.err
    for command in ("transpose", "reconstruct"):
        more = ("H.h5", "frames.tif") if command == "reconstruct" else ("H.h5",)
        run = lfcal(command, *more, "-o", "o.h5", "--executor", "processes", "--scheduler", "tcp://a:1")
        assert run.code == 2 and "an executor with a scheduler (dask)" in run.err
    assert not (place / "out.h5.parts").exists()


def test_status_of_what_is_whole_running_or_nothing(lfcal: Lfcal, place: Path) -> None:
    whole = lfcal("status", "H.h5")
    assert whole.code == 0 and ": complete" in whole.out
    assert lfcal("status", "H.h5", "--json").json == {"path": "H.h5", "whole": True}
    nothing = lfcal("status", "none.h5")
    assert nothing.code == 2 and "name the output file of the run" in nothing.err
    work = iter_run([unit("a"), unit("b", "endless", begun=str(place / "begun"))], place / "V.parts", Threads(1))
    for _ in work:
        if (place / "begun").exists():
            break
    running = lfcal("status", "V", "--json").json
    assert isinstance(running, dict) and running["running"] and running["done"] == 1
    assert [one["state"] for one in running["units"]] == ["done", "under way"]
    shown = lfcal("status", place / "V.parts").out
    assert "1 of 2 units done; threads, 1 at work" in shown and "under way" in shown
    work.close()
