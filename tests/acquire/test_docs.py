"""The documented example records and assembles a session; importing the packages loads nothing heavy."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfcal.acquire
import lfcal.devices
from lfcal.psf import open_psf
from tests.acquire.rigs import small_plan

PAGE = Path(__file__).parents[2] / "docs" / "acquisition.md"


def test_the_documented_example_works_and_imports_from_one_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (block,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert set(re.findall(r"from (lfcal\S*) import", block)) == {"lfcal.acquire"}
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"plan": small_plan()}
    exec(block, names)
    assert names["quality"].state().done == 27
    assert len(names["lamp"]) == 2
    assert names["pattern"].shape == (21, 21)
    with open_psf(tmp_path / "H.h5") as matrix:
        assert matrix.shape == small_plan().shape
        assert np.all(matrix.recorded)


def test_importing_loads_nothing_heavy() -> None:
    heavy = ("numba", "h5py", "scipy", "cv2", "matplotlib", "tifffile", "rawpy", "PySide6", "lfcal.simulate")
    packages = "lfcal.acquire, lfcal.devices, lfcal.acquire.setup"
    code = f"import sys, {packages}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_exists() -> None:
    for package in (lfcal.acquire, lfcal.devices):
        assert len(set(package.__all__)) == len(package.__all__)
        assert all(hasattr(package, name) for name in package.__all__)
