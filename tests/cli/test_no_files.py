"""Inputs that are no files: pipes and devices are refused at once by every command, never waited for."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from lfcal.acquire import RedoList
from lfcal.base.errors import FileFormatError, StorageError
from lfcal.base.files import read_text

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")

HANG_S = 120
"""Only to end a test that hangs: a pipe nobody writes to never ends by itself."""

COMMANDS = {
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
    """Run commands one after the other in a process of their own, so that one that hangs can be ended."""
    text = "".join(json.dumps(command) + "\n" for command in commands)
    done = subprocess.run(
        [sys.executable, "-c", CHILD], input=text, cwd=folder, capture_output=True, text=True, timeout=HANG_S
    )
    return [tuple(json.loads(line)) for line in done.stdout.splitlines()]


def test_pipes_are_refused_by_every_command(session: Path) -> None:
    commands = []
    for number, (case, arguments) in enumerate(COMMANDS.items()):
        pipes = {name: str(session / f"{number}_{name}") for name in arguments if name.startswith("PIPE")}
        assert pipes, case
        for name in pipes.values():
            os.mkfifo(name)
        commands.append([pipes.get(name, name) for name in arguments])
    found = run(commands, session)
    assert len(found) == len(COMMANDS)
    for case, (code, said) in zip(COMMANDS, found, strict=True):
        assert code == 2 and len(said.strip().splitlines()) == 1, (case, said)
        assert "is a pipe or a device; give the path of a file" in said, (case, said)
    assert not (session / "out.h5").exists() and not (session / "out.npy").exists()
    os.mkfifo(session / "redo.json")
    with pytest.raises(StorageError, match="is a pipe or a device"):
        RedoList.read(session / "redo.json")


def test_endless_devices_are_refused(tmp_path: Path) -> None:
    for code, said in run(
        [["plan", "/dev/zero", "--virtual-depths", "3"], ["export", "/dev/urandom", "-o", "x.npy"]], tmp_path
    ):
        assert code == 2 and "is a pipe or a device" in said


def test_endless_text_has_a_limit(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b" " * 2000)
    assert read_text(tmp_path / "a.json", limit=2000) == " " * 2000
    with pytest.raises(FileFormatError, match=r"a\.json: expected text of at most 1\.5 kB, got a larger file"):
        read_text(tmp_path / "a.json", limit=1500)
    (tmp_path / "b.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileFormatError, match="expected text in UTF-8, got text in another encoding"):
        read_text(tmp_path / "b.json")
