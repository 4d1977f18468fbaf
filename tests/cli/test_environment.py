"""Streams, odd file names, pipes, lost folders, and the rules of Windows."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfcal.acquire import RedoList
from lfcal.base.errors import FileFormatError, StorageError
from lfcal.base.files import read_text, replace_whole
from lfcal.psf import PSFMatrix, open_psf, save
from tests.cli.conftest import SHAPE, Lfcal, true_frame
from tests.judge.plain_report import undrawn
from tests.windows_rules import OpenFileError, held_files, keep_open_files

# -- Closed and full streams, names that no file can have, a folder that is gone: one message, never a traceback --
POSIX = pytest.mark.skipif(os.name != "posix", reason="streams and names of POSIX")
FULL = Path("/dev/full")


@pytest.fixture
def place(tmp_path: Path) -> Path:
    save(PSFMatrix(np.ones((1, 3, 3, 5, 5), np.float32), depths=(1.0,)), tmp_path / "H.h5")
    return tmp_path


def in_a_shell(place: Path, words: list[str], redirect: str = "") -> tuple[int, str]:
    """Run the command in a shell, and return its exit code and standard error (output where that is redirected)."""
    code = "import sys; from lfcal.cli import main; sys.argv[0] = 'lfcal'; main()"
    words = ["sh", "-c", f'exec "$0" -c "{code}" "$@" {redirect}', sys.executable, *words]
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "NUMBA_DISABLE_JIT": "0"}
    found = subprocess.run(words, cwd=place, capture_output=True, text=True, errors="replace", check=False, env=env)
    return found.returncode, found.stderr


@POSIX
@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full")
@pytest.mark.parametrize(
    ("redirect", "code", "words"),
    [
        (">/dev/full", 2, "lfcal: standard output: No space left on device; check where it is written to"),
        *(pytest.param(redirect, 0, "", marks=pytest.mark.long) for redirect in ("2>&-", ">&-", "2>/dev/full")),
    ],
)
def test_closed_and_full_streams_end_without_a_traceback(place: Path, redirect: str, code: int, words: str) -> None:
    found, said = in_a_shell(place, ["export", "H.h5", "-o", "out.npy", "--force"], redirect)
    assert (found, said.strip()) == (code, words)
    assert (place / "out.npy").exists()


@POSIX
def test_names_that_are_too_long_are_refused(lfcal: Lfcal, place: Path) -> None:
    for name in ("a" * 300 + ".npy", "a/" * 3000 + "b.npy"):
        lfcal("export", place / "H.h5", "-o", name).refused("File name too long")
        lfcal("inspect", name).refused()


@POSIX
def test_a_current_folder_that_is_gone_is_named(lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (place / "gone").mkdir()
    monkeypatch.chdir(place / "gone")
    (place / "gone").rmdir()
    assert lfcal("export", place / "H.h5", "-o", "out.npy").refused().err.strip().endswith("change to one that exists")


HELP = """
import sys
from lfcal.cli import main
for words in ([], ["simulate"], ["camera", "new"], ["camera", "import"], ["multiplex", "compare"], ["doctor"]):
    sys.argv = ["lfcal", *words, "--help"]
    try:
        main()
    except SystemExit as end:
        assert not end.code
