"""Half-cell scans from plan to H."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lfcal.acquire.redo import RedoList
from lfcal.psf import open_psf
from lfcal.psf.half_cell import copied_positions
from tests.camera.test_plan import camera_of
from tests.cli.conftest import Run

Lfcal = Callable[..., Run]
PLAN = ("plan", "camera.json", "--virtual-depths", "3", "--cutout", "31", "--half-cell")
QUIET = ("--no-check-stage", "--darks", "0", "--reference-every", "0", "--option", "optics=geometric")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "camera.json").write_text(camera_of((6.0, 12.0), 1).to_json())
    (tmp_path / "odd.json").write_text(camera_of((7.0, 12.0), 1).to_json())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_half_a_scan_makes_a_whole_h(lfcal: Lfcal, place: Path) -> None:
    run = lfcal(*PLAN, "-o", "plan.json", "--list", "half.json")
    assert (
        run.code == 0
        and "rows 0 to 2; the other positions have the same patterns, 3, 6 px away" in run.out
        and "half.json" in run.out
    )
    assert len(RedoList.read(place / "half.json").positions) == 36
    said = lfcal(*PLAN, "--json").json
    assert isinstance(said, dict) and len(said["half_cell"]) == 36 and said["forecast"]["frames"] == 36
    assert lfcal("acquire", "plan.json", "--positions", "half.json", "-o", "half", *QUIET).code == 0
    assert lfcal("acquire", "plan.json", "-o", "whole", *QUIET).code == 0
    run = lfcal("assemble", "half", "--half-cell", "--black-level", "0", "-o", "half.h5")
    assert run.code == 0 and "from 36 frames" in run.out, run.err
    assert "36 positions have the patterns recorded half a period away" in run.err
    assert lfcal("assemble", "whole", "--black-level", "0", "-o", "whole.h5").code == 0
    with open_psf(place / "half.h5") as half, open_psf(place / "whole.h5") as whole:
        copied = copied_positions(half)
        assert copied.sum() == 36 and (half.recorded > 0).all()
        # as far off as two recordings are from each other: by their noise
        mine, other = half.plane(0), whole.plane(0)
        off = np.sqrt(np.square(mine - other).sum((2, 3)) / np.square(other).sum((2, 3)))
        unlike = np.linalg.norm(other[0, 0] - other[0, 6]) / np.linalg.norm(other[0, 0])
        assert 0.02 < np.median(off[copied[0]]) < 0.04 and unlike > 1
    again = lfcal("assemble", "whole", "--half-cell", "--black-level", "0", "-o", "more.h5")
    assert again.code == 2 and "frames at all positions" in again.err


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (
            "plan odd.json --virtual-depths 3 --cutout 31 --half-cell --list a.json",
            "half of which is not a whole number of pixels",
        ),
        ("plan bench --virtual-depths 3 --half-cell -o a.json", "got 19 x 33"),
        ("plan camera.json --virtual-depths 3 --cutout 31 --list a.json", "--list: expected --half-cell"),
        (
            "plan camera.json --virtual-depths 3 --half-cell --positions a.csv",
            "got a recorded scan (--positions); leave --half-cell out",
        ),
        (
            "plan camera.json --virtual-depths 3 --cutout 31 --half-cell --list a.json --speed -1",
            "--speed: expected a number > 0",
        ),
    ],
)
def test_what_is_refused(lfcal: Lfcal, place: Path, words: str, what: str) -> None:
    run = lfcal(*words.split())
    assert run.code == 2 and run.err.count("\n") == 1 and what in run.err, run.err
    assert not list(place.glob("a.*"))
