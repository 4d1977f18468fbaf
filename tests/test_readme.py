"""CI runs the commands of the README, and they work."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from typer.main import get_command

from lfcal.cli._app import build_app
from lfcal.judge import inspect
from lfcal.psf import open_psf

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```sh\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)
LINES = [line for block in BLOCKS for line in block.splitlines() if line.strip()]

bash = pytest.mark.skipif(os.name == "nt" or shutil.which("bash") is None, reason="CI's script needs bash")


def commands_of(line: str) -> list[list[str]]:
    """Return the words of each command in a shell line."""
    found: list[list[str]] = [[]]
    for word in shlex.split(line, comments=True):
        if word == "&&":
            found.append([])
        else:
            found[-1].append(word)
    return found


COMMANDS = [command for line in LINES for command in commands_of(line)]
NAMED = [
    shlex.split(quoted or indented, comments=True)
    for quoted, indented in re.findall(r"`(lfcal [^`]+)`|^    (lfcal .+)", README, re.MULTILINE)
]
"""Commands that CI does not run: those within the text, and those for frames of the user."""


def run_readme(folder: Path, binaries: Path) -> subprocess.CompletedProcess[str]:
    """Run the script of CI in a new folder, with the ``lfcal`` in ``binaries``."""
    folder.mkdir()
    path = os.pathsep.join([str(binaries), os.environ["PATH"]])
    arguments = ["bash", str(ROOT / ".ci" / "readme"), str(folder)]
    return subprocess.run(arguments, env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("command", COMMANDS + NAMED, ids=" ".join)
def test_every_command_and_option_of_the_readme_exists(command: list[str]) -> None:
    assert command[0] == "lfcal"
    entered: Any = get_command(build_app())
    words = command[1:]
    while hasattr(entered, "commands"):
        entered = entered.commands[words.pop(0)]
    entered.make_context("lfcal", words)


@bash
def test_ci_runs_the_lines_of_the_readme_as_printed_and_stops_at_the_first_that_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, stub = tmp_path / "log", tmp_path / "bin" / "lfcal"
    stub.parent.mkdir()
    stub.write_text(f'#!/bin/sh\necho "$@" >>{log}\ntest "$(wc -l <{log})" -ne "$FAILS"\n')
    stub.chmod(0o755)
    for fails in range(len(COMMANDS) + 1):
        log.write_text("")
        monkeypatch.setenv("FAILS", str(fails))
        assert bool(run_readme(tmp_path / f"run{fails}", stub.parent).returncode) == bool(fails)
        ran = [line.split() for line in log.read_text().splitlines()]
        assert ran == [words[1:] for words in COMMANDS[: fails or None]]
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert script.index("mypy") < script.index('.ci/readme "$folder"') < script.index('bash -c "$command"')


@bash
@pytest.mark.long
def test_the_lines_of_the_readme_run_in_an_empty_folder_with_good_results(tmp_path: Path) -> None:
    done = run_readme(tmp_path / "work", Path(sys.executable).parent)
    assert done.returncode == 0, done.stderr
    work = tmp_path / "work"
    with open_psf(work / "H.h5") as recorded, open_psf(work / "fit" / "H.h5") as fitted:
        assert recorded.provenance["optics"] == "auto"
        assert inspect(recorded).verdict.startswith("This H is good")
        for at in [(0, 9, 16), (1, 9, 16), (0, 3, 29), (1, 14, 2)]:
            one, other = (np.asarray(matrix[at], np.float64).ravel() for matrix in (recorded, fitted))
            other *= (one @ other) / (other @ other)
            assert np.linalg.norm(one - other) < 0.05 * np.linalg.norm(one)
    with h5py.File(work / "H.mat") as file:
        assert file["H"].shape == (2, 19, 33, 49, 49)
    volumes = tifffile.imread(work / "volume.tif")
    assert volumes.shape == (2, 2, 49, 49)
    for z, volume in enumerate(volumes):  # the point of plane z is found in plane z, in the middle
        assert np.unravel_index(int(volume.argmax()), volume.shape) == (z, 24, 24)
        assert volume[z, 22:27, 22:27].sum() > 0.95 * volume.sum()
    assert (work / "report").is_dir()