"""


@pytest.mark.long
@POSIX
def test_help_is_the_same_without_docstrings_in_compiled_code(tmp_path: Path) -> None:
    """``python -OO`` drops docstrings, which once emptied the list of commands."""
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "COLUMNS": "100"}
    usual, without = (
        subprocess.run([sys.executable, *flags, "-c", HELP], cwd=tmp_path, capture_output=True, env=env, check=True)
        for flags in ([], ["-OO"])
    )
    assert usual.stdout.count(b"Usage: lfcal") == 6 and without.stdout == usual.stdout


@pytest.mark.long
@POSIX
def test_a_file_whose_name_is_not_text_can_be_inspected(place: Path) -> None:
    odd = os.fsdecode(b"H\xff.h5")
    os.rename(place / "H.h5", place / odd)
    found, said = in_a_shell(place, ["inspect", odd, "--report", os.fsdecode(b"report\xff"), "--seconds", "0"])
    assert found == 0 and "Traceback" not in said, said
    assert (place / os.fsdecode(b"report\xff") / "index.html").exists()


@POSIX
def test_a_scratch_file_is_new_and_follows_no_link(tmp_path: Path) -> None:
    """In a folder that others may write to, a planted link once made lfcal write into the file it leads to."""
    victim, target = tmp_path / "victim", tmp_path / "out.txt"
    victim.write_text("mine")
    link = tmp_path / f".out.txt.{os.getpid()}.part"

    real = os.open

    def planting(path: object, flags: int, mode: int = 0o777, **more: object) -> int:
        if str(path) == str(link) and not link.is_symlink():
            link.symlink_to(victim)
        return real(path, flags, mode, **more)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "open", planting)
        with pytest.raises(Exception, match="exists"):
            with replace_whole(target) as part:
                part.write_text("other")
    assert victim.read_text() == "mine"


# -- Inputs that are no files: pipes and devices are refused at once by every command, never waited for --
PIPES = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")

HANG_S = 120
"""Only to end a test that hangs: a pipe without a writer never ends."""

ON_PIPES = {
    "H": ("export", "PIPE.h5", "-o", "out.npy"),
    "npy": ("inspect", "PIPE.npy"),
    "mat": ("transpose", "PIPE.mat", "-o", "out.h5"),
    "manifest": ("assemble", "PIPE.csv", "-o", "out.h5", "--plan", "plan.json"),
    "plan": ("assemble", "frames", "-o", "out.h5", "--plan", "PIPE.json"),
    "plan of a session": ("acquire", "PIPE.json", "--out", "s"),
    "dark": ("assemble", "frames", "-o", "out.h5", "--dark", "PIPE.tif"),
    "camera": ("plan", "PIPE.json", "--virtual-depths", "3"),
    "xml": ("plan", "PIPE.xml", "--virtual-depths", "3"),
    "simulated plan": ("simulate", "PIPE.json", "-o", "out.h5"),
    "white image": ("white", "PIPE.png"),
}


CHILD = """
import contextlib, io, json, sys
from lfcal.cli import main
for line in sys.stdin:
    sys.argv, said, code = ['lfcal', *json.loads(line)], io.StringIO(), 0
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            main()
        except SystemExit as end:
            code = end.code
    print(json.dumps([code, said.getvalue()]), flush=True)
