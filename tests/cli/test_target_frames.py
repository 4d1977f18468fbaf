"""Frames of a target through the commands: assembled where they show positions, inspected, refused by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from lfcal.base import InputError
from lfcal.targets import TargetPlan
from tests.campaign.points import frames_of_drawn, plan_of
from tests.cli.conftest import Run

Lfcal = Callable[..., Run]
GONE = tuple((2, c) for c in range(5))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a target's plan and its frames, on which one row of holes is missing."""
    folder = tmp_path_factory.mktemp("target")
    plan = plan_of([(0.0, 0.0), (3.0, -2.0)])
    (folder / "plan.json").write_text(plan.to_json())
    (folder / "frames").mkdir()
    for k, frame in enumerate(frames_of_drawn(plan, without=GONE)):
        assert cv2.imwrite(str(folder / "frames" / f"frame{k}.png"), frame)
    return folder


def test_frames_of_a_target_are_assembled_and_inspected(lfcal: Lfcal, recorded: Path, tmp_path: Path) -> None:
    out = tmp_path / "H.h5"
    run = lfcal("assemble", recorded / "frames", "-o", out)
    assert run.code == 0, run.err
    assert "points in 2 frames" in run.out and "row 2 is missing" in run.out
    assert "positions without a frame" in run.out
    told = json.loads(lfcal("inspect", out, "--seconds", "0", "--json").out)
    found = {one["key"]: one for one in told["metrics"]}
    assert found["target_pose"]["merit"] == "good" and found["target_crosstalk"]["value"] == pytest.approx(0.4, rel=0.5)
    assert found["target_stage"]["value"] < 0.1 and found["target_labels"]["merit"] == "good"
    again = json.loads(lfcal("assemble", recorded / "frames", "-o", out, "--force", "--json").out)
    assert again["target"]["missing"] == 5 and again["frames"] <= again["target"]["points"]
    assert again["target"]["mistakes"][0]["kind"] == "missing row"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("assemble", "--channel", "R"), "--channel"),
        (("assemble", "--half-cell"), "--half-cell"),
        (("assemble", "--first", "1"), "--first"),
        (("assemble", "--columns", "x=a,y=b"), "--columns"),
        (("fit", "--hybrid"), "--hybrid"),
        (("fit", "--executor", "threads"), "--executor"),
        (("fit", "--noise", "1,1"), "--noise"),
    ],
)
def test_options_of_a_scan_are_refused(
    lfcal: Lfcal, recorded: Path, tmp_path: Path, words: tuple[str, ...], named: str
) -> None:
    command, *options = words
    run = lfcal(command, recorded / "frames", *options, "-o", tmp_path / "out")
    assert run.code == 2 and named in run.err and "target" in run.err
    assert not (tmp_path / "out").exists()


def test_frames_of_a_target_that_are_not_there(lfcal: Lfcal, tmp_path: Path) -> None:
    plan = tmp_path / "plan.json"
    plan.write_text(plan_of([(0.0, 0.0)]).to_json())
    for command in ("assemble", "fit"):
        run = lfcal(command, tmp_path / "none", "--plan", plan, "-o", tmp_path / "out")
        assert run.code == 2 and "none: no such file or folder" in run.err, run.err


def test_frames_that_do_not_belong_to_the_plan_are_refused(lfcal: Lfcal, recorded: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    other.write_text(plan_of([(0.0, 0.0), (3.0, -2.0), (1.0, 1.0)]).to_json())
    for command in ("assemble", "fit"):
        run = lfcal(command, recorded / "frames", "--plan", other, "-o", tmp_path / "out")
        assert run.code == 2 and "plan of the target needs 3" in run.err and "Traceback" not in run.err


def test_a_fit_begins_with_the_camera_that_is_named(
    lfcal: Lfcal, recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = plan_of([(0.0, 0.0)]).scan.camera
    other = replace(camera, lattice=replace(camera.lattice, gap_um=camera.lattice.gap_um + 1))
    (tmp_path / "other.json").write_text(other.to_json())
    begun: list[TargetPlan] = []

    def begin(_: object, plan: TargetPlan) -> object:
        begun.append(plan)
        raise InputError("begun")

    monkeypatch.setattr("lfcal.campaign.iter_points_of", begin)
    for options in ((), ("--camera", tmp_path / "other.json")):
        run = lfcal("fit", recorded / "frames", *options, "-o", tmp_path / "out")
        assert run.code == 2 and "begun" in run.err, run.err
    assert [plan.scan.camera for plan in begun] == [camera, other]
