"""``lfcal inspect`` beside the camera's model: faults by name, the camera of a fit, and what is not compared."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.psf import PSFMatrix, save
from tests.cli.conftest import Run
from tests.fit.common import few_patterns
from tests.judge.common import added, clean, matrix, plan, sensor
from tests.judge.plain_report import undrawn

Lfcal = Callable[..., Run]


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
    assert isinstance(told, dict) and told["model"]["faults"][0]["name"] == "hot_line"
    assert told["verdict"].startswith("This H should not be used as it is: hot line")
    assert asked.code == 0
    page = (place / "report" / "index.html").read_text()
    assert "should not be used as it is: hot line" in page and "Compared with the camera" in page and "hot line" in page
    assert "Correct the step of the stage" not in page.split("<h2>Metrics")[0], "no advice on what the fault explains"
    kept = json.loads((place / "report" / "quality.json").read_text())
    assert kept["verdict"] == told["verdict"] and kept["model"]["faults"][0]["name"] == "hot_line"
    without = lfcal("inspect", "H.h5", "--seconds", 0, "--json").json
    assert isinstance(without, dict) and without["model"]["compared"] == 0 and without["merit"] != "good"


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
    assert lfcal("fit", "H.h5", "--unknowns", "geometry", "--positions", 0, "--no-h", "--workers", 1).code == 0
    run = lfcal("inspect", "H.h5", "--fit", "fit", "--patterns", 24)
    assert run.code == 0 and "patterns compared with the camera" in run.out, run.out


def test_strict_ends_with_one_where_the_camera_does_not_explain_H(lfcal: Lfcal, place: Path) -> None:
    """One spot without lenslets at every position, and a comparison that could not end."""
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
    save(matrix(clean()), place / "H.h5")
    cut = lfcal("inspect", "H.h5", "--strict", "--seconds", 1e-9)
    assert cut.code == 1 and "This H is not fully judged" in cut.out


def test_metrics_that_do_not_apply_are_counted_not_listed(lfcal: Lfcal, place: Path) -> None:
    save(matrix(clean()), place / "H.h5")
    run, every = (lfcal("inspect", "H.h5", "--patterns", 24, *more) for more in ((), ("--all",)))
    assert "not applicable; --all lists them" in run.out and "Tiling over the field" not in run.out
    assert "Tiling over the field" in every.out and "--all lists them" not in every.out
    # by default: the verdict, what is not good, and one line for the rest
    assert "depth z" not in run.out and "working f-number" not in run.out
    assert "depth z" in every.out and "working f-number" in every.out
    told, all_told = (lfcal("inspect", "H.h5", "--seconds", 0, "--json", *more).json for more in ((), ("--all",)))
    assert isinstance(told, dict) and isinstance(all_told, dict)
    left_out = told["counts"]["not_applicable"]
    assert left_out > 0 and len(all_told["metrics"]) - len(told["metrics"]) == left_out
    assert told["findings"][0]["what"] and told["findings"][0]["remedy"]


def test_a_fit_that_is_none_or_not_used_is_refused(lfcal: Lfcal, place: Path) -> None:
    save(matrix(clean()), place / "H.h5")
    for words, what in (
        (("--fit", "nowhere"), "nowhere"),
        (("--fit", "nowhere", "--seconds", 0), "--fit: expected --seconds above 0, got 0"),
    ):
        run = lfcal("inspect", "H.h5", *words)
        assert run.code == 2 and what in run.err and len(run.err.splitlines()) == 1
