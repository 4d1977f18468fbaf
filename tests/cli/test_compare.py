"""``lfcal compare``: two H side by side, in words, as JSON and as a page."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lfcal.psf import PSFMatrix, save, save_regions
from tests.cli.conftest import Run
from tests.judge.test_comparison import SHAPE, moved

Lfcal = Callable[..., Run]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder with an H of May, and one of June: a dimmer lamp, a source that is elsewhere."""
    monkeypatch.chdir(tmp_path)
    depths = [-2000.0, -1000.0]
    june = 0.5 * moved((0.3, -0.2))
    june[1, 2, 3] = np.roll(june[1, 2, 3], 5, 0)
    for name, values in (("may", moved()), ("june", june)):
        (tmp_path / name).mkdir()
        save(PSFMatrix(values.astype(np.float32), depths=depths), tmp_path / name / "H.h5")
    return tmp_path


def test_numbers_by_plane_and_the_worst_position(lfcal: Lfcal, place: Path) -> None:
    run = lfcal("compare", "june/H.h5", "may/H.h5", "--workers", 1)
    assert run.code == 0 and "24 positions of 2 planes compared" in run.out, run.err
    assert "+0.300, -0.200" in run.out and "differs most at (1, 2, 3)" in run.out
    told = lfcal("compare", "june/H.h5", "may/H.h5", "--json").json
    assert isinstance(told, dict) and told["format"] == "lfcal-comparison"
    assert told["planes"][0]["all"]["shift_px"] == pytest.approx([0.3, -0.2], abs=2e-3)
    assert told["planes"][0]["all"]["left"] < 2e-3
    assert told["worst"][0]["position"] == [2, 3] and told["worst"][0]["planes"] == [1, 1]
    same = lfcal("compare", "may/H.h5", "may/H.h5")
    assert same.code == 0 and "They agree to within 1 %" in same.out


def test_the_page_shows_them_side_by_side(lfcal: Lfcal, place: Path) -> None:
    run = lfcal("compare", "june/H.h5", "may/H.h5", "--report", "out")
    assert run.code == 0 and run.out.rstrip().endswith("out/index.html"), run.err
    page = (place / "out" / "index.html").read_text(encoding="utf-8")
    assert "june/H.h5 and may/H.h5" in page and page.count("<img") == 2 and "http" not in page.replace("http-equiv", "")
    kept = json.loads((place / "out" / "compare.json").read_text())
    assert kept["compared"] == list(SHAPE)
    for name in ("patterns.png", "positions.png"):
        assert (place / "out" / name).stat().st_size > 3000
    again = lfcal("compare", "june/H.h5", "may/H.h5", "--report", "out")
    assert again.code == 2 and "--force" in again.err


def test_regions_of_files_of_several_are_compared(lfcal: Lfcal, place: Path) -> None:
    depths = [-2000.0, -1000.0]
    values = {"centre": moved(), "edge": moved((0.3, -0.2))}
    parts = {name: PSFMatrix(v.astype(np.float32), depths=depths, region=name) for name, v in values.items()}
    save_regions(parts, place / "all.h5")
    same = lfcal("compare", "all.h5", "all.h5", "--region", "edge")
    assert same.code == 0 and "They agree to within 1 %" in same.out, same.err
    other = lfcal("compare", "all.h5", "all.h5", "--region", "edge", "--region", "centre", "--json").json
    assert isinstance(other, dict) and other["planes"][0]["all"]["shift_px"] == pytest.approx([0.3, -0.2], abs=2e-3)
    none = lfcal("compare", "all.h5", "may/H.h5", "--region", "rim")
    assert none.code == 2 and "centre or edge" in none.err
    single = lfcal("compare", "may/H.h5", "may/H.h5", "--region", "edge")
    assert single.code == 2 and "one region of the field, which has no name; leave the region out" in single.err
    many = lfcal("compare", "all.h5", "all.h5", *("--region", "edge") * 3)
    assert many.code == 2 and "--region" in many.err


def test_what_is_left_out_is_said(lfcal: Lfcal, place: Path) -> None:
    save(PSFMatrix(moved()[:1, ..., 2:-2, 2:-2], depths=[-1000.0]), place / "small.h5")
    run = lfcal("compare", "may/H.h5", "small.h5")
    assert run.code == 0
    assert "note: plane only in the first H: -2 mm" in run.out and "21 × 23 pixels around the source" in run.out
    save(PSFMatrix(moved(), depths=[-9000.0, -5000.0]), place / "far.h5")
    refused = lfcal("compare", "may/H.h5", "far.h5")
    assert refused.code == 2 and refused.err.count("\n") == 1 and "--by-number" in refused.err
    assert lfcal("compare", "may/H.h5", "far.h5", "--by-number").code == 0


def test_a_page_of_nothing_compared_says_so(lfcal: Lfcal, place: Path) -> None:
    save(PSFMatrix(np.zeros(SHAPE), depths=[-2000.0, -1000.0]), place / "dark.h5")
    run = lfcal("compare", "may/H.h5", "dark.h5", "--report", "out")
    assert run.code == 0 and "Nothing could be compared" in run.out and "nan" not in run.out, run.err
    page = (place / "out" / "index.html").read_text(encoding="utf-8")
    assert "0 of 24 positions" in page and ">nan" not in page


def test_other_periods_are_one_line(lfcal: Lfcal, place: Path) -> None:
    save(PSFMatrix(np.ones((1, 2, 2, 5, 5))), place / "other.h5")
    run = lfcal("compare", "may/H.h5", "other.h5")
    assert run.code == 2 and run.err.count("\n") == 1 and "period" in run.err
