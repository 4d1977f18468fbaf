"""What an installation contains: the wheel is small, and optional libraries stay optional."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
import zlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
WHEEL = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
UNSHIPPED = {"__pycache__", ".nbi", ".nbc", ".pyc"}
NAMES = 120
"""Bytes that a wheel needs for each file besides its content."""


def packed(place: Path) -> int:
    """Return the bytes that a file or folder takes in a wheel."""
    files = [place] if place.is_file() else [path for path in place.rglob("*") if path.is_file()]
    kept = [path for path in files if not UNSHIPPED & {path.suffix, path.parent.name}]
    assert kept, f"{place}: nothing to ship"
    return sum(len(zlib.compress(path.read_bytes())) + NAMES + 2 * len(str(path.relative_to(ROOT))) for path in kept)


@pytest.mark.long
def test_the_wheel_is_below_6_megabytes() -> None:
    assert sum(packed(ROOT / place) for place in (*WHEEL["packages"], *WHEEL["force-include"])) < 6e6


@pytest.mark.long
@pytest.mark.parametrize("program", ["lfcal", "lfcal_gui"])
def test_modules_of_others_named_gui_do_no_harm(tmp_path: Path, program: str) -> None:
    for name in ("gui", "models", "widgets", "pages", "app"):
        (tmp_path / f"{name}.py").write_text("raise AssertionError('this module of another program was imported')\n")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), str(ROOT), str(ROOT / "gui")))}
    code = "import lfcal_gui.window, runpy, sys; sys.argv[1:] = ['--help']; runpy.run_module(PROGRAM, None, '__main__')"
    code = code.replace("PROGRAM", repr(program))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=tmp_path)
    assert done.returncode == 0 and "--help" in done.stdout, done.stderr
