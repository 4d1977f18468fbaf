"""Long work that is killed, as a whole or a worker, with every executor: the same file, and nothing is done twice."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from lfcal.camera import ScanPlan
from lfcal.psf import PSFMatrix, save
from lfcal.work import parts_folder
from lfcal.work.journal import JOURNAL
from tests.psf.test_joining import contents
from tests.reconstruct.oracles import lenslet_psf
from tests.simulate.common import small_camera
from tests.work.kills import kill_until_whole

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="finds workers by /proc")

KILLS = 3
"""Of each command by each executor, of the run and of its workers in turn; 60 in all."""


@dataclass(frozen=True)
class Case:
    """A command, its output, and how many units it has."""

    words: str
    out: str
    units: int


CASES = {
    "simulate": Case("simulate plan.json --tolerance 0.1", "out.h5", 3),
    "assemble": Case("assemble scan.json --keep-pedestal --orientation as-is", "out.h5", 3),
    "transpose": Case("transpose H.h5", "out.h5", 6),
    "reduce": Case("reduce H.h5", "out.h5", 6),
    # the method is named: what is quickest here may be another one in the run that these are held against
    "reconstruct": Case("reconstruct H.h5 frames.tif -n 4 --solver rl --method direct", "out", 6),
}
if find_spec("zarr"):
    words = "reconstruct H.h5 frames.tif -n 4 --solver rl --method polyphase:2x2"
    CASES["series"] = Case(words, "out.ome.zarr", 6)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a plan to simulate, one to record by the simulated camera, an H and frames."""
    folder = tmp_path_factory.mktemp("work")
    whole = ScanPlan.for_camera(small_camera(), virtual_depths=[2.5, 3.0, 4.0], cutout=31)
    (folder / "plan.json").write_text(replace(whole, period=(4, 3)).to_json())
    (folder / "scan.json").write_text(replace(whole, period=(3, 2)).to_json())
    H = lenslet_psf(6, 5, 15).astype(np.float32)
    save(PSFMatrix(H, anchor=(1.0, 2.0), depths=np.arange(6.0)), folder / "H.h5")
    frames = np.random.default_rng(0).poisson(50.0, (6, 30, 31)).astype(np.uint16)
    tifffile.imwrite(folder / "frames.tif", frames, photometric="minisblack")
    return folder


def made(out: Path) -> dict[str, Any]:
    """Return all that a command wrote: data and attributes."""
    if not out.is_dir():
        return contents(out)
    if out.suffix == ".zarr":
        found = {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}
        name = out.name.removesuffix(".ome.zarr")  # the image is called as its folder is
        return found | {".zattrs": found[".zattrs"].replace(f'"{name}"'.encode(), b"")}
    return {path.name: tifffile.imread(path).tobytes() for path in sorted(out.iterdir())}


def killed(place: Path, case: Case, executor: str, kills: int) -> None:
    first, out = place / f"whole_{case.out}", place / case.out
    words = case.words.split()
    one = [sys.executable, "-m", "lfcal", *words, "-o", str(first), "--workers", "1"]
    if not first.exists():
        subprocess.run(one, cwd=place, check=True, capture_output=True)
    inputs = {path.name for path in place.iterdir()}
    more = ["-o", str(out), "--executor", executor, "--workers", "2"]
    found = kill_until_whole([*words, *more], out, place, kills)
    assert found.runs + found.workers >= kills
    assert not found.again, "units that were done are kept"
    assert made(out) == made(first)
    assert not parts_folder(out).exists()
    assert {path.name for path in place.iterdir()} == inputs | {out.name}


@pytest.fixture
def own(place: Path, tmp_path: Path) -> Path:
    """Return a copy of the inputs, for one test."""
    return Path(shutil.copytree(place, tmp_path / "own"))


QUICK = "transpose"


@pytest.mark.long
def test_killed(own: Path) -> None:
    killed(own, CASES[QUICK], "processes", 1)


@pytest.mark.long
@pytest.mark.parametrize("executor", ["threads", "processes", "dask"])
@pytest.mark.parametrize("command", list(CASES))
def test_killed_again_and_again(own: Path, command: str, executor: str) -> None:
    if executor == "dask":
        pytest.importorskip("distributed", reason="dask.distributed is not installed")
    killed(own, CASES[command], executor, KILLS)


DYING = """
import os, signal, sys
from contextlib import contextmanager
import lfcal.reconstruct.volumes as volumes
from lfcal.cli import main
real, added = volumes.write_volumes, []
@contextmanager
def dying(path, *rest):
    with real(path, *rest) as add:
        def once(volume):
            add(volume)
            # units' own volumes lie in the folder of the run
            added.extend([1] if ".parts" not in str(path) else [])
            if len(added) == 3:
                os.kill(os.getpid(), signal.SIGKILL)
        yield once
volumes.write_volumes = dying
sys.argv = ["lfcal", *sys.argv[1:]]
main()
"""


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("out", ["out", "out.h5", "out.ome.zarr"])
def test_killed_while_a_series_is_written(own: Path, out: str) -> None:
    """Half of what it makes is there: ``--resume`` writes it again, and nothing is reconstructed twice."""
    if out.endswith(".zarr"):
        pytest.importorskip("zarr", reason="zarr is not installed")
    words = ["reconstruct", "H.h5", "frames.tif", "-n", "2", "--solver", "rl", "--executor", "threads"]
    # the method is named: under load the run that this is held against may take another one
    words += ["--method", "direct", "--workers", "1", "-o"]
    subprocess.run([sys.executable, "-m", "lfcal", *words, f"whole_{out}"], cwd=own, check=True, capture_output=True)
    command = [sys.executable, "-c", DYING, *words, out]
    assert subprocess.run(command, cwd=own, capture_output=True).returncode == -signal.SIGKILL
    assert (own / out).exists() == (out == "out") and parts_folder(own / out).exists()
    before = (parts_folder(own / out) / JOURNAL).stat().st_size
    journal = own / "journal"
    journal.hardlink_to(parts_folder(own / out) / JOURNAL)  # it is removed with its folder
    again = [sys.executable, "-m", "lfcal", *words, out, "--resume"]
    done = subprocess.run(again, cwd=own, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert journal.read_bytes()[before:].count(b'"kept"') == 6 and b'"started"' not in journal.read_bytes()[before:]
    assert made(own / out) == made(own / f"whole_{out}")
    assert not parts_folder(own / out).exists() and not [p for p in own.iterdir() if p.name.startswith(".")]
