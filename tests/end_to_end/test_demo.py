from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from lfcal.psf import open_psf
from lfcal.simulate import sample_session
from tests.cli.conftest import Lfcal
from tests.judge.plain_report import undrawn


@pytest.mark.parametrize("drawn", [False, pytest.param(True, marks=pytest.mark.long)])
def test_the_main_job_on_the_sample_session(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, drawn: bool
) -> None:
    """The pictures of its report are those of any report; its own are always drawn."""
    if not drawn:
        undrawn(monkeypatch)
    found = lfcal("demo", tmp_path, "--workers", 2, "--json").ok().json
    lfcal("demo", tmp_path).refused("--force")
    assert found["correlation"] > 0.999, "H from frames equals H simulated directly"
    assert found["recorded_correlation"] > 0.999, "and so does H of the session that lfcal recorded"
    assert found["max_shift_px"] < 0.3
    assert len(found["steps"]) == 7 and all(step["made"] and step["seconds"] > 0 for step in found["steps"])
    with open_psf(tmp_path / "H.h5") as H, open_psf(tmp_path / "H.mat") as exported:
        assert list(H.shape) == found["shape"]
        np.testing.assert_array_equal(H[1, 9, 16], exported[1, 9, 16])
        assert H.aperture(1).blades == 7 and H.aperture(1).confident
    with h5py.File(tmp_path / "H.mat") as file:
        assert {"H", "Ht", "Nnum", "CAindex", "x3objspace"} <= set(file)
    for name in ("H_and_HT.png", "depth_sums.png"):
        assert cv2.imread(str(tmp_path / name)).std() > 10, "a picture, not an empty page"
    assert "<html" in (tmp_path / "report" / "index.html").read_text(encoding="utf-8")[:200]


COUNTED = """
import json, sys
from numba.core import event
compiled = []
class Listener(event.Listener):
    def on_start(self, event):
        pass
    def on_end(self, event):
        kernel = event.data["dispatcher"].py_func
        compiled.append(f"{kernel.__module__}.{kernel.__name__}")
event.register("numba:compile", Listener())
from lfcal.cli import main
try:
    main()
finally:
    print(json.dumps(compiled), file=sys.stderr)
"""

MOST_KERNELS = 10


def compiled_by(folder: Path, *words: str) -> list[str]:
    """Return the kernels that a command compiles where none was compiled before."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
    line = [sys.executable, "-c", COUNTED, *words]
    done = subprocess.run(line, env=environment, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    return list(json.loads(done.stderr.splitlines()[-1]))


@pytest.mark.long
def test_a_first_demo_compiles_few_kernels_and_none_twice(tmp_path: Path) -> None:
    """Compiling is most of the time of the first command: for another kind of array, or called alone, it is wasted."""
    names = [name for name in compiled_by(tmp_path, "demo", "out") if name.startswith("lfcal.")]
    assert len(names) == len(set(names)) and 0 < len(names) <= MOST_KERNELS, sorted(names)


FIRST = (
    "simulate bench --virtual-depths 3 -o H.h5",
    "assemble {0}/frames --plan {0}/plan.json --white {0}/white -o H.h5",
    "white {0}/white -o lattice.json",
)


@pytest.mark.long
@pytest.mark.parametrize("words", FIRST)
def test_a_first_command_on_little_data_compiles_nothing(tmp_path: Path, words: str) -> None:
    """Compiling would take longer than the command itself."""
    assert compiled_by(tmp_path, *words.format(sample_session()).split()) == []
