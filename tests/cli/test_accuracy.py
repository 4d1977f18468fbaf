"""``lfcal accuracy``: curves of a plan, a camera and H; what an error costs; what is kept when it is stopped."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.accuracy import PARTS, AccuracyPart, AccuracyStep, CostPoint, Truth
from lfcal.psf import PSFMatrix, save
from tests.acquire.rigs import small_plan
from tests.cli.conftest import Run

Lfcal = Callable[..., Run]


@pytest.fixture
def h(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    return save(PSFMatrix(rng.random((1, 3, 3, 9, 9)).astype(np.float32)), tmp_path / "H.h5")


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    path = tmp_path / "scan.json"
    path.write_text(small_plan((2, 2), 1).to_json())
    return path


def test_a_curve_of_h_as_json_and_drawn(lfcal: Lfcal, h: Path, tmp_path: Path) -> None:
    chart = tmp_path / "a.png"
    run = lfcal(
        "accuracy",
        h,
        "--part",
        "storage",
        "--error",
        "0.5%",
        "--seconds",
        600,
        "--draw",
        chart,
        "--json",
        "--workers",
        1,
    )
    assert run.code == 0, run.err
    found: Any = run.json
    assert found["subject"] == "H.h5" and found["error"] == 0.005 and chart.stat().st_size > 5000
    (curve,) = found["curves"]
    assert curve["part"] == "storage" and len(curve["points"]) == 10
    picked = found["answers"]["storage"]["point"]
    good = [r["cost"] for r in curve["points"] if r["error"] <= 0.005]
    assert picked["cost"] == min(good) and picked["error"] <= 0.005
    again = lfcal("accuracy", h, "--part", "storage", "--draw", chart)
    assert again.code == 2 and "a.png: exists; add --force" in again.err


@pytest.mark.long
def test_a_curve_is_drawn_again_where_that_is_asked_for(lfcal: Lfcal, h: Path, tmp_path: Path) -> None:
    chart = tmp_path / "a.png"
    chart.write_text("an earlier one")
    assert lfcal("accuracy", h, "--part", "storage", "--draw", chart, "--force").code == 0


@pytest.mark.long
def test_a_plan_as_a_table(lfcal: Lfcal, scan: Path) -> None:
    run = lfcal("accuracy", scan, "--part", "bases", "--part", "averaging", "--seconds", 600, "--error", "20 %")
    assert run.code == 0, run.err
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


def test_what_does_not_fit_into_the_time_is_said(lfcal: Lfcal, scan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def slow() -> Iterator[object]:
        yield AccuracyStep("reference", 61.0)
        raise AssertionError("it was begun")

    part = AccuracyPart("made up", "Made up", "error", "cost", "seconds", lambda s, t: slow())  # type: ignore[arg-type, return-value]
    monkeypatch.setattr(type(PARTS), "get", lambda self, name: part)
    run = lfcal("accuracy", scan, "--part", "a", "--seconds", 30)
    assert run.code == 2 and "not begun: reference takes about 1 min 01 s; --seconds measures longer" in run.out


def test_a_camera_needs_planes(lfcal: Lfcal) -> None:
    run = lfcal("accuracy", "bench", "--part", "bases")
    assert (
        run.code == 2
        and "expected depths in µm (--depths) or virtual depths (--virtual-depths), got neither" in run.err
    )
    assert lfcal("accuracy", "bench", "--depths", "-20mm", "--cutout", "31", "--part", "bases", "--json").code == 0


@pytest.mark.parametrize("options", [("--depths", "1,2"), ("--virtual-depths", "3"), ("--cutout", "31")])
def test_planes_of_h_are_its_own(lfcal: Lfcal, h: Path, options: tuple[str, str]) -> None:
    run = lfcal("accuracy", h, *options)
    assert run.code == 2 and "because H states its planes and cutout; leave them out" in run.err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--error", "much"), "--error: expected a number, or percent"),
        (("--error", "0"), "--error: expected a number > 0"),
        (("--error", "1.2.3%"), "--error: expected a number, or percent"),
        (("--seconds", "0"), "time for each measurement (s): expected a number > 0"),
        (("--seconds", "nan"), "time for each measurement (s): expected a number > 0"),
        (("--part", "moon"), "part of the processing: expected simulation, sampling, "),
        (
            ("--part", "lattice"),
            "scan of the measurement: expected a scan plan with its camera, got H of an unknown",
        ),
    ],
)
def test_bad_options_are_one_line(lfcal: Lfcal, h: Path, options: tuple[str, str], message: str) -> None:
    run = lfcal("accuracy", h, *options)
    assert run.code == 2 and message in run.err and run.err.count("\n") == 1, run.err


def test_the_parts_are_listed(lfcal: Lfcal) -> None:
    run = lfcal("accuracy", "list")
    assert run.code == 0 and all(part.title.split(":")[0] in run.out for part in PARTS)
    found: Any = lfcal("accuracy", "list", "--json").json
    assert [entry["name"] for entry in found] == list(PARTS.names())


def _stopped() -> Iterator[object]:
    yield Truth("exact")
    yield CostPoint("a point that was measured", {"k": 1}, 0.5, 1.0, "seconds")
    os.kill(os.getpid(), signal.SIGINT)
    yield AccuracyStep("the next")
    raise AssertionError("it went on")


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Let Ctrl-C be felt: a shell starts what it runs beside itself with it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("json", [False, True])
def test_ctrl_c_keeps_what_was_measured(
    lfcal: Lfcal, h: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, json: bool
) -> None:
    part = AccuracyPart("made up", "Made up", "error", "cost", "seconds", lambda s, t: _stopped())  # type: ignore[arg-type, return-value]
    monkeypatch.setattr(type(PARTS), "get", lambda self, name: part)
    chart = tmp_path / "a.png"
    run = lfcal("accuracy", h, "--part", "a", "--part", "b", "--draw", chart, *(["--json"] if json else []))
    assert run.code == 130 and run.err == "lfcal: stopped; no incomplete output remains\n"
    assert chart.stat().st_size > 5000
    if json:
        found: Any = run.json
        assert [r["label"] for r in found["curves"][0]["points"]] == ["a point that was measured"]
    else:
        assert run.out.count("a point that was measured") == 2, "in the table and as the best"
