"""What may be written where, on disks that refuse, and by commands that are killed."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile
import typer.main

from lfcal.base.files import replace_whole
from lfcal.cli._app import build_app
from lfcal.judge.report import report_files
from lfcal.psf import _tiff_export as tiff_export
from tests.cli.conftest import Lfcal
from tests.cli.test_options import walk
from tests.cli.writing import LONG, WRITERS, Answer, Shell, listing

# -- What may be written where: inputs stay, what exists is replaced with --force alone, two programs do not mix --


@pytest.fixture
def place(inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder, also the current one, that holds what the commands read."""
    shutil.copytree(inputs, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_command_that_takes_an_output_is_among_the_writers() -> None:
    """A new command with --out cannot forget the rules."""
    commands = dict(walk(typer.main.get_command(build_app())))
    outputs = ("out", "report", "assemble", "draw")
    written = {path for path, command in commands.items() if any(p.name in outputs for p in command.params)}
    called = {
        max((path for path in commands if tuple(w.words()[: len(path)]) == path), key=len) for w in WRITERS.values()
    }
    assert written <= called


def test_what_exists_is_replaced_with_force_alone(lfcal: Lfcal, place: Path) -> None:
    for name, writer in WRITERS.items():
        (place / writer.output).parent.mkdir(exist_ok=True)
        (place / writer.output).write_text("old")
        before = listing(place)
        said = f"{writer.output}: exists; add --force to replace it, or choose another name\n"
        assert lfcal(*writer.words()).refused().err.endswith(said), name
        assert listing(place) == before, name
        (place / writer.output).unlink()


def test_what_cannot_be_written_is_refused_before_the_work(lfcal: Lfcal, place: Path) -> None:
    for name in ("plan", "white", "inspect", "acquire", "reconstruct batch", "multiplex figures"):
        writer = WRITERS[name]
        target = place / writer.output
        target.parent.mkdir(exist_ok=True)
        target.write_text("old")
        target.chmod(0o400)
        before = listing(place)
        said = f"{writer.output}: this file is read-only; choose another name, or make the file writable\n"
        run = lfcal(*writer.words("--force"))
        assert run.code == 2 and run.err.count("\n") == 1 and run.err.endswith(said), (name, run.err)
        assert listing(place) == before, name
        target.unlink()


def test_force_replaces_through_a_link(lfcal: Lfcal, place: Path) -> None:
    kept = place / "kept elsewhere"
    for name in ("plan", "transpose", "export h5", "export tif", "reconstruct npy"):
        target = place / WRITERS[name].output
        target.unlink(missing_ok=True)
        kept.write_text("old")
        kept.chmod(0o640)
        target.symlink_to(kept)
        lfcal(*WRITERS[name].words("--force")).ok()
        assert target.is_symlink() and kept.stat().st_size > 100 and kept.stat().st_mode & 0o777 == 0o640, name
        assert not [p for p in place.rglob(".*") if p.suffix in (".part", ".lock")], name


INPUTS = (
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
)
"""A command, and the input that it is to replace."""


def test_an_input_is_never_replaced(lfcal: Lfcal, place: Path) -> None:
    (place / "link.h5").symlink_to("H.h5")
    for folder, name in (("frames", "frame.tif"), ("out", "camera.json"), ("out", "H.h5")):
        (place / folder).mkdir(exist_ok=True)
        shutil.copy(place / name, place / folder / ("a.tif" if folder == "frames" else name))
    before = listing(place)
    for command, kept in INPUTS:
        lfcal(*command.split(), "--force").refused("output: expected a file other than the input")
        assert kept in before and listing(place) == before, command


def test_devices_and_folders_are_no_outputs(lfcal: Lfcal, place: Path) -> None:
    os.mkfifo(place / "pipe.h5")
    (place / "folder.h5").mkdir()
    (place / "file").write_text("")
    for out, why in (("pipe.h5", "pipe or a device"), ("folder.h5", "is a folder"), ("file/out.h5", "is a file")):
        lfcal("transpose", "H.h5", "-o", out, "--force").refused(why)


@pytest.mark.long
def test_other_files_of_a_folder_stay(lfcal: Lfcal, place: Path) -> None:
    (place / "out").mkdir()
    (place / "out" / "notes.txt").write_text("mine")
    lfcal(*WRITERS["inspect"].words(), "--reference", "H.h5").ok()
    assert (place / "out" / "notes.txt").read_text() == "mine"
    (place / "out" / "notes.txt").rename(place / "notes.txt")
    assert set((place / "out").iterdir()) <= set(report_files(place / "out")), "all that it may replace is checked"
    lfcal(*WRITERS["inspect"].words()).refused("index.html: exists")


def test_tiff_stacks_are_named_with_their_bytes(lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = lfcal(*WRITERS["export tif"].words())
    assert whole.code == 0 and whole.out.startswith("out.tif: (1, 5, 5, 31, 31), ")
    (place / "out.tif").unlink()
    monkeypatch.setattr(tiff_export, "ONE_FILE_BYTES", 1000)  # a large H is a file for each plane
    said = lfcal(*WRITERS["export tif"].words())
    size = (place / "out_z000.tif").stat().st_size
    assert said.code == 0 and said.out.startswith("out_z000.tif: (1, 5, 5, 31, 31), ") and " 0 B" not in said.out
    found = lfcal(*WRITERS["export tif"].words("--force", "--json")).json
    assert not (place / "out.tif").exists()
    assert found["files"] == [{"file": "out_z000.tif", "bytes": size}] and found["file_bytes"] == size


def test_frames_of_one_file_become_volumes_of_one_file(lfcal: Lfcal, place: Path) -> None:
    """As a hyperstack ImageJ opens; each frame's volume in the order of its page."""
    words = ("reconstruct", "H.h5", "stack.tif", "-n", 2, "-o")
    for out in ("single", "all.tif", "all.h5", "all.npy"):
        lfcal(*words, out, "--json").ok()
    single = [tifffile.imread(place / "single" / f"stack_000{k}.tif").reshape(1, 40, 40) for k in range(2)]
    with h5py.File(place / "all.h5") as file, tifffile.TiffFile(place / "all.tif") as tif:
        assert json.loads(file.attrs["details"])["frames"] == ["stack_0000", "stack_0001"]
        assert tif.imagej_metadata is not None and tif.imagej_metadata["frames"] == 2
        for made in (np.load(place / "all.npy"), file["volume"][...], tif.asarray().reshape(2, 1, 40, 40)):
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
    """The second is refused; the first is not disturbed; one that was killed does not keep others out."""
    command = [sys.executable, "-c", HOLD, str(place / "out.h5")]
    for killed in (False, True):
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as first:
            assert first.stdout is not None and first.stdout.readline() == b"writing\n"
            if killed:
                first.kill()
                continue
            said = "out.h5: another program is writing it; wait for it to end, or choose another name"
            lfcal("transpose", "H.h5", "-o", "out.h5").refused(said)
            first.communicate(b"\n")
        assert (place / "out.h5").read_text() == "first" and not list(place.glob(".out*"))
    assert len(list(place.glob(".out*"))) == 2, "its part and its lock"
    lfcal("transpose", "H.h5", "-o", "out.h5", "--force").ok()
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


# -- Disks that refuse: full, over quota, read-only, another file system. One line, the old file whole, nothing left --
UNCHECKED = "import lfcal.base.files; lfcal.base.files.require_space = lambda *_, **__: None"
"""The free space is not looked at beforehand, as where another program fills the disk meanwhile."""

NAMES = [pytest.param(name, marks=pytest.mark.long) if name in LONG else name for name in WRITERS]
SOME = {"plan", "transpose", "reconstruct h5"}
A_FEW = [pytest.param(name, marks=[] if name in SOME else pytest.mark.long) for name in WRITERS]

Mount = Callable[[str], Path]


@pytest.fixture(scope="module")
def shell() -> Iterator[Shell]:
    found = Shell(UNCHECKED)
    yield found
    found.close()


@pytest.fixture
def mount(tmp_path: Path) -> Iterator[Mount]:
    """Give a function that mounts a small disk in memory with the given options."""
    if shutil.which("mount") is None or not hasattr(os, "geteuid") or os.geteuid() != 0:
        pytest.skip("only the administrator can mount a disk")
    folder = tmp_path / "disk"
    folder.mkdir()

    def mounted(options: str) -> Path:
        command = ["mount", "-t", "tmpfs", "-o", options, "none", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            pytest.skip(f"a disk cannot be mounted here: {done.stderr.strip()}")
        return folder

    yield mounted
    subprocess.run(["umount", "-l", str(folder)], capture_output=True)


def prepare(inputs: Path, folder: Path, name: str) -> dict[str, bytes]:
    """Copy what the commands read, and put an old file where the command writes; return all that is there."""
    shutil.copytree(inputs, folder, dirs_exist_ok=True)
    target = folder / WRITERS[name].output
    target.parent.mkdir(exist_ok=True)
    target.write_text("old")
    return listing(folder)


def check(answer: Answer, folder: Path, name: str, before: dict[str, bytes], *why: str) -> None:
    said = [line for line in answer.err.splitlines() if not any(w in line for w in (" ahead", "note:", "set-up"))]
    assert answer.code == 2, answer
    assert len(said) == 1 and any(w in said[0] for w in why) and len(said[0]) < 500, answer.err
    after, output = listing(folder), WRITERS[name].output
    assert after[output] == b"old"
    assert not [k for k in after if k.endswith((".part", ".lock")) and k != "s/session.lock"]
    # a session that was recorded, and whole files of a folder of several, are not scrap
    others = {k for k in after if k.startswith(("s/", "out/")) or k == output}
    assert {k: v for k, v in after.items() if k not in others} == {k: before[k] for k in before if k not in others}


@pytest.mark.few(1)
@pytest.mark.skipif(os.name == "nt", reason="this system has no limits on file sizes")
@pytest.mark.parametrize("name", NAMES)
def test_writes_refused_in_the_middle(shell: Shell, inputs: Path, tmp_path: Path, name: str) -> None:
    """Real writes, refused by the system as by a quota."""
    before = prepare(inputs, tmp_path, name)
    answer = shell.run(WRITERS[name].words("--force"), tmp_path, WRITERS[name].half)
    why = ("File too large; choose a disk that supports", "stored only a part of the data; free")
    check(answer, tmp_path, name, before, *why)


@pytest.mark.parametrize("name", [one for one in A_FEW if one.values != ("acquire",)])
def test_a_disk_that_fills_up(shell: Shell, inputs: Path, mount: Mount, name: str) -> None:
    """Not of a recording, which waits until there is space again."""
    folder = mount("size=24m")
    prepare(inputs, folder, name)
    left = WRITERS[name].half // 4096 * 4096
    (folder / "filling").write_bytes(bytes(shutil.disk_usage(folder).free - left))
    answer = shell.run(WRITERS[name].words("--force"), folder)
    check(answer, folder, name, listing(folder), "free some space or choose another disk")


@pytest.mark.parametrize("name", A_FEW)
def test_a_disk_that_is_read_only(shell: Shell, inputs: Path, mount: Mount, name: str) -> None:
    folder = mount("size=24m")
    before = prepare(inputs, folder, name)
    subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
    check(shell.run(WRITERS[name].words("--force"), folder), folder, name, before, "is not writable; choose another")


def test_an_output_on_another_file_system(shell: Shell, inputs: Path, mount: Mount, tmp_path: Path) -> None:
    """The scratch file is in the folder of its target, through links too, so that nothing is moved between disks."""
    folder = mount("size=24m")
    prepare(inputs, tmp_path, "transpose")
    (tmp_path / "out.h5").unlink()
    (tmp_path / "out.h5").symlink_to(folder / "HT.h5")
    for more in ((), ("--force",)):
        answer = shell.run(WRITERS["transpose"].words(*more), tmp_path)
        assert answer.code == 0, answer.err
    assert [p.name for p in folder.iterdir()] == ["HT.h5"] and (tmp_path / "out.h5").is_symlink()


# -- Commands ended at any moment: the old file whole or the new one, and nothing left after the next run --
POSIX = pytest.mark.skipif(os.name != "posix", reason="ended by signals")

SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SECONDS = 30.0
"""Longest time after its start that a command is ended; its own duration where that is shorter."""

PNG_END = b"IEND\xaeB`\x82"

HEARING = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
"""
"""Programs in the background of a shell, and under nohup, begin with these signals ignored."""

CHILD = (
    HEARING
    + """
import sys
from lfcal.cli import main
sys.argv = ['lfcal', *sys.argv[1:]]
print('ready', flush=True)
main()
"""
)


@pytest.fixture(scope="module")
def killing(inputs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(shutil.copytree(inputs, tmp_path_factory.mktemp("kills") / "inputs"))


def start(words: list[str], folder: Path) -> subprocess.Popen[bytes]:
    """Start a command; return when its program is about to begin."""
    command = [sys.executable, "-c", CHILD, *words]
    child = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert child.stdout is not None and child.stdout.readline() == b"ready\n"
    return child


def scrap(folder: Path) -> list[str]:
    return [k for k in listing(folder) if k.endswith((".part", ".lock")) and not k.endswith("session.lock")]


def whole(words: list[str], folder: Path, output: str) -> tuple[bytes, float]:
    """Run a command to its end; return what it wrote and how long it took (s)."""
    began = time.monotonic()
    child = start(words, folder)
    _, err = child.communicate()
    assert child.returncode == 0, err.decode()
    return (folder / output).read_bytes(), time.monotonic() - began


def end_by(number: signal.Signals, words: list[str], folder: Path, seconds: float) -> tuple[int, str]:
    """Start a command and send it a signal after ``seconds``; return exit code and what it said."""
    child = start(words, folder)
    try:
        err = child.communicate(timeout=seconds)[1]
    except subprocess.TimeoutExpired:
        child.send_signal(number)
        err = child.communicate()[1]
    return child.returncode, err.decode()


def check_kills(name: str, killing: Path, count: int, *, seed: int) -> None:
    writer, rng = WRITERS[name], random.Random(seed)
    words, target = writer.words("--force"), killing / writer.output
    new, seconds = whole(words, killing, writer.output)
    for k in range(count):
        number = SIGNALS[k % len(SIGNALS)]
        old, lying = target.read_bytes(), set(scrap(killing))
        shutil.rmtree(killing / "s", ignore_errors=True)
        code, err = end_by(number, words, killing, rng.uniform(0, min(seconds, SECONDS)))
        assert code in (0, 128 + number, -number), err
        assert "Traceback" not in err, err
        if code == 128 + number:
            assert err.splitlines()[-1].startswith("lfcal: stop") or name == "acquire", err
        found = target.read_bytes()
        # a measurement that is stopped draws what it has: another chart, but a whole one
        part = name == "accuracy" and found.endswith(PNG_END)
        # what says when it was made differs from run to run in length alone, if at all
        assert found == old or part or (code == 0 or abs(len(found) - len(new)) < 4096), f"{name}: {number.name}"
        if number != signal.SIGKILL and code > 0:
            left = set(scrap(killing)) - lying  # what a killed one has left may lie there until one begins to write
            assert not left, f"{name}: {number.name} leaves {left}"
    shutil.rmtree(killing / "s", ignore_errors=True)
    whole(words, killing, writer.output)
    assert not scrap(killing)


@POSIX
@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in WRITERS if name != "reconstruct zarr"])
def test_ended_at_any_moment(killing: Path, name: str) -> None:
    check_kills(name, killing, 30 if name == "acquire" else 10, seed=sum(map(ord, name)))


WAITING = (
    HEARING
    + """
import sys
from lfcal.cli import main
import lfcal.base.files
real = lfcal.base.files.sync_file
def wait(path):
    real(path)
    print('written', flush=True)
    signal.pause()
lfcal.base.files.sync_file = wait
sys.argv = ['lfcal', *sys.argv[1:]]
main()
"""
)


@POSIX
@pytest.mark.few(1)
@pytest.mark.parametrize(
    "number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.long)]
)
def test_ended_while_the_scratch_file_lies_there(killing: Path, number: signal.Signals) -> None:
    """At the worst moment: all is written, and has not got its name yet."""
    words = WRITERS["transpose"].words("--force")
    (killing / "out.h5").write_text("old")
    command = [sys.executable, "-c", WAITING, *words]
    child = subprocess.Popen(command, cwd=killing, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert child.stdout is not None and child.stdout.readline() == b"written\n"
    child.send_signal(number)
    _, err = child.communicate()
    assert (killing / "out.h5").read_text() == "old"
    if number == signal.SIGKILL:
        assert child.returncode == -number and len(scrap(killing)) == 2
        whole(words, killing, "out.h5")
    else:
        assert child.returncode == 128 + number and err.decode() == "lfcal: stopped; no incomplete output remains\n"
    assert not scrap(killing)
