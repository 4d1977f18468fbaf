"""DOC."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from lfcal.base.errors import FileFormatError, InputError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.targets import Display, Pose, Target, TargetPlan, Wishes, iter_plan_display
from lfcal.targets.subsets import coding_verdict, planned_for_display
from tests.cli.conftest import Lfcal
from tests.targets.common import scan_of, small

DISPLAY_SCAN = scan_of(small(200))


DISPLAY = Display((2000, 2000), 5.0)


CODED = ("plan", "target", "scan.json", "--tolerance", "0.3", "--crosstalk", "0.02")


SOURCE = ("display:2000x2000@5um",)


@pytest.fixture(scope="module")
def plan() -> TargetPlan:
    return drain(iter_plan_display(DISPLAY_SCAN, DISPLAY, Wishes(0.3, 0.02, 7)))


@pytest.fixture
def display_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "scan.json").write_text(DISPLAY_SCAN.to_json())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.long
def test_coding_pays_for_weak_light_only(plan: TargetPlan) -> None:
    bright, dim = coding_verdict(plan), coding_verdict(plan, signal_e=100.0)
    assert bright is not None and dim is not None
    full = DISPLAY_SCAN.camera.sensor.full_well_e
    assert not bright.pays and bright.gain.signal_e == pytest.approx(0.8 * full)
    assert dim.pays and 100 < dim.break_even_e < 0.8 * full and dim.gain.points == 7
    words = bright.frames_words
    assert words.count("\n") == 0 and "does not pay at 16000 electrons" in words
    assert "it pays up to " + f"{bright.break_even_e:.3g}"[:1] in words and "photon noise of bright cores" in words
    assert "pays at 100 electrons" in dim.frames_words and "the sensor's noise dominates" in dim.frames_words
    facts = dim.to_dict()
    assert facts["pays"] and facts["together"] == 7 and facts["gain_db"] > 1


@pytest.mark.long
def test_by_what_rules_at_any_light() -> None:
    quiet = replace(DISPLAY_SCAN.camera.sensor, read_noise_e=0.0, dark_current_e_s=0.0, bit_depth=16)
    scan = replace(DISPLAY_SCAN, camera=replace(DISPLAY_SCAN.camera, sensor=quiet))
    still = replace(drain(iter_plan_display(DISPLAY_SCAN, DISPLAY, Wishes(0.3, 0.02, 3))), scan=scan)
    found = coding_verdict(still, signal_e=1000.0)
    assert found is not None and not found.pays and found.break_even_e < 10


def test_a_display_shows_several_at_once_only_where_that_pays(plan: TargetPlan) -> None:
    for signal, many in ((None, False), (100.0, True)):
        found = planned_for_display(plan, DISPLAY, coding_verdict(plan, signal_e=signal))
        assert (found.lit is not None) == many and len(found.frames) == 7
    # sums that saturate are not shown, whatever the noise says
    sensor = replace(DISPLAY_SCAN.camera.sensor, full_well_e=4000.0, read_noise_e=200.0)
    noisy = replace(plan, scan=replace(DISPLAY_SCAN, camera=replace(DISPLAY_SCAN.camera, sensor=sensor)))
    verdict = coding_verdict(noisy, signal_e=3900.0)
    assert verdict is not None and verdict.gain.time.exposure < 1
    assert planned_for_display(noisy, DISPLAY, verdict).lit is None and planned_for_display(plan, DISPLAY, None) is plan


def test_a_single_point_or_few_frames_have_no_verdict(plan: TargetPlan) -> None:
    assert coding_verdict(replace(plan, offsets_px=(plan.offsets_px[0][:2],))) is None
    assert coding_verdict(replace(plan, target=Target())) is None
    with pytest.raises(InputError, match="--signal"):
        coding_verdict(plan, signal_e=1e9)


def test_the_command_shows_the_verdict_in_one_line(lfcal: Lfcal, display_place: Path) -> None:
    array = ("array:4x4@800um", "--most-frames", "7")
    run = lfcal(*CODED, *array)
    (line,) = [one for one in run.out.splitlines() if "coded" in one]
    assert run.code == 0 and line.startswith("showing 7 frames together, coded: does not pay"), run.err
    said = lfcal(*CODED, *array, "--signal", 50, "--json").json
    assert said["coding"]["pays"] and said["coding"]["up_to_e"] > 50


def test_displays_and_codes_that_cannot_be_planned_end_in_a_line(lfcal: Lfcal, display_place: Path) -> None:
    display = SOURCE[0]
    for words, said in (
        ("display:2x3", "display: expected display:ROWSxCOLUMNS@PITCH"),
        ("display:20x20@5um", "room for two points"),
        ("array:4x4@800um --patterns p", "--patterns: expected a display, got a target that a stage moves"),
        (f"{display} --most-frames 7 --signal 0", "--signal: expected a number > 0"),
        ("point --most-frames 2 --signal 5", "expected at least two points, and enough frames"),
        (f"{display} --pose rotation=1", "--pose: expected a target that a stage moves, got a display"),
    ):
        lfcal(*CODED, *words.split(), "-o", "out.json").refused(said)
        assert not (display_place / "out.json").exists(), words


def test_a_stage_cannot_record_frames_of_a_display(lfcal: Lfcal, display_place: Path, plan: TargetPlan) -> None:
    found = planned_for_display(plan, DISPLAY, coding_verdict(plan, signal_e=100.0))
    (display_place / "plan.json").write_text(found.to_json())
    lfcal("acquire", "plan.json", "-o", "s", "--backend", "micromanager").refused("lfcal plan target --patterns")
    assert not (display_place / "s").exists()


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
    run = lfcal(*PLAN, "array:6x6@1021.3um,hole=20um", "--most-frames", "12", "-o", "target.json").ok()
    assert "252 phases within 0.1 px by array:6x6@1021.3um,hole=20um" in run.out
    assert "a single point" in run.out and "written: target.json" in run.out and "not all phases are shown" in run.err
    plan = TargetPlan.from_json((place / "target.json").read_text())
    assert plan.target == Target("square", (6, 6), (1021.3, 1021.3), 20.0)
    assert len(plan.offsets_px[0]) == 12 and plan.tolerance_px == 0.1 and plan.scan == SCAN


def test_json_contains_the_numbers_of_the_table(lfcal: Lfcal, place: Path) -> None:
    (place / "t.json").write_text(Target("square", (6, 6), (1021.3, 1021.3)).to_json())
    options = ("--tolerance", "0.4", "--crosstalk", "0.02", "--pose", "rotation=1,tilt_right=2")
    (place / "scan.json").write_text(replace(SCAN, exposure_s=0.5).to_json())
    said = lfcal(*PLAN, "t.json", *options, "--pose-within", "rotation=0.5", "--json").json
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
@pytest.mark.usefixtures("place")
def test_its_frames_are_read_out(lfcal: Lfcal) -> None:
    words = (*PLAN, "array:6x6@1021.3um", "--most-frames", "3")
    assert "total time without readout (--frame-rate)" in lfcal(*words).out
    assert "without readout" not in lfcal(*words, "--frame-rate", "0.5").out
    plain, read = (lfcal(*words, *more, "--json").json for more in ((), ("--frame-rate", "0.5")))
    assert plain["readout_hours"] is None and (read["hours"] - plain["hours"]) * 3600 == pytest.approx(3 / 0.5)
    assert (read["single_point"]["hours"] - plain["single_point"]["hours"]) * 3600 == pytest.approx(252 / 0.5)


@pytest.mark.long
@pytest.mark.usefixtures("place")
def test_an_unknown_pose_is_named(lfcal: Lfcal) -> None:
    run = lfcal(*PLAN, "array:6x6@1.0213mm", "--pose-within", "rotation=1", "--tolerance", "0.5").ok()
    assert "record one frame, measure the pose, and plan again with it" in run.err


@pytest.mark.long
def test_a_pitch_is_proposed(lfcal: Lfcal, place: Path) -> None:
    run = lfcal(*PLAN, "array,hole=5um", "-o", "plan.json").ok()
    assert "hole=5um" in run.out
    plan = TargetPlan.from_json((place / "plan.json").read_text())
    assert plan.coverage(0) == 1.0 and len(plan.offsets_px[0]) <= 2 * plan.least_frames(0)
    # the description that is shown can be used again: the pitch as ordered
    assert "100 %" in lfcal(*PLAN, run.out.split(" px by ")[1].split()[0]).ok().out


WRONG = (
    ("array:6x6", "target: expected point or array"),
    ("array:6x6@300um", "crosstalk of holes 300 µm apart"),
    ("camera.json", 'target: expected "format": "lfcal-target"'),
    ("nothing.json", "nothing.json"),
    ("array:6x6@1mm --pose turn=1", "pose: expected rotation"),
    ("array:6x6@1mm --pose-within rotation=-1", "bound of the target's pose"),
    ("array:6x6@1mm --tolerance 0", "--tolerance: expected a number ≥ 0.01 and ≤ 0.5"),
    ("array:6x6@1mm --crosstalk 2", "--crosstalk: expected a number ≥ 1e-06 and < 1"),
    ("array:6x6@1mm --speed 0", "--speed: expected a number > 0"),
    ("array:6x6@1mm --frame-rate 0", "--frame-rate: expected a number > 0"),
    ("--source array:6x6@1mm", "use lfcal plan target PLAN SOURCE"),
    ("array:6x6@1mm -o scan.json", "a file other than the input"),
    ("t.json -o t.json", "a file other than the input"),
)


def test_targets_that_cannot_be_planned_end_in_a_line(lfcal: Lfcal, place: Path) -> None:
    (place / "t.json").write_text(Target("square", (6, 6), (1000.0, 1000.0)).to_json())
    for words, said in WRONG:
        lfcal(*PLAN, *words.split(), *(() if "-o" in words else ("-o", "out.json"))).refused(said)
        assert not (place / "out.json").exists(), words
    for option in ("--tolerance", "--crosstalk", "--pose", "--pose-within", "--most-frames"):
        said = f"{option}: expected an option of lfcal plan; use lfcal plan target PLAN SOURCE {option}"
        lfcal("plan", "camera.json", "--virtual-depths", "4", option, "1").refused(f"lfcal: {said}")


def test_a_plan_of_a_target_is_not_a_scan_plan(lfcal: Lfcal, place: Path) -> None:
    lfcal(*PLAN, "array:6x6@1.0213mm", "--most-frames", "2", "-o", "plan.json").ok()
    run = lfcal("acquire", "plan.json", "-o", "session", "--dry-run", "--json").ok()
    assert run.json["positions"] == 2, "frames, not the positions of its scan"
    with pytest.raises(FileFormatError, match="scan plan: expected"):
        ScanPlan.from_json((place / "plan.json").read_text())
    assert not (place / "session").exists()


@pytest.mark.long
@pytest.mark.usefixtures("place")
def test_regions_are_all_in_the_same_frames(lfcal: Lfcal) -> None:
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
