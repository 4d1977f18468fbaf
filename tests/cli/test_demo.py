from __future__ import annotations

import collections
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest

from lfcal.psf import open_psf
from lfcal.simulate import sample_session
from tests.cli.conftest import Run
from tests.judge.plain_report import undrawn


@pytest.mark.parametrize("drawn", [False, pytest.param(True, marks=pytest.mark.long)])
def test_the_main_job_on_the_sample_session(
    lfcal: Callable[..., Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, drawn: bool
) -> None:
    """The pictures of its report are those of any report; its own are always drawn."""
    if not drawn:
        undrawn(monkeypatch)
    out = tmp_path / "demo"
    run = lfcal("demo", out, "--json")
    assert run.code == 0, run.err
    found: Any = run.json
    assert found["correlation"] > 0.999, "H from frames equals H simulated directly"
    assert found["max_shift_px"] < 0.3
    assert found["recorded_correlation"] > 0.999, "and so is H of the session that lfcal recorded"
    assert len(found["steps"]) == 7 and all(step["made"] and step["seconds"] > 0 for step in found["steps"])
    with open_psf(out / "H.h5") as H, open_psf(out / "H.mat") as exported:
        assert list(H.shape) == found["shape"]
        np.testing.assert_array_equal(H[1, 9, 16], exported[1, 9, 16])
        iris = H.aperture(1)
        assert iris.blades == 7 and iris.confident
    with h5py.File(out / "H.mat") as file:
        assert {"H", "Ht", "Nnum", "CAindex", "x3objspace"} <= set(file)
    for name in ("H_and_HT.png", "depth_sums.png"):
        assert cv2.imread(str(out / name)).std() > 10, "a picture, not an empty page"
    assert "<html" in (out / "report" / "index.html").read_text(encoding="utf-8")[:200]


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


@pytest.mark.long
def test_a_first_demo_compiles_few_kernels_and_none_twice(tmp_path: Path) -> None:
    """Compiling is most of the time of the first command: for another kind of array, or called alone, it is wasted."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    line = [sys.executable, "-c", COUNTED, "demo", str(tmp_path / "out")]
    done = subprocess.run(line, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    compiled = json.loads(done.stderr.splitlines()[-1])
    count = collections.Counter(name for name in compiled if name.startswith("lfcal."))
    assert not {name: times for name, times in count.items() if times > 1}
    assert 0 < len(count) <= MOST_KERNELS, sorted(count)


FIRST = {
    "simulate": ["simulate", "bench", "--virtual-depths", "3", "-o", "H.h5"],
    "assemble": [
        "assemble",
        "{session}/frames",
        "--plan",
        "{session}/plan.json",
        "--white",
        "{session}/white",
        "-o",
        "H.h5",
    ],
    "white": ["white", "{session}/white", "-o", "lattice.json"],
}


@pytest.mark.long
@pytest.mark.parametrize("name", FIRST)
def test_a_first_command_on_little_data_compiles_nothing(tmp_path: Path, name: str) -> None:
    """Compiling would take longer than the command itself."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    words = [word.format(session=sample_session()) for word in FIRST[name]]
    line = [sys.executable, "-c", COUNTED, *words]
    done = subprocess.run(line, env=environment, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stderr.splitlines()[-1]) == []
