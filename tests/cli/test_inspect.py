"""``lfcal inspect``, ``lfcal compare`` and ``lfcal trend``: the quality of H."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.acquire.redo import RedoList
from lfcal.acquire.session import record as record_session
from lfcal.psf import PSFMatrix, save, save_regions
from tests.acquire.rigs import CAREFUL, rig_for, small_plan
from tests.cli.conftest import Lfcal
from tests.fit.common import few_patterns
from tests.judge.common import added, clean, matrix, plan, sensor
from tests.judge.plain_report import undrawn
from tests.judge.test_comparison import SHAPE, moved

# -- inspect --
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
    """Regions of the field are looked for at the end: only an lfcal H file can have them."""
    other = tmp_path / f"other{suffix}"
    lfcal("export", H, "-o", other, "--allow-missing").ok()
    assert "report: " in lfcal("inspect", other, "--report", tmp_path / "out").ok().out
    assert lfcal("inspect", other, "--json").ok().json
    lfcal("verify", other).refused("which has no checksums")
    lfcal("reduce", other, "-o", tmp_path / "small.h5").ok()


def test_numbers_then_report(lfcal: Lfcal, H: Path, tmp_path: Path) -> None:
    run = lfcal("inspect", H, "--report", tmp_path / "out").ok()
    verdict, table, page = (run.out.index(w) for w in ("This H should not", "Missing frames", "report: "))
    assert verdict < table < page and (tmp_path / "out" / "index.html").exists()
    written = run.out + (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "checks: " in run.out and "<h2>Checks</h2>" in written
    assert not re.search(r"\bmetrics?\b", re.sub(r"data:[^\"]*|<style.*?</style>", "", written, flags=re.S), re.I)
    listed = tmp_path / "out" / "redo.json"
    assert f"1 position to record again; listed in {listed}" in " ".join(run.out.split("\n"))
    assert "--report writes" not in run.out and "--report writes the list" in lfcal("inspect", H).out
    assert "-20 mm" in lfcal("inspect", H, "--all").out and MISSING in RedoList.read(listed).positions


def test_json_and_a_reference_by_any_number_of_workers(lfcal: Lfcal, H: Path) -> None:
    assert "correlation 1.00000, error 0.00 %" in lfcal("inspect", H, "--reference", H).out
    words = ("inspect", H, "--reference", H, "--json", "--workers")
    one, many = (lfcal(*words, n).ok().json for n in (1, 3))
    assert [m["value"] for m in one["metrics"]] == pytest.approx([m["value"] for m in many["metrics"]])
    assert one["comparison"]["positions"] == 11
    assert one["merit"] == "bad" and list(MISSING) in one["redo"] and "report" not in one
    assert lfcal(*words, 1, "--strict").code == 1


@pytest.mark.long
def test_control_frames_of_a_session_determine_the_tiling(lfcal: Lfcal, tmp_path: Path) -> None:
    """Recorded by simulated devices whose lattice repeats with the plan's period, but for its few positions."""
    plan = small_plan()
    record_session(tmp_path / "session", plan, rig_for(plan), replace(CAREFUL, controls=1))
    lfcal("assemble", tmp_path / "session", "-o", tmp_path / "H.h5").ok()
    without, found = (
        lfcal("inspect", tmp_path / "H.h5", *more, "--json", "--all").json
        for more in ((), ("--session", tmp_path / "session"))
    )
    tiling = [next(m for m in report["metrics"] if m["key"] == "tiling") for report in (without, found)]
    assert tiling[0]["merit"] == "unknown" and tiling[0]["value"] is None
    assert tiling[1]["merit"] != "unknown" and len(tiling[1]["per_plane"]) == 3 and "fits best" in tiling[1]["detail"]
    lfcal("inspect", tmp_path / "H.h5", "--session", tmp_path).refused()


