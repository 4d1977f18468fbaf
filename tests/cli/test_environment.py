"""Closed and full streams, names that no file can have, a folder that is gone: one message, never a traceback."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.files import replace_whole
from lfcal.psf import PSFMatrix, save

pytestmark = pytest.mark.skipif(os.name != "posix", reason="streams and names of POSIX")
FULL = Path("/dev/full")


@pytest.fixture
def place(tmp_path: Path) -> Path:
    save(PSFMatrix(np.ones((1, 3, 3, 5, 5), np.float32), depths=(1.0,)), tmp_path / "H.h5")
    return tmp_path


def lfcal(place: Path, words: list[str], redirect: str = "") -> tuple[int, str]:
    """Run the command in a shell, and return its exit code and standard error (output where that is redirected)."""
    code = "import sys; from lfcal.cli import main; sys.argv[0] = 'lfcal'; main()"
    command = f'exec "$0" -c "{code}" "$@" {redirect}'
    root = Path(__file__).parents[2]
    found = subprocess.run(
        ["sh", "-c", command, sys.executable, *words],
        cwd=place,
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
        env={**os.environ, "PYTHONPATH": str(root), "NUMBA_DISABLE_JIT": "0"},
    )
    return found.returncode, found.stderr


EXPORT = ["export", "H.h5", "-o", "out.npy", "--force"]


@pytest.mark.parametrize(
    ("redirect", "code", "words"),
    [
        ("2>&-", 0, ""),
        (">&-", 0, ""),
        ("2>/dev/full", 0, ""),
        (">/dev/full", 2, "lfcal: standard output: No space left on device; check where it is written to"),
    ],
)
@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full")
def test_closed_and_full_streams(place: Path, redirect: str, code: int, words: str) -> None:
    found, said = lfcal(place, EXPORT, redirect)
    assert (found, said.strip()) == (code, words)
    assert (place / "out.npy").exists()


@pytest.mark.parametrize("name", ["a" * 300 + ".npy", "a/" * 3000 + "b.npy"])
def test_names_that_are_too_long(place: Path, name: str) -> None:
    found, said = lfcal(place, ["export", "H.h5", "-o", name])
    assert found == 2 and said.count("\n") == 1 and "File name too long" in said
    found, said = lfcal(place, ["inspect", name])
    assert found == 2 and said.count("\n") == 1


def test_a_folder_that_is_gone(place: Path) -> None:
    found, said = lfcal(place, ["export", str(place / "H.h5"), "-o", "out.npy"], "")
    assert found == 0, said
    code = "import os, sys; os.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone'); from lfcal.cli import main; main()"
    words = [sys.executable, "-c", code, "export", str(place / "H.h5"), "-o", "out.npy"]
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(words, cwd=place, capture_output=True, text=True, check=False, env=env)
    assert done.returncode == 2 and done.stderr.strip().endswith("change to one that exists"), done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    "words",
    [[], ["simulate"], ["camera", "new"], ["camera", "import"], ["multiplex", "compare"], ["doctor"]],
    ids=" ".join,
)
def test_help_is_the_same_without_docstrings_in_compiled_code(place: Path, words: list[str]) -> None:
    """``python -OO`` drops docstrings, which once emptied the list of commands."""
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "COLUMNS": "100"}
    usual, without = (
        subprocess.run(
            [sys.executable, *flags, "-m", "lfcal", *words, "--help"],
            cwd=place,
            capture_output=True,
            env=env,
            check=True,
        ).stdout
        for flags in ([], ["-OO"])
    )
    assert without == usual


def test_a_report_of_a_file_whose_name_is_not_text(place: Path) -> None:
    odd = os.fsdecode(b"H\xff.h5")
    os.rename(place / "H.h5", place / odd)
    found, said = lfcal(place, ["inspect", odd, "--report", os.fsdecode(b"report\xff"), "--seconds", "0"])
    assert found == 0 and "Traceback" not in said, said
    assert (place / os.fsdecode(b"report\xff") / "index.html").exists()


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
