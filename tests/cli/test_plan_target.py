"""``lfcal plan target``: a target beside the scan of a single point."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from lfcal.base.errors import FileFormatError
from lfcal.camera import ScanPlan
from lfcal.targets import Pose, Target, TargetPlan
from tests.cli.conftest import Run
from tests.targets.common import small

Lfcal = Callable[..., Run]
PLAN = ("plan", "target", "scan.json")
SCAN = ScanPlan.for_camera(small(), virtual_depths=(4.0,), cutout=31)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "camera.json").write_text(small().to_json())
    (tmp_path / "scan.json").write_text(SCAN.to_json())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.long
def test_a_target_is_planned_beside_a_single_point(lfcal: Lfcal, place: Path) -> None:
    run = lfcal(*PLAN, "array:6x6@1021.3um,hole=20um", "--most-frames", "12", "-o", "target.json")
    assert run.code == 0, run.err
    assert "252 phases within 0.1 px by array:6x6@1021.3um,hole=20um" in run.out
    assert "a single point" in run.out and "written: target.json" in run.out
    assert "not all phases are shown" in run.err
    plan = TargetPlan.from_json((place / "target.json").read_text())
    assert plan.target == Target("square", (6, 6), (1021.3, 1021.3), 20.0)
    assert len(plan.offsets_px[0]) == 12 and plan.tolerance_px == 0.1
    assert plan.scan == SCAN


def test_json_holds_what_the_table_says(lfcal: Lfcal, place: Path) -> None:
    (place / "t.json").write_text(Target("square", (6, 6), (1021.3, 1021.3)).to_json())
    options = ("--tolerance", "0.4", "--crosstalk", "0.02", "--pose", "rotation=1,tilt_right=2")
    (place / "scan.json").write_text(replace(SCAN, exposure_s=0.5).to_json())
    said = lfcal(*PLAN, "t.json", *options, "--pose-within", "rotation=0.5", "--json").json
    assert isinstance(said, dict)
    (plane,) = said["planes"]
    assert plane["coverage"] == 1.0 and plane["frames"] == said["frames"] and plane["crosstalk"] <= 0.02
    assert plane["least_frames"] == math.ceil(252 / plane["points_a_frame"][1])
    assert said["tolerance_px"] == 0.4 and said["tails"] == "wave"
    assert len(plane["coverage_within_pose"]) == 8 and max(plane["coverage_within_pose"]) < 1
    assert said["single_point"]["frames"] == 252 and said["single_point"]["hours"] > 252 * 0.55 / 3600
    assert said["hours"] < said["single_point"]["hours"] / 5
    plan = TargetPlan.from_dict(said["plan"])
    assert plan.target.pose == Pose(math.radians(1), math.radians(2))
    assert plan.target.within == Pose(math.radians(0.5)) and plan.coverage(0) == 1.0


@pytest.mark.long
def test_its_frames_are_read_out(lfcal: Lfcal, place: Path) -> None:
    del place
    words = (*PLAN, "array:6x6@1021.3um", "--most-frames", "3")
    assert "total time without readout (--frame-rate)" in lfcal(*words).out
    assert "without readout" not in lfcal(*words, "--frame-rate", "0.5").out
    plain, read = (lfcal(*words, *more, "--json").json for more in ((), ("--frame-rate", "0.5")))
    assert isinstance(plain, dict) and isinstance(read, dict) and plain["readout_hours"] is None
    assert (read["hours"] - plain["hours"]) * 3600 == pytest.approx(3 / 0.5)
    assert (read["single_point"]["hours"] - plain["single_point"]["hours"]) * 3600 == pytest.approx(252 / 0.5)


def test_a_pose_that_is_not_known_is_said(lfcal: Lfcal, place: Path) -> None:
    del place
    run = lfcal(*PLAN, "array:6x6@1.0213mm", "--pose-within", "rotation=1", "--tolerance", "0.5")
    assert run.code == 0 and "record one frame, measure the pose, and plan again with it" in run.err


def test_a_pitch_is_proposed(lfcal: Lfcal, place: Path) -> None:
    run = lfcal(*PLAN, "array,hole=5um", "-o", "plan.json")
    assert run.code == 0 and "hole=5um" in run.out, run.err
    plan = TargetPlan.from_json((place / "plan.json").read_text())
    assert plan.coverage(0) == 1.0 and len(plan.offsets_px[0]) <= 2 * plan.least_frames(0)
    # what it says can be said again: the pitch as ordered
    again = lfcal(*PLAN, run.out.split(" px by ")[1].split()[0])
    assert again.code == 0 and "100 %" in again.out


WRONG = {
    "no target": (("array:6x6",), "target: expected point or array"),
    "too close": (("array:6x6@300um",), "crosstalk of holes 300 µm apart"),
    "not a target's file": (("camera.json",), 'target: expected "format": "lfcal-target"'),
    "no such file": (("nothing.json",), "nothing.json"),
    "pose": (("array:6x6@1mm", "--pose", "turn=1"), "pose: expected rotation"),
    "bounds": (("array:6x6@1mm", "--pose-within", "rotation=-1"), "bound of the target's pose"),
    "tolerance": (("array:6x6@1mm", "--tolerance", "0"), "--tolerance: expected a number ≥ 0.01 and ≤ 0.5"),
    "crosstalk": (("array:6x6@1mm", "--crosstalk", "2"), "--crosstalk: expected a number ≥ 1e-06 and < 1"),
    "speed": (("array:6x6@1mm", "--speed", "0"), "--speed: expected a number > 0"),
    "frame rate": (("array:6x6@1mm", "--frame-rate", "0"), "--frame-rate: expected a number > 0"),
    "option before": (("--source", "array:6x6@1mm"), "type lfcal plan target PLAN SOURCE"),
    "the plan itself": (("array:6x6@1mm", "-o", "scan.json"), "a file other than the input"),
    "the target itself": (("t.json", "-o", "t.json"), "a file other than the input"),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_input_ends_in_a_line(lfcal: Lfcal, place: Path, name: str) -> None:
    (place / "t.json").write_text(Target("square", (6, 6), (1000.0, 1000.0)).to_json())
    words, said = WRONG[name]
    run = lfcal(*PLAN, *words, *(() if "-o" in words else ("-o", "out.json")))
    assert run.code == 2 and run.err.count("\n") == 1 and said in run.err, run.err
    assert not (place / "out.json").exists()


@pytest.mark.parametrize("option", ["--tolerance", "--crosstalk", "--pose", "--pose-within", "--most-frames"])
def test_options_of_a_target_need_one(lfcal: Lfcal, place: Path, option: str) -> None:
    del place
    run = lfcal("plan", "camera.json", "--virtual-depths", "4", option, "1")
    said = f"{option}: expected another spelling; type lfcal plan target PLAN SOURCE {option}"
    assert run.code == 2 and run.err == f"lfcal: {said}\n"


def test_a_plan_of_a_target_is_no_scan_plan(lfcal: Lfcal, place: Path) -> None:
    assert lfcal(*PLAN, "array:6x6@1.0213mm", "--most-frames", "2", "-o", "plan.json").code == 0
    run = lfcal("acquire", "plan.json", "-o", "session", "--dry-run", "--json")
    assert run.code == 0 and json.loads(run.out)["positions"] == 2  # frames, not the positions of its scan
    with pytest.raises(FileFormatError, match="scan plan: expected"):
        ScanPlan.from_json((place / "plan.json").read_text())
    assert not (place / "session").exists()


@pytest.mark.long
def test_regions_are_all_in_the_same_frames(lfcal: Lfcal, place: Path) -> None:
    del place
    words = (*PLAN, "array:6x6@1021.3um", "--most-frames", "3", "--regions", "1x3")
    said = lfcal(*words, "--json").json
    found = said["regions"]["regions"]
    assert [one["name"] for one in found] == ["centre", "r1c1", "r1c3"]
    plan = TargetPlan.from_dict(said["plan"])
    every = sum(len(plan.points(0, k)) for k in range(3))
    assert sum(one["points"][0] for one in found) == every and min(one["fewest_points"] for one in found) > 0
    assert said["regions"]["single_point"]["frames"] == 3 * 252
    run = lfcal(*words)
    assert "3 regions, all in the same frames" in run.out and "756 frames" in run.out
