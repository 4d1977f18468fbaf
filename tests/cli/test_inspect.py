from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.acquire.redo import RedoList
from lfcal.acquire.session import record
from lfcal.psf import PSFMatrix, open_psf, save
from tests.acquire.rigs import CAREFUL, rig_for, small_plan
from tests.cli.conftest import Run

Lfcal = Callable[..., Run]
MISSING = (0, 1, 2)


@pytest.fixture
def H(tmp_path: Path) -> Path:
    """Write an H with one position missing."""
    rows, columns = np.mgrid[:21, :21]
    values = np.empty((1, 3, 4, 21, 21), np.float32)
    for place in np.ndindex(values.shape[:3]):
        values[place] = 500 * np.exp(-((rows - 10) ** 2 + (columns - 10 - 0.1 * place[2]) ** 2) / 9)
    values += np.random.default_rng(0).normal(0, 1, values.shape).astype(np.float32)
    values[MISSING] = 0
    recorded = np.ones(values.shape[:3], int)
    recorded[MISSING] = 0
    save(PSFMatrix(values, depths=[-20e3], recorded=recorded), tmp_path / "H.h5")
    return tmp_path / "H.h5"


@pytest.mark.long
@pytest.mark.parametrize("suffix", [".npy", ".mat"])
def test_files_of_other_codes_are_whole(lfcal: Lfcal, H: Path, tmp_path: Path, suffix: str) -> None:
    """Regions of the field are looked for at the end: only an H file of lfcal can have them."""
    other = tmp_path / f"other{suffix}"
    if suffix == ".npy":
        with open_psf(H) as matrix:
            np.save(other, np.asarray(matrix))
    else:
        assert lfcal("export", H, "-o", other, "--allow-missing").code == 0
    run = lfcal("inspect", other, "--report", tmp_path / "out")
    assert run.code == 0 and "report: " in run.out, run.err
    run = lfcal("inspect", other, "--json")
    assert run.code == 0 and json.loads(run.out), run.err
    run = lfcal("verify", other)
    assert run.code == 2 and run.err.count("\n") == 1 and "which has no checksums" in run.err
    assert lfcal("reduce", other, "-o", tmp_path / "small.h5").code == 0


def test_numbers_then_report(lfcal: Lfcal, H: Path, tmp_path: Path) -> None:
    run = lfcal("inspect", H, "--report", tmp_path / "out")
    assert run.code == 0, run.err
    verdict, table, page = (run.out.index(w) for w in ("This H should not", "Missing frames", "report: "))
    assert verdict < table < page
    written = run.out + (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "checks: " in run.out and "<h2>Checks</h2>" in written
    assert not re.search(r"\bmetrics?\b", re.sub(r"data:[^\"]*|<style.*?</style>", "", written, flags=re.S), re.I)
    listed = tmp_path / "out" / "redo.json"
    assert f"1 position to record again; listed in {listed}" in " ".join(run.out.split("\n"))
    assert "--report writes" not in run.out and "--report writes the list" in lfcal("inspect", H).out
    assert "-20 mm" in lfcal("inspect", H, "--all").out
    assert (tmp_path / "out" / "index.html").exists()
    assert MISSING in RedoList.read(listed).positions


def test_reference(lfcal: Lfcal, H: Path) -> None:
    assert "correlation 1.00000, error 0.00 %" in lfcal("inspect", H, "--reference", H).out
    found = lfcal("inspect", H, "--reference", H, "--json").json
    assert isinstance(found, dict) and found["comparison"]["positions"] == 11


def test_json(lfcal: Lfcal, H: Path) -> None:
    run = lfcal("inspect", H, "--json")
    assert run.code == 0, run.err
    found = run.json
    assert isinstance(found, dict)
    assert found["merit"] == "bad" and list(MISSING) in found["redo"] and "report" not in found


def test_workers_do_not_change_the_numbers(lfcal: Lfcal, H: Path) -> None:
    one, many = (lfcal("inspect", H, "--json", "--workers", n).json for n in (1, 3))
    assert isinstance(one, dict) and isinstance(many, dict)
    assert [m["value"] for m in one["metrics"]] == pytest.approx([m["value"] for m in many["metrics"]])


@pytest.mark.long
def test_control_frames_of_a_session_tell_the_tiling(lfcal: Lfcal, tmp_path: Path) -> None:
    """Recorded by simulated devices whose lattice repeats with the plan's period, but for its few positions."""
    plan = small_plan()
    record(tmp_path / "session", plan, rig_for(plan), replace(CAREFUL, controls=1))
    assert lfcal("assemble", tmp_path / "session", "-o", tmp_path / "H.h5").code == 0
    without, found = (
        lfcal("inspect", tmp_path / "H.h5", *more, "--json", "--all").json
        for more in ((), ("--session", tmp_path / "session"))
    )
    assert isinstance(without, dict) and isinstance(found, dict)
    tiling = [next(m for m in report["metrics"] if m["key"] == "tiling") for report in (without, found)]
    assert tiling[0]["merit"] == "unknown" and tiling[0]["value"] is None
    assert tiling[1]["merit"] != "unknown" and len(tiling[1]["per_plane"]) == 3
    assert "fits best" in tiling[1]["detail"]
    run = lfcal("inspect", tmp_path / "H.h5", "--session", tmp_path)
    assert run.code == 2 and len(run.err.strip().splitlines()) == 1


def test_strict_ends_with_one(lfcal: Lfcal, H: Path) -> None:
    assert lfcal("inspect", H, "--strict", "--json").code == 1


@pytest.mark.parametrize("case", ["absent", "other shape", "not a folder", "text"])
def test_bad_input_is_one_line(lfcal: Lfcal, H: Path, tmp_path: Path, case: str) -> None:
    (tmp_path / "text.h5").write_text("no HDF5")
    np.save(tmp_path / "R.npy", np.ones((1, 3, 4, 19, 21)))
    options = {
        "absent": (tmp_path / "none.h5",),
        "other shape": (H, "--reference", tmp_path / "R.npy", "--report", tmp_path / "out"),
        "not a folder": (H, "--report", tmp_path / "text.h5"),
        "text": (tmp_path / "text.h5",),
    }[case]
    run = lfcal("inspect", *options)
    assert run.code == 2 and run.out == "" and len(run.err.strip().splitlines()) == 1, run.err
    assert not (tmp_path / "out").exists()


def test_without_depths_planes_are_named_by_number(lfcal: Lfcal, tmp_path: Path) -> None:
    t, s = np.indices((15, 15)) - 7.0
    spot = 100 * np.exp(-0.5 * (t**2 + s**2) / 2.5**2)
    np.save(tmp_path / "H.npy", spot + np.random.default_rng(5).random((3, 3, 3, 15, 15)))
    said = lfcal("inspect", tmp_path / "H.npy", "--all").out
    assert "plane 2" in said and "2 µm" not in said
    told = json.loads(lfcal("inspect", tmp_path / "H.npy", "--json").out)
    assert [plane["depth_um"] for plane in told["planes"]] == [None] * 3