def test_bad_input_is_one_line(lfcal: Lfcal, H: Path, tmp_path: Path) -> None:
    text, out = tmp_path / "text.h5", tmp_path / "out"
    text.write_text("no HDF5")
    np.save(tmp_path / "R.npy", np.ones((1, 3, 4, 19, 21)))
    for words in (
        (tmp_path / "none.h5",),
        (H, "--reference", tmp_path / "R.npy", "--report", out),
        (H, "--report", text),
        (text,),
    ):
        assert lfcal("inspect", *words).refused().out == "" and not out.exists(), words


def test_without_depths_planes_are_named_by_number(lfcal: Lfcal, tmp_path: Path) -> None:
    t, s = np.indices((15, 15)) - 7.0
    spot = 100 * np.exp(-0.5 * (t**2 + s**2) / 2.5**2)
    np.save(tmp_path / "H.npy", spot + np.random.default_rng(5).random((3, 3, 3, 15, 15)))
    said = lfcal("inspect", tmp_path / "H.npy", "--all").out
    assert "plane 2" in said and "2 µm" not in said
    told = json.loads(lfcal("inspect", tmp_path / "H.npy", "--json").out)
    assert [plane["depth_um"] for plane in told["planes"]] == [None] * 3


# -- ``lfcal inspect`` compared with the model of the camera --
@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.long
def test_a_hot_column_is_named_and_not_a_step_of_the_stage(
    lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    undrawn(monkeypatch)
    image = sensor(0.0)
    image[:, 25] = 60.0
    H = matrix(added(clean(), image))
    one_plane = PSFMatrix(H[:1], depths=H.depths[:1], camera=H.camera, anchor=H.anchor)
    save(one_plane, place / "H.h5")
    run = lfcal("inspect", "H.h5", "--patterns", 24, "--strict")
    assert run.code == 1 and "hot line of the sensor" in run.out and "column 25 of the scanned region" in run.out
    assert "stage step: see hot line of the sensor, its cause" in run.out
    asked = lfcal("inspect", "H.h5", "--patterns", 24, "--json", "--report", "report")
    told = asked.json
    assert told["model"]["faults"][0]["name"] == "hot_line"
    assert told["verdict"].startswith("This H should not be used as it is: hot line") and asked.code == 0
    page = (place / "report" / "index.html").read_text()
    assert "should not be used as it is: hot line" in page and "Compared with the camera" in page and "hot line" in page
    assert "Correct the step of the stage" not in page.split("<h2>Metrics")[0], "no advice on what the fault explains"
    kept = json.loads((place / "report" / "quality.json").read_text())
    assert kept["verdict"] == told["verdict"] and kept["model"]["faults"][0]["name"] == "hot_line"
    without = lfcal("inspect", "H.h5", "--seconds", 0, "--json").json
    assert without["model"]["compared"] == 0 and without["merit"] != "good"


@pytest.mark.long
def test_the_camera_of_a_fit_is_compared_with(lfcal: Lfcal, place: Path) -> None:
    data = few_patterns()
    camera = data.camera
    assert camera is not None
    wrong = replace(camera, lattice=replace(camera.lattice, gap_um=1.03 * camera.lattice.gap_um))
    H = PSFMatrix(data[:], depths=data.depths, camera=wrong, anchor=data.anchor, facts=data.facts)
    save(H, place / "H.h5")
    bare = lfcal("inspect", "H.h5", "--patterns", 24, "--strict")
    assert bare.code == 1 and "the camera disagrees" in bare.out and "lfcal fit" in bare.out
    assert "the gap between lenslets and sensor differs from the description by about -" in bare.out
    lfcal("fit", "H.h5", "--unknowns", "geometry", "--positions", 0, "--no-h", "--workers", 1).ok()
    assert "patterns compared with the camera" in lfcal("inspect", "H.h5", "--fit", "fit", "--patterns", 24).ok().out


def test_strict_ends_with_one_where_the_comparison_could_not_end(lfcal: Lfcal, place: Path) -> None:
    save(matrix(clean()), place / "H.h5")
    cut = lfcal("inspect", "H.h5", "--strict", "--seconds", 1e-9)
    assert cut.code == 1 and "This H is not fully judged" in cut.out


@pytest.mark.long
def test_strict_ends_with_one_where_the_camera_does_not_explain_H(lfcal: Lfcal, place: Path) -> None:
    """One spot without lenslets at every position."""
    known, rng = plan(), np.random.default_rng(0)
    t, s = (np.arange(n) - (n - 1) / 2 for n in known.cutout)
    spot = 3000 * np.exp(-(t[:, None] ** 2 + s**2) / 50)
    values = (spot + rng.normal(0, 5, (1, *known.period, *known.cutout))).astype(np.float32)
    save(PSFMatrix(values, depths=known.depths_um[1:], camera=known.camera, anchor=known.anchor), place / "blob.h5")
    run = lfcal("inspect", "blob.h5", "--strict")
    words = (
        "should not be used as it is: disagreement with its camera. Disagreement with its camera: patterns have little"
    )
    assert run.code == 1 and words in " ".join(run.out.split())


@pytest.mark.long
def test_metrics_that_do_not_apply_are_listed_on_request_alone(lfcal: Lfcal, place: Path) -> None:
    save(matrix(clean()), place / "H.h5")
    run, every = (lfcal("inspect", "H.h5", "--patterns", 24, *more) for more in ((), ("--all",)))
    assert "not applicable; --all lists them" in run.out and "Tiling over the field" not in run.out
    assert "Tiling over the field" in every.out and "--all lists them" not in every.out
    # by default: the verdict, what is not good, and one line for the rest
    assert "depth z" not in run.out and "working f-number" not in run.out
    assert "depth z" in every.out and "working f-number" in every.out


def test_metrics_that_do_not_apply_are_counted_not_listed(lfcal: Lfcal, place: Path) -> None:
    save(matrix(clean()), place / "H.h5")
    told, all_told = (lfcal("inspect", "H.h5", "--seconds", 0, "--json", *more).json for more in ((), ("--all",)))
    left_out = told["counts"]["not_applicable"]
    assert left_out > 0 and len(all_told["metrics"]) - len(told["metrics"]) == left_out
    assert told["findings"][0]["what"] and told["findings"][0]["remedy"]


def test_a_fit_that_does_not_exist_or_is_not_used_is_refused(lfcal: Lfcal, place: Path) -> None:
    save(matrix(clean()), place / "H.h5")
    lfcal("inspect", "H.h5", "--fit", "nowhere").refused("nowhere")
    lfcal("inspect", "H.h5", "--fit", "nowhere", "--seconds", 0).refused("--fit: expected --seconds above 0, got 0")


# -- ``lfcal compare``: two H side by side, in words, as JSON and as a page --
@pytest.fixture
def two_months(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder with an H of May, and one of June: a dimmer lamp, a source that is elsewhere."""
    monkeypatch.chdir(tmp_path)
    depths = [-2000.0, -1000.0]
    june = 0.5 * moved((0.3, -0.2))
    june[1, 2, 3] = np.roll(june[1, 2, 3], 5, 0)
    for name, values in (("may", moved()), ("june", june)):
        (tmp_path / name).mkdir()
        save(PSFMatrix(values.astype(np.float32), depths=depths), tmp_path / name / "H.h5")
    return tmp_path


def test_numbers_by_plane_and_the_worst_position(lfcal: Lfcal, two_months: Path) -> None:
    run = lfcal("compare", "june/H.h5", "may/H.h5", "--workers", 1)
    assert run.code == 0 and "24 positions of 2 planes compared" in run.out, run.err
    assert "+0.300, -0.200" in run.out and "differs most at (1, 2, 3)" in run.out
    told = lfcal("compare", "june/H.h5", "may/H.h5", "--json").json
    assert told["format"] == "lfcal-comparison"
    assert told["planes"][0]["all"]["shift_px"] == pytest.approx([0.3, -0.2], abs=2e-3)
    assert told["planes"][0]["all"]["left"] < 2e-3
    assert told["worst"][0]["position"] == [2, 3] and told["worst"][0]["planes"] == [1, 1]
    assert "They agree to within 1 %" in lfcal("compare", "may/H.h5", "may/H.h5").ok().out


@pytest.mark.long
def test_the_page_shows_them_side_by_side(lfcal: Lfcal, two_months: Path) -> None:
    run = lfcal("compare", "june/H.h5", "may/H.h5", "--report", "out")
    assert run.code == 0 and run.out.rstrip().endswith("out/index.html"), run.err
    page = (two_months / "out" / "index.html").read_text(encoding="utf-8")
    assert "june/H.h5 and may/H.h5" in page and page.count("<img") == 2 and "http" not in page.replace("http-equiv", "")
    kept = json.loads((two_months / "out" / "compare.json").read_text())
    assert kept["compared"] == list(SHAPE)
    for name in ("patterns.png", "positions.png"):
        assert (two_months / "out" / name).stat().st_size > 3000
    lfcal("compare", "june/H.h5", "may/H.h5", "--report", "out").refused("--force")


def test_regions_of_files_of_several_are_compared(lfcal: Lfcal, two_months: Path) -> None:
    values = {"centre": moved(), "edge": moved((0.3, -0.2))}
    parts = {n: PSFMatrix(v.astype(np.float32), depths=[-2e3, -1e3], region=n) for n, v in values.items()}
    save_regions(parts, two_months / "all.h5")
    same = lfcal("compare", "all.h5", "all.h5", "--region", "edge").ok()
    assert "They agree to within 1 %" in same.out
    other = lfcal("compare", "all.h5", "all.h5", "--region", "edge", "--region", "centre", "--json").json
    assert other["planes"][0]["all"]["shift_px"] == pytest.approx([0.3, -0.2], abs=2e-3)
    lfcal("compare", "all.h5", "may/H.h5", "--region", "rim").refused("centre or edge")
    single = lfcal("compare", "may/H.h5", "may/H.h5", "--region", "edge")
    single.refused("one region of the field, which has no name; leave the region out")
    lfcal("compare", "all.h5", "all.h5", *("--region", "edge") * 3).refused("--region")


def test_what_is_not_compared_is_named(lfcal: Lfcal, two_months: Path) -> None:
    save(PSFMatrix(moved()[:1, ..., 2:-2, 2:-2], depths=[-1000.0]), two_months / "small.h5")
    run = lfcal("compare", "may/H.h5", "small.h5").ok()
    assert "note: plane only in the first H: -2 mm" in run.out and "21 × 23 pixels around the source" in run.out
    save(PSFMatrix(moved(), depths=[-9000.0, -5000.0]), two_months / "far.h5")
    lfcal("compare", "may/H.h5", "far.h5").refused("--by-number")
    lfcal("compare", "may/H.h5", "far.h5", "--by-number").ok()
    save(PSFMatrix(np.ones((1, 2, 2, 5, 5))), two_months / "other.h5")
    lfcal("compare", "may/H.h5", "other.h5").refused("period")


def test_a_page_of_nothing_compared_says_so(lfcal: Lfcal, two_months: Path) -> None:
    save(PSFMatrix(np.zeros(SHAPE), depths=[-2000.0, -1000.0]), two_months / "dark.h5")
    run = lfcal("compare", "may/H.h5", "dark.h5", "--report", "out")
    assert run.code == 0 and "Nothing could be compared" in run.out and "nan" not in run.out, run.err
    page = (two_months / "out" / "index.html").read_text(encoding="utf-8")
    assert "0 of 24 positions" in page and ">nan" not in page
