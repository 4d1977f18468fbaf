"""A small recorded session on disk, and a way to run commands as a user does."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lfcal.camera import ScanPlan, preset
from lfcal.judge._cost import FEWEST
from tests.fit.shared import shared_models
from tests.psf.shared_apertures import shared_apertures
from tests.strict import strict_json

SHAPE = (2, 3, 4)
SENSOR = (40, 48)
ANCHOR = (16, 20)
CUTOUT = (9, 11)
NOTE = re.compile("^reads: |note: |warning: |kept: |assumed values|set-up| ahead")
"""In lines of standard error that do not say why a command ended."""


@dataclass
class Run:
    """What a command did."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """What was printed: one document of strict JSON, and nothing else."""
        return strict_json(self.out)

    def ok(self) -> Run:
        """Check that the command succeeded; return this record."""
        assert self.code == 0, self.err
        return self

    def refused(self, *said: str) -> Run:
        """Check that the command ended with code 2 and one line, besides notes, and that it said these words."""
        lines = [line for line in self.err.splitlines() if not NOTE.search(line)]
        assert self.code == 2 and len(lines) == 1 and all(word in self.err for word in said), self.err
        return self


Lfcal = Callable[..., Run]
"""Runs a command: words in, what it did out."""


@pytest.fixture
def lfcal(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Lfcal:
    """Run the command line in this process, exactly as the installed script does."""
    from lfcal.cli import main

    def run(*arguments: object) -> Run:
        monkeypatch.setattr("sys.argv", ["lfcal", *map(str, arguments)])
        capfd.readouterr()
        code = 0
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
        captured = capfd.readouterr()
        return Run(code, captured.out, captured.err)

    return run


@pytest.fixture(scope="package", autouse=True)
def _shared_models() -> Iterator[None]:
    with shared_models(), shared_apertures():
        yield


@pytest.fixture(autouse=True)
def _fewest_patterns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let inspections compare the fewest patterns: as many as there is time for would be others each time."""
    monkeypatch.setattr("lfcal.judge.evidence.MOST_SAMPLES", 0)
    monkeypatch.setattr("lfcal.judge._cost.MOST", FEWEST)


def small_plan() -> ScanPlan:
    camera = preset("bench")
    camera = replace(camera, sensor=replace(camera.sensor, shape=SENSOR, bit_depth=16, black_level=0))
    return ScanPlan(camera, SHAPE[1:], CUTOUT, (-20e3, -10e3), ANCHOR)


def true_frame(z: int, y: int, x: int) -> np.ndarray:
    """Return a spot pattern that moves one pixel a step, bright enough for 16 bit."""
    r, c = np.mgrid[: SENSOR[0], : SENSOR[1]]
    spot = np.exp(-((r - ANCHOR[0] - y) ** 2 + (c - ANCHOR[1] - x) ** 2) / (6.0 + 4 * z))
    return np.rint(20000 * spot).astype(np.uint16)


DARK = 20


@pytest.fixture(scope="session")
def _recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("session")
    for name in ("frames", "dark", "white"):
        (folder / name).mkdir()
    rows = ["file,z,y,x"]
    for z, y, x in np.ndindex(SHAPE):
        name = f"z{z}_y{y}_x{x}.png"
        cv2.imwrite(str(folder / "frames" / name), true_frame(z, y, x) + np.uint16(DARK))
        rows.append(f"{name},{z},{y},{x}")
    (folder / "frames" / "manifest.csv").write_text("\n".join(rows) + "\n")
    for k in range(2):
        cv2.imwrite(str(folder / "dark" / f"{k}.png"), np.full(SENSOR, DARK, np.uint16))
        cv2.imwrite(str(folder / "white" / f"{k}.png"), np.full(SENSOR, DARK + 30000, np.uint16))
    (folder / "plan.json").write_text(small_plan().to_json())
    return folder


@pytest.fixture(scope="session")
def inputs(tmp_path_factory: pytest.TempPathFactory, _recorded: Path) -> Path:
    """Return a folder with what every command that writes reads; to be copied, not changed."""
    from tests.cli.writing import make_inputs

    folder = tmp_path_factory.mktemp("inputs")
    make_inputs(folder)
    shutil.copytree(_recorded, folder / "session")
    return folder


@pytest.fixture
def session(_recorded: Path, tmp_path: Path) -> Path:
    """Copy the session that a test may spoil."""
    copy = tmp_path / "session"
    shutil.copytree(_recorded, copy)
    return copy
