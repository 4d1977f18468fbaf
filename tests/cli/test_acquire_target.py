"""``lfcal acquire`` of a target's plan, as a user runs it."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.camera import ScanPlan
from lfcal.cli import main
from lfcal.frames import open_frames
from lfcal.targets import Pose, Target, TargetPlan, Wishes, plan_target
from tests.targets.common import small

QUICK = ("--darks", 0, "--reference-every", 0)


def run(*arguments: object, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["lfcal", *map(str, arguments)])
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


@pytest.fixture(scope="module")
def plan() -> TargetPlan:
    scan = ScanPlan.for_camera(small(200), virtual_depths=(4.0,), cutout=31)
    step = scan.camera.step_um(scan.depths_um[0])
    target = Target("square", (3, 3), (45 * step, 46 * step), hole_um=10.0)
    return plan_target(scan, target, Wishes(most_frames=8, level="geometric"))


@pytest.fixture
def file(plan: TargetPlan, tmp_path: Path) -> Path:
    path = tmp_path / "target_plan.json"
    path.write_text(plan.to_json())
    return path


def test_a_target_is_recorded_and_what_it_shows_is_told(
    plan: TargetPlan, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "session"
    assert run("acquire", file, "-o", out, *QUICK, "--json", monkeypatch=monkeypatch) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["outcome"]["acknowledged"] == 8 and told["bytes_gained"] > 0 and not told["findings"]
    assert told["shown"]["frames"] == 8 and told["shown"]["coverage"] == pytest.approx(plan.coverage(0))
    assert len(open_frames(out)) == 8  # packed, and open as before
    assert run("verify", out, monkeypatch=monkeypatch) == 0
    assert "This session is intact in 8 of 8 frames." in capsys.readouterr().out
    assert run("status", out, "--json", monkeypatch=monkeypatch) == 0
    status = json.loads(capsys.readouterr().out)
    assert (status["session"], status["done"], status["total"], status["how"]) == ("target", 8, 8, "complete")
    assert status["shown"]["coverage"] == told["shown"]["coverage"]
    assert run("status", out, monkeypatch=monkeypatch) == 0
    assert "8 of 8 frames of a target" in (said := capsys.readouterr().out) and "lfcal fit" in said


def test_a_stopped_session_tells_all_it_shows_when_it_went_on(
    plan: TargetPlan, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "session"
    faults = ("--option", "faults=vanishes@5")
    assert run("acquire", file, "-o", out, *QUICK, *faults, monkeypatch=monkeypatch) != 0
    capsys.readouterr()
    assert run("acquire", file, "-o", out, "--resume", monkeypatch=monkeypatch) == 0
    text = capsys.readouterr().out
    assert "complete, 8 of 8 frames" in text and f"{100 * plan.coverage(0):.3g}" in text


def test_its_cost_is_told_before_anything_moves(
    plan: TargetPlan, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "session"
    assert run("acquire", file, "-o", out, *QUICK, "--dry-run", "--json", monkeypatch=monkeypatch) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["positions"] == 8 and told["seconds"] == pytest.approx(3600 * plan.forecast().hours)
    assert told["recording_bytes"] == 8 * (200 * 200 * 2 + 128) and told["readout_seconds"] is None
    rate = ("--frame-rate", "4")
    assert run("acquire", file, "-o", out, *QUICK, "--dry-run", "--json", *rate, monkeypatch=monkeypatch) == 0
    read = json.loads(capsys.readouterr().out)
    assert read["readout_seconds"] == 2 and read["seconds"] == pytest.approx(told["seconds"] + 2)
    assert not out.exists()


@pytest.mark.parametrize("words", [("--until-error", "1%"), ("--order", "coarse"), ("--controls", 2)])
def test_options_of_single_points_are_refused(
    file: Path,
    tmp_path: Path,
    words: tuple[Any, ...],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("acquire", file, "-o", "session", *QUICK, *words, monkeypatch=monkeypatch) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not (tmp_path / "session").exists()


def test_another_target_may_stand_before_the_simulated_camera(
    plan: TargetPlan, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Turned by 2 degrees, its light lies at the turned places, and not at those of the plan."""
    there = replace(plan.target, pose=Pose(rotation_rad=np.radians(4.0)))
    (tmp_path / "there.json").write_text(there.to_json())
    options = ("--option", f"target={tmp_path / 'there.json'}", "--option", "brightness=0.1")
    out = tmp_path / "session"
    assert run("acquire", file, "-o", out, *QUICK, *options, monkeypatch=monkeypatch) == 0
    capsys.readouterr()
    frame = open_frames(out).read(0).astype(float)
    lit = {}
    for name, target in (("planned", plan.target), ("there", there)):
        pixels = replace(plan, target=target).points(0, 0).pixels
        corner = pixels[np.argmax(np.abs(pixels - 99.5).min(axis=1))]
        row, column = np.rint(corner).astype(int)
        lit[name] = frame[row - 1 : row + 2, column - 1 : column + 2].mean()
    assert lit["there"] > 1.1 * lit["planned"]


def test_options_of_the_simulated_target_are_checked(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scan.json").write_text(TargetPlan.from_json(file.read_text()).scan.to_json())
    scan = ("acquire", tmp_path / "scan.json", "-o", tmp_path / "s", *QUICK)
    assert run(*scan, "--option", "brightness=0.1", monkeypatch=monkeypatch) == 2
    assert "give target=FILE" in capsys.readouterr().err
    assert run(*scan, "--option", f"target={tmp_path / 'scan.json'}", monkeypatch=monkeypatch) == 2
    assert '"format": "lfcal-target"' in capsys.readouterr().err
