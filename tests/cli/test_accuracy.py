"""``lfcal accuracy``: curves of a plan, a camera and H; what an error costs; what is kept when it is stopped."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.accuracy import PARTS, AccuracyPart, AccuracyStep, CostPoint, Truth
from lfcal.psf import PSFMatrix, save
from tests.acquire.rigs import small_plan
from tests.cli.conftest import Lfcal


@pytest.fixture
def h(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    return save(PSFMatrix(rng.random((1, 3, 3, 9, 9)).astype(np.float32)), tmp_path / "H.h5")


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    path = tmp_path / "scan.json"
    path.write_text(small_plan((2, 2), 1).to_json())
    return path


@pytest.mark.long
def test_a_curve_of_h_as_json_and_drawn(lfcal: Lfcal, h: Path, tmp_path: Path) -> None:
    chart = tmp_path / "a.png"
    words = ("accuracy", h, "--part", "storage", "--draw", chart)
    found = lfcal(*words, "--error", "0.5%", "--seconds", 600, "--json", "--workers", 1).ok().json
    assert found["subject"] == "H.h5" and found["error"] == 0.005 and chart.stat().st_size > 5000
    (curve,) = found["curves"]
    assert curve["part"] == "storage" and len(curve["points"]) == 10
    picked = found["answers"]["storage"]["point"]
    good = [r["cost"] for r in curve["points"] if r["error"] <= 0.005]
    assert picked["cost"] == min(good) and picked["error"] <= 0.005
    lfcal(*words).refused("a.png: exists; add --force")


@pytest.mark.long
def test_a_plan_as_a_table(lfcal: Lfcal, scan: Path) -> None:
    run = lfcal("accuracy", scan, "--part", "bases", "--part", "averaging", "--seconds", 600, "--error", "20 %").ok()
    assert run.out.index("Multiplexing: masks and exposure") < run.out.index("Recording: averaging and exposure")
    assert "An error of 20 % costs" in run.out and "measured by: uniform light, equal in all samples" in run.out


def test_points_are_marked_in_the_table_and_in_json(lfcal: Lfcal, scan: Path) -> None:
    words = ("accuracy", scan, "--part", "recording", "--seconds", 600, "--error", "5 %")
    found: Any = lfcal(*words, "--json").json
    (curve,) = found["curves"]
    used = [point["label"] for point in curve["points"] if point["in_use"]]
    chosen = found["answers"]["recording"]["point"]["label"]
    run = lfcal(*words)
    rows = run.out.splitlines()
    lines = {label: next(row for row in rows if label in row) for label in (p["label"] for p in curve["points"])}
    assert used == ["whole scan, 1 frame each"] and "in use" in lines[used[0]] and "chosen" in lines[chosen]
    for point in curve["points"]:
        assert ("efficient" in lines[point["label"]]) == point["efficient"]
        assert ("chosen" in lines[point["label"]]) == (point["label"] == chosen)


def test_a_part_that_takes_too_long_is_named(lfcal: Lfcal, scan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def slow() -> Iterator[object]:
        yield AccuracyStep("reference", 61.0)
        raise AssertionError("it was begun")

    part = AccuracyPart("made up", "Made up", "error", "cost", "seconds", lambda s, t: slow())  # type: ignore[arg-type, return-value]
    monkeypatch.setattr(type(PARTS), "get", lambda self, name: part)
    run = lfcal("accuracy", scan, "--part", "a", "--seconds", 30)
    assert run.code == 2 and "not begun: reference takes about 1 min 01 s; --seconds measures longer" in run.out


def test_a_camera_needs_planes_and_the_parts_are_listed(lfcal: Lfcal) -> None:
    said = "expected depths in µm (--depths) or virtual depths (--virtual-depths), got neither"
    lfcal("accuracy", "bench", "--part", "bases").refused(said)
    listed = lfcal("accuracy", "list").ok().out
    assert all(part.title.split(":")[0] in listed for part in PARTS)
    assert [entry["name"] for entry in lfcal("accuracy", "list", "--json").json] == list(PARTS.names())


@pytest.mark.long
def test_a_camera_with_planes(lfcal: Lfcal) -> None:
    lfcal("accuracy", "bench", "--depths", "-20mm", "--cutout", "31", "--part", "bases", "--json").ok()


def test_bad_options_are_one_line(lfcal: Lfcal, h: Path) -> None:
    planned = "because H states its planes and cutout; leave them out"
    for words, said in (
        ("--error much", "--error: expected a number, or percent"),
        ("--error 0", "--error: expected a number > 0"),
        ("--error 1.2.3%", "--error: expected a number, or percent"),
        ("--seconds 0", "time for each measurement (s): expected a number > 0"),
        ("--seconds nan", "time for each measurement (s): expected a number > 0"),
        ("--part moon", "part of the processing: expected simulation, sampling, "),
        ("--part lattice", "scan of the measurement: expected a scan plan with its camera, got H of an unknown"),
        ("--depths 1,2", planned),
        ("--virtual-depths 3", planned),
        ("--cutout 31", planned),
    ):
        lfcal("accuracy", h, *words.split()).refused(said)


def _stopped() -> Iterator[object]:
    yield Truth("exact")
    yield CostPoint("a point that was measured", {"k": 1}, 0.5, 1.0, "seconds")
    os.kill(os.getpid(), signal.SIGINT)
    yield AccuracyStep("the next")
    raise AssertionError("it went on")


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Let Ctrl-C be felt: a shell starts background programs with it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_keeps_what_was_measured(lfcal: Lfcal, h: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part = AccuracyPart("made up", "Made up", "error", "cost", "seconds", lambda s, t: _stopped())  # type: ignore[arg-type, return-value]
    monkeypatch.setattr(type(PARTS), "get", lambda self, name: part)
    chart = tmp_path / "a.png"
    words = ("accuracy", h, "--part", "a", "--part", "b", "--draw", chart, "--force")
    table, told = lfcal(*words), lfcal(*words, "--json")
    for run in (table, told):
        assert run.code == 130 and run.err == "lfcal: stopped; no incomplete output remains\n"
    assert chart.stat().st_size > 5000
    assert table.out.count("a point that was measured") == 2, "in the table and as the best"
    assert [r["label"] for r in told.json["curves"][0]["points"]] == ["a point that was measured"]
