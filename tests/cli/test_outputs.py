"""What may be written where: inputs stay, what exists is replaced with --force alone, two programs do not mix."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
import typer.main

from lfcal.base.files import replace_whole
from lfcal.cli._app import build_app
from lfcal.judge.report import report_files
from lfcal.psf import _tiff_export as tiff_export
from tests.cli.conftest import Run
from tests.cli.test_every_option import walk
from tests.cli.writing import WRITERS, listing, make_inputs

Lfcal = Callable[..., Run]

COMMANDS = (
    ("plan",),
    ("plan", "fit"),
    ("plan", "target"),
    ("white",),
    ("views",),
    ("depth",),
    ("simulate",),
    ("accuracy",),
    ("assemble",),
    ("acquire",),
    ("inspect",),
    ("compare",),
    ("fit",),
    ("fit", "frames"),
    ("trend",),
    ("watch",),
    ("transpose",),
    ("reduce",),
    ("export",),
    ("reconstruct",),
    ("demo",),
    ("run",),
    *(("camera", name) for name in ("new", "import", "check", "sensor")),
    *(("multiplex", name) for name in ("compare", "show", "demosaic", "views", "search", "filters", "figures")),
    *(("multiplex", name) for name in ("map", "design", "recover", "coding")),
)
"""Those that write files which may be there already."""


@pytest.fixture(scope="session")
def _inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    make_inputs(folder)
    return folder


@pytest.fixture
def place(_inputs: Path, session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder, also the current one, that holds what the commands read."""
    shutil.copytree(_inputs, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_command_that_takes_an_output_takes_force() -> None:
    """A new command with --out cannot forget the rules."""
    written = {
        path
        for path, command in walk(typer.main.get_command(build_app()))
        if any(p.name in ("out", "report", "assemble", "draw") for p in command.params)
    }
    assert written - set(COMMANDS) == set()
    called = {
        max((path for path in COMMANDS if tuple(w.words()[: len(path)]) == path), key=len) for w in WRITERS.values()
    }
    assert called == set(COMMANDS)


@pytest.mark.few(16)
@pytest.mark.parametrize("name", WRITERS)
def test_what_exists_is_replaced_with_force_alone(lfcal: Lfcal, place: Path, name: str) -> None:
    writer = WRITERS[name]
    (place / writer.output).parent.mkdir(exist_ok=True)
    (place / writer.output).write_text("old")
    before = listing(place)
    run = lfcal(*writer.words())
    assert run.code == 2 and run.err.count("\n") == 1, run.err
    assert run.err.endswith(f"{writer.output}: exists; add --force to replace it, or choose another name\n")
    assert listing(place) == before


@pytest.mark.parametrize("name", ["plan", "white", "inspect", "acquire", "reconstruct batch", "multiplex figures"])
def test_what_cannot_be_written_is_said_before_the_work(lfcal: Lfcal, place: Path, name: str) -> None:
    writer = WRITERS[name]
    target = place / writer.output
    target.parent.mkdir(exist_ok=True)
    target.write_text("old")
    target.chmod(0o400)
    before = listing(place)
    run = lfcal(*writer.words("--force"))
    assert run.code == 2 and run.err.count("\n") == 1, run.err
    assert run.err.endswith(
        f"{writer.output}: this file is read-only; choose another name, or make the file writable\n"
    )
    assert listing(place) == before


@pytest.mark.parametrize("name", ["plan", "transpose", "export h5", "export tif", "reconstruct npy"])
def test_force_replaces_through_a_link(lfcal: Lfcal, place: Path, name: str) -> None:
    writer = WRITERS[name]
    target = place / writer.output
    target.parent.mkdir(exist_ok=True)
    (place / "kept elsewhere").write_text("old")
    (place / "kept elsewhere").chmod(0o640)
    target.symlink_to(place / "kept elsewhere")
    run = lfcal(*writer.words("--force"))
    assert run.code == 0, run.err
    assert target.is_symlink() and (place / "kept elsewhere").stat().st_size > 100
    assert (place / "kept elsewhere").stat().st_mode & 0o777 == 0o640
    assert not [p for p in place.rglob(".*") if p.suffix in (".part", ".lock")]


@pytest.mark.parametrize(
    ("command", "kept"),
    [
        ("transpose H.h5 -o H.h5", "H.h5"),
        ("transpose H.h5 -o link.h5", "H.h5"),
        ("reduce H.h5 -o H.h5", "H.h5"),
        ("export H.h5 -o H.h5", "H.h5"),
        ("reconstruct H.h5 frame.tif -o H.h5", "H.h5"),
        ("reconstruct H.h5 frame.tif -o frame.tif", "frame.tif"),
        ("reconstruct H.h5 frame.tif --dark white.tif -o white.tif", "white.tif"),
        ("reconstruct H.h5 frames -o frames", "frames/a.tif"),
        ("plan camera.json --virtual-depths 3 -o camera.json", "camera.json"),
        ("simulate scan.json -o scan.json", "scan.json"),
        ("accuracy H.h5 --draw H.h5", "H.h5"),
        ("fit out/H.h5 -o out", "out/H.h5"),
        ("trend fits -o fits/a/fit.json", "fits/a/fit.json"),
        ("fit fit.h5 --camera out/camera.json -o out", "out/camera.json"),
        ("assemble session/frames -o session/frames/z0_y0_x0.png", "session/frames/z0_y0_x0.png"),
        ("assemble session/frames/manifest.csv -o session/frames/z0_y0_x0.png", "session/frames/z0_y0_x0.png"),
        ("assemble session/frames --dark session/dark -o session/dark/0.png", "session/dark/0.png"),
        ("assemble session/frames --white session/white -o session/white/0.png", "session/white/0.png"),
        ("assemble session/frames --plan session/plan.json -o session/plan.json", "session/plan.json"),
        ("acquire scan.json --out s --assemble scan.json", "scan.json"),
        ("multiplex demosaic frame.tif --pattern GRBG -o frame.tif", "frame.tif"),
        ("multiplex views frame.tif --white white.tif -o white.tif", "white.tif"),
        ("white white.tif --camera out/camera.json -o out", "out/camera.json"),
    ],
)
def test_an_input_is_never_replaced(lfcal: Lfcal, place: Path, command: str, kept: str) -> None:
    (place / "link.h5").symlink_to("H.h5")
    for folder, name in (("frames", "frame.tif"), ("out", "camera.json"), ("out", "H.h5")):
        (place / folder).mkdir(exist_ok=True)
        shutil.copy(place / name, place / folder / ("a.tif" if folder == "frames" else name))
    before = listing(place)
    run = lfcal(*command.split(), "--force")
    assert run.code == 2 and run.err.count("\n") == 1, run.err
    assert "output: expected a file other than the input" in run.err
    assert (place / kept).read_bytes() == before[kept] and listing(place) == before


def test_devices_and_folders_are_no_outputs(lfcal: Lfcal, place: Path) -> None:
    os.mkfifo(place / "pipe.h5")
    (place / "folder.h5").mkdir()
    (place / "file").write_text("")
    for out, why in (("pipe.h5", "pipe or a device"), ("folder.h5", "is a folder"), ("file/out.h5", "is a file")):
        run = lfcal("transpose", "H.h5", "-o", out, "--force")
        assert run.code == 2 and why in run.err and run.err.count("\n") == 1, run.err


@pytest.mark.long
def test_other_files_of_a_folder_stay(lfcal: Lfcal, place: Path) -> None:
    (place / "out").mkdir()
    (place / "out" / "notes.txt").write_text("mine")
    run = lfcal(*WRITERS["inspect"].words(), "--reference", "H.h5")
    assert run.code == 0, run.err
    assert (place / "out" / "notes.txt").read_text() == "mine"
    (place / "out" / "notes.txt").rename(place / "notes.txt")
    assert set((place / "out").iterdir()) <= set(report_files(place / "out")), "all that it may replace is checked"
    again = lfcal(*WRITERS["inspect"].words())
    assert again.code == 2 and "index.html: exists" in again.err


def test_tiff_stacks_are_named_with_their_bytes(lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = lfcal(*WRITERS["export tif"].words())
    assert whole.code == 0 and whole.out.startswith("out.tif: (1, 5, 5, 31, 31), ")
    (place / "out.tif").unlink()
    monkeypatch.setattr(tiff_export, "ONE_FILE_BYTES", 1000)  # a large H is a file for each plane
    said = lfcal(*WRITERS["export tif"].words())
    size = (place / "out_z000.tif").stat().st_size
    assert said.code == 0 and said.out.startswith("out_z000.tif: (1, 5, 5, 31, 31), ") and " 0 B" not in said.out
    found = lfcal(*WRITERS["export tif"].words("--force", "--json")).json
    assert isinstance(found, dict) and not (place / "out.tif").exists()
    assert found["files"] == [{"file": "out_z000.tif", "bytes": size}] and found["file_bytes"] == size


@pytest.mark.parametrize("suffix", [".tif", ".h5", ".npy"])
def test_frames_of_one_file_become_volumes_of_one_file(lfcal: Lfcal, place: Path, suffix: str) -> None:
    """As a hyperstack ImageJ opens; each frame's volume in the order of its page."""
    import h5py

    run = lfcal("reconstruct", "H.h5", "stack.tif", "-n", 2, "-o", f"all{suffix}", "--json")
    assert run.code == 0, run.err
    assert lfcal("reconstruct", "H.h5", "stack.tif", "-n", 2, "-o", "single").code == 0
    single = [tifffile.imread(place / "single" / f"stack_000{k}.tif").reshape(1, 40, 40) for k in range(2)]
    if suffix == ".npy":
        made = np.load(place / "all.npy")
    elif suffix == ".h5":
        with h5py.File(place / "all.h5") as file:
            made = file["volume"][...]
            assert json.loads(file.attrs["details"])["frames"] == ["stack_0000", "stack_0001"]
    else:
        with tifffile.TiffFile(place / "all.tif") as tif:
            made = tif.asarray().reshape(2, 1, 40, 40)
            assert tif.imagej_metadata is not None and tif.imagej_metadata["frames"] == 2
    np.testing.assert_allclose(made, single, rtol=1e-5)


HOLD = """
import sys
from pathlib import Path
from lfcal.base.files import replace_whole
with replace_whole(sys.argv[1]) as part:
    part.write_text("first")
    print("writing", flush=True)
    sys.stdin.readline()
"""


def test_two_programs_at_one_output(lfcal: Lfcal, place: Path) -> None:
    """The second is told; the first is not disturbed; one that was killed keeps nobody out."""
    command = [sys.executable, "-c", HOLD, str(place / "out.h5")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as first:
        assert first.stdout is not None and first.stdout.readline() == b"writing\n"
        run = lfcal("transpose", "H.h5", "-o", "out.h5")
        assert run.code == 2 and run.err.count("\n") == 1, run.err
        assert "out.h5: another program is writing it; wait for it to end, or choose another name" in run.err
        first.communicate(b"\n")
    assert (place / "out.h5").read_text() == "first"
    assert not list(place.glob(".out*"))
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as killed:
        assert killed.stdout is not None and killed.stdout.readline() == b"writing\n"
        killed.kill()
    assert len(list(place.glob(".out*"))) == 2, "its part and its lock"
    assert lfcal("transpose", "H.h5", "-o", "out.h5", "--force").code == 0
    assert not list(place.glob(".out*"))


def test_where_there_are_no_locks_files_are_written_all_the_same(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_: int) -> None:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr("lfcal.base.files.lock", refused)
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    for process in (dead.pid, os.getppid()):
        (place / f".out.h5.{process}.part").write_text("left")
    with replace_whole(place / "out.h5") as part:
        part.write_text("new")
    assert (place / "out.h5").read_text() == "new"
    assert [p.name for p in place.glob(".out.h5.*.part")] == [f".out.h5.{os.getppid()}.part"], "it may be writing"