"""


def run(commands: list[list[str]], folder: Path) -> list[tuple[int, str]]:
    """Run commands one after the other in a separate process, which can be ended if one hangs."""
    text = "".join(json.dumps(command) + "\n" for command in commands)
    words = [sys.executable, "-c", CHILD]
    done = subprocess.run(words, input=text, cwd=folder, capture_output=True, text=True, timeout=HANG_S)
    return [tuple(json.loads(line)) for line in done.stdout.splitlines()]


@PIPES
def test_pipes_and_devices_are_refused_by_every_command(session: Path) -> None:
    commands = []
    for number, (case, arguments) in enumerate(ON_PIPES.items()):
        pipes = {name: str(session / f"{number}_{name}") for name in arguments if name.startswith("PIPE")}
        assert pipes, case
        for name in pipes.values():
            os.mkfifo(name)
        commands.append([pipes.get(name, name) for name in arguments])
    commands += [["plan", "/dev/zero", "--virtual-depths", "3"], ["export", "/dev/urandom", "-o", "x.npy"]]
    for words, (code, said) in zip(commands, run(commands, session), strict=True):
        assert code == 2 and len(said.strip().splitlines()) == 1, (words, said)
        assert "is a pipe or a device; give the path of a file" in said, (words, said)
    assert not (session / "out.h5").exists() and not (session / "out.npy").exists()
    os.mkfifo(session / "redo.json")
    with pytest.raises(StorageError, match="is a pipe or a device"):
        RedoList.read(session / "redo.json")


@PIPES
def test_endless_text_has_a_limit(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b" " * 2000)
    assert read_text(tmp_path / "a.json", limit=2000) == " " * 2000
    with pytest.raises(FileFormatError, match=r"a\.json: expected text of at most 1\.5 kB, got a larger file"):
        read_text(tmp_path / "a.json", limit=1500)
    (tmp_path / "b.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileFormatError, match="expected text in UTF-8, got text in another encoding"):
        read_text(tmp_path / "b.json")


# -- Commands under the rules of Windows: nothing is open when it is replaced, and texts end their lines as there --
LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="asks /proc what is open")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    keep_open_files(monkeypatch, tmp_path)
    return tmp_path


@LINUX
def test_the_rules_are_kept(here: Path) -> None:
    (here / "a").write_bytes(b"1")
    (here / "b").write_bytes(b"2")
    (here / "folder").mkdir()
    with open(here / "a", "rb") as file:
        state = os.fstat(file.fileno())
        assert (state.st_dev, state.st_ino) in held_files()
        for refused in (lambda: os.replace("b", "a"), lambda: os.rename("a", "c"), (here / "a").unlink):
            with pytest.raises(OpenFileError):
                refused()
    mapped = np.memmap(here / "a", np.uint8, "r")
    with pytest.raises(OpenFileError):
        os.replace("b", "a")
    del mapped
    os.replace("b", "a")
    os.replace("a", "folder/a")
    with open(here / "folder" / "a", "rb"), pytest.raises(OpenFileError):
        os.rename("folder", "other")
    assert (here / "folder" / "a").read_bytes() == b"2"


def assembled(lfcal: Lfcal, session: Path, out: str) -> None:
    words = ("assemble", session / "frames", "--plan", session / "plan.json", "--dark", session / "dark")
    lfcal(*words, "-o", out, "--force").ok()


AFTER = (
    ("transpose", "H.h5", "-o", "HT.h5"),
    ("reduce", "H.h5", "-o", "small.h5", "--tolerance", "0.01"),
    ("export", "H.h5", "-o", "H.mat"),
    ("verify", "H.h5"),
)
MORE_AFTER = (
    *(("export", "H.h5", "-o", f"H{suffix}") for suffix in (".tif", ".npy")),
    ("compare", "H.h5", "other.h5"),
    ("inspect", "H.h5", "--report", "report", "--seconds", "0"),
    ("reconstruct", "H.h5", "frame.png", "-o", "volume.tif", "--iterations", "1"),
)


@LINUX
@pytest.mark.parametrize("commands", [AFTER, pytest.param(MORE_AFTER, marks=pytest.mark.long)], ids=["some", "more"])
def test_what_is_written_twice_is_not_open(
    lfcal: Lfcal, session: Path, here: Path, monkeypatch: pytest.MonkeyPatch, commands: tuple[tuple[str, ...], ...]
) -> None:
    undrawn(monkeypatch)
    for name in ("H.h5", "H.h5", "other.h5"):
        assembled(lfcal, session, name)
    cv2.imwrite("frame.png", true_frame(0, 1, 1))
    for words in commands:
        for _ in range(2):
            lfcal(*words, *(() if words[0] in ("compare", "verify") else ("--force",))).ok()
        assert not [path for path in here.rglob(".*") if path.suffix in (".part", ".lock")], words


@LINUX
def test_a_matrix_in_use_is_not_replaced(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(PSFMatrix(np.ones((1, 3, 3, 5, 5), np.float32)), here / "H.h5")
    with open_psf(here / "H.h5") as H:
        monkeypatch.setattr("lfcal.base.system.sys", type("sys", (), {"platform": "win32"}))
        monkeypatch.setattr("lfcal.base.system.is_alive", lambda process: False)
        monkeypatch.setattr("lfcal.base.files.lock", lambda descriptor: None)
        said = r"H\.h5: expected .* is open in another program; close it there and try again"
        with pytest.raises(Exception, match=said), replace_whole(here / "H.h5") as part:
            part.write_bytes(b"other")
        assert H[0, 0, 0].shape == (5, 5)
    assert not list(here.glob(".*.part"))


@pytest.mark.long
@LINUX
def test_a_recording_is_packed_and_read_again(lfcal: Lfcal, session: Path, here: Path) -> None:
    lfcal("acquire", session / "plan.json", "--backend", "sim", "--out", "recorded", "--json").ok()
    lfcal("verify", "recorded").ok()
    for _ in range(2):
        lfcal("assemble", "recorded", "-o", here / "R.h5", "--force").ok()
    with open_psf("R.h5") as H:
        assert H.shape[:3] == SHAPE


@LINUX
def test_lines_may_end_as_windows_ends_them(lfcal: Lfcal, session: Path, here: Path) -> None:
    assembled(lfcal, session, "H.h5")
    for mark in (b"", b"\xef\xbb\xbf"):
        for path in (session / "plan.json", session / "frames" / "manifest.csv"):
            path.write_bytes(mark + path.read_bytes().replace(b"\r\n", b"\n").replace(b"\n", b"\r\n"))
        assembled(lfcal, session, "other.h5")
        with open_psf(here / "H.h5") as H, open_psf("other.h5") as other:
            np.testing.assert_array_equal(H[:], other[:])
