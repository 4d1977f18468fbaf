"""Commands ended at any moment: the old file whole or the new one, and nothing left after the next run."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.writing import WRITERS, listing, make_inputs

pytestmark = pytest.mark.skipif(os.name != "posix", reason="ended by signals")

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
def place(tmp_path_factory: pytest.TempPathFactory, _recorded: Path) -> Path:
    folder = tmp_path_factory.mktemp("kills")
    make_inputs(folder)
    shutil.copytree(_recorded, folder / "session")
    return folder


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


def check_kills(name: str, place: Path, count: int, *, seed: int) -> None:
    writer, rng = WRITERS[name], random.Random(seed)
    words, target = writer.words("--force"), place / writer.output
    new, seconds = whole(words, place, writer.output)
    for k in range(count):
        number = SIGNALS[k % len(SIGNALS)]
        old, lying = target.read_bytes(), set(scrap(place))
        shutil.rmtree(place / "s", ignore_errors=True)
        code, err = end_by(number, words, place, rng.uniform(0, min(seconds, SECONDS)))
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
            left = set(scrap(place)) - lying  # what a killed one has left may lie there until one begins to write
            assert not left, f"{name}: {number.name} leaves {left}"
    shutil.rmtree(place / "s", ignore_errors=True)
    whole(words, place, writer.output)
    assert not scrap(place)


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in WRITERS if name != "reconstruct zarr"])
def test_ended_at_any_moment(place: Path, name: str) -> None:
    check_kills(name, place, 30 if name == "acquire" else 10, seed=sum(map(ord, name)))


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


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.long)]
)
def test_ended_while_the_scratch_file_lies_there(place: Path, number: signal.Signals) -> None:
    """At the worst moment: all is written, and has not got its name yet."""
    words = WRITERS["transpose"].words("--force")
    (place / "out.h5").write_text("old")
    command = [sys.executable, "-c", WAITING, *words]
    child = subprocess.Popen(command, cwd=place, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert child.stdout is not None and child.stdout.readline() == b"written\n"
    child.send_signal(number)
    _, err = child.communicate()
    assert (place / "out.h5").read_text() == "old"
    if number == signal.SIGKILL:
        assert child.returncode == -number and len(scrap(place)) == 2
        whole(words, place, "out.h5")
    else:
        assert child.returncode == 128 + number
        assert err.decode() == "lfcal: stopped; no incomplete output remains\n"
    assert not scrap(place)
