"""``lfcal acquire`` and ``lfcal verify``: scans, targets, and sessions that end by the error of H."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest

from lfcal.acquire.options import Options
from lfcal.acquire.redo import RedoList
from lfcal.acquire.session_file import SessionFile
from lfcal.base import InputError
from lfcal.camera import Marks, ScanPlan
from lfcal.fit.setup import described_effects
from lfcal.frames import open_frames
from lfcal.frames.source import Position
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.simulate.effects.described import Entry, entries_json
from lfcal.targets import Pose, Target, TargetPlan, Wishes, plan_target
from lfcal.tasks import AcquireUntil
from tests.acquire.rigs import frames_of, small_plan
from tests.acquire.rotting import flip, rot_frame
from tests.campaign.points import frames_of_drawn, plan_of
from tests.cli.conftest import Lfcal, Run
from tests.fit.common import small_plan as plan_to_fit
from tests.targets.common import small

# -- Options of ``lfcal acquire`` that the recorded session keeps, or that decide how it is recorded --
Acquire = Lfcal

PLAN = small_plan((2, 3), 2)
QUICKLY = ("--option", "optics=pattern")
"""Any frames will do: those of the plan's camera take seconds."""


@pytest.fixture
def acquire(lfcal: Lfcal, tmp_path: Path) -> Acquire:
    """Record six positions in two planes by the simulator, without darks and references."""
    (tmp_path / "plan.json").write_text(PLAN.to_json())

    def record(*options: object, out: str = "s") -> Run:
        alone = ("--darks", 0, "--reference-every", 0, "--no-check-stage")
        return lfcal("acquire", tmp_path / "plan.json", "--out", tmp_path / out, *alone, *options)

    return record


def test_the_session_keeps_how_it_is_recorded(acquire: Acquire, tmp_path: Path) -> None:
    every: tuple[tuple[object, str, object], ...] = (
        (("--overshoot", "0,0,5"), "overshoot_um", (0.0, 0.0, 5.0)),
        (("--tolerance", "3,3,9"), "tolerance_um", (3.0, 3.0, 9.0)),
        (("--retries", 4), "retries", 4),
        (("--no-check-origin",), "origin_tolerance_px", None),
        (("--order", "coarse"), "order", "coarse"),
        (("--bracket", "1,0.25"), "bracket", (1.0, 0.25)),
        (("--margin", 3), "margin_px", 3),
        (("--suspend", "temperature=20:22", "--suspend", "lamp=90:"), "suspend", ("temperature=20:22", "lamp=90:")),
        (("--steady", 2), "steady_s", 2.0),
    )
    acquire(*QUICKLY, *(word for options, _, _ in every for word in options)).ok()
    kept = SessionFile.read(tmp_path / "s").options
    for _, name, value in every:
        assert getattr(kept, name) == value != getattr(Options(), name), name
    assert len(frames_of(tmp_path / "s")) == PLAN.n_positions


def test_assumed_values_of_the_camera_are_named_once(acquire: Acquire, tmp_path: Path) -> None:
    guessed = replace(PLAN, camera=replace(PLAN.camera, marks=Marks.of({"lattice.gap_um": "assumed"})))
    (tmp_path / "plan.json").write_text(guessed.to_json())
    done = acquire("--assemble", tmp_path / "H.h5", "--option", "optics=pattern").ok()
    assert done.err.count("assumed values of the camera") == 1


def test_retries_decide_whether_a_fault_ends_the_session(acquire: Acquire, tmp_path: Path) -> None:
    fault = (*QUICKLY, "--option", "faults=times out@2*1")
    acquire(*fault, "--retries", 0).refused("positions are safe")
    assert acquire(*fault, "--retries", 1, out="t").code == 0 and len(frames_of(tmp_path / "t")) == PLAN.n_positions


def test_frames_of_one_backend_and_the_stage_of_another(acquire: Acquire, tmp_path: Path) -> None:
    (tmp_path / "watched").mkdir()
    camera = ("--backend", "folder", "--option", f"path={tmp_path / 'watched'}", "--dry-run", "--json")
    found: Any = acquire(*camera, "--stage", "sim").json
    assert "sim" in found["stage"] and "sim" not in found["camera"] and found["positions"] == PLAN.n_positions
    acquire("--stage", "aravis").refused("a backend with a stage")


def test_resume_compares_the_last_position_by_default(acquire: Acquire) -> None:
    acquire(*QUICKLY, "--option", "faults=times out@6*9").refused("positions are safe")
    acquire(*QUICKLY, "--resume", "--option", "axes=-x,+y,+z").refused("last recorded position")


@pytest.mark.long
def test_a_stage_that_goes_elsewhere_is_found_out_or_accepted(acquire: Acquire, tmp_path: Path) -> None:
    """Frames of the plan's camera; --no-check-origin accepts the stage."""
    acquire("--option", "faults=times out@6*9").refused("positions are safe")
    moved = ("--resume", "--option", "axes=-x,+y,+z")
    acquire(*moved).refused("last recorded position")
    acquire(*moved, "--no-check-origin").ok()
    assert all(np.asarray(frame).any() for frame in frames_of(tmp_path / "s").values())


# -- ``lfcal acquire`` of a target's plan, as a user runs it --
QUICK = ("--darks", 0, "--reference-every", 0)


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


def test_a_target_is_recorded_and_its_coverage_reported(
    lfcal: Lfcal, plan: TargetPlan, file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "session"
    told = lfcal("acquire", file, "-o", out, *QUICK, "--json").ok().json
    assert told["outcome"]["acknowledged"] == 8 and told["bytes_gained"] > 0 and not told["findings"]
    assert told["shown"]["frames"] == 8 and told["shown"]["coverage"] == pytest.approx(plan.coverage(0))
    assert len(open_frames(out)) == 8  # packed, and open as before
    assert "This session is intact in 8 of 8 frames." in lfcal("verify", out).ok().out
    status = lfcal("status", out, "--json").ok().json
    assert (status["session"], status["done"], status["total"], status["how"]) == ("target", 8, 8, "complete")
    assert status["shown"]["coverage"] == told["shown"]["coverage"]
    said = lfcal("status", out).ok().out
    assert "8 of 8 frames of a target" in said and "lfcal fit" in said


def test_a_resumed_session_reports_the_coverage_of_all_frames(
    lfcal: Lfcal, plan: TargetPlan, file: Path, tmp_path: Path
) -> None:
    assert lfcal("acquire", file, "-o", tmp_path / "s", *QUICK, "--option", "faults=vanishes@5").code != 0
    text = lfcal("acquire", file, "-o", tmp_path / "s", "--resume").ok().out
    assert "complete, 8 of 8 frames" in text and f"{100 * plan.coverage(0):.3g}" in text


def test_a_dry_run_states_the_cost_and_moves_nothing(
    lfcal: Lfcal, plan: TargetPlan, file: Path, tmp_path: Path
) -> None:
    words = ("acquire", file, "-o", tmp_path / "session", *QUICK)
    told = lfcal(*words, "--dry-run", "--json").ok().json
    assert told["positions"] == 8 and told["seconds"] == pytest.approx(3600 * plan.forecast().hours)
    assert told["recording_bytes"] == 8 * (200 * 200 * 2 + 128) and told["readout_seconds"] is None
    read = lfcal(*words, "--dry-run", "--json", "--frame-rate", "4").ok().json
    assert read["readout_seconds"] == 2 and read["seconds"] == pytest.approx(told["seconds"] + 2)
    for option in (("--until-error", "1%"), ("--order", "coarse"), ("--controls", 2)):
        lfcal(*words, *option).refused(option[0])
    assert not (tmp_path / "session").exists()


def test_another_target_may_be_before_the_simulated_camera(
    lfcal: Lfcal, plan: TargetPlan, file: Path, tmp_path: Path
) -> None:
    """Rotated by 4 degrees, its light is at the rotated places, and not at those of the plan."""
    there = replace(plan.target, pose=Pose(rotation_rad=np.radians(4.0)))
    (tmp_path / "there.json").write_text(there.to_json())
    options = ("--option", f"target={tmp_path / 'there.json'}", "--option", "brightness=0.1")
    lfcal("acquire", file, "-o", tmp_path / "session", *QUICK, *options).ok()
    frame = open_frames(tmp_path / "session").read(0).astype(float)
    lit = []
    for target in (there, plan.target):
        pixels = replace(plan, target=target).points(0, 0).pixels
        corner = pixels[np.argmax(np.abs(pixels - 99.5).min(axis=1))]
        row, column = np.rint(corner).astype(int)
        lit.append(frame[row - 1 : row + 2, column - 1 : column + 2].mean())
    assert lit[0] > 1.1 * lit[1]
    (tmp_path / "scan.json").write_text(plan.scan.to_json())
    for option, said in (
        ("brightness=0.1", "give target=FILE"),
        (f"target={tmp_path / 'scan.json'}", '"format": "lfcal-target"'),
    ):
        lfcal("acquire", tmp_path / "scan.json", "-o", tmp_path / "s", *QUICK, "--option", option).refused(said)


# -- ``lfcal acquire --until-error``: a session that ends when H is as good as wanted, and continues after an end --
SIMULATED = ("--option", "optics=grid", "--option", "effects=effects.json", "--no-check-stage")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    plan = replace(plan_to_fit(15, (2.2,)), period=(6, 8))
    (tmp_path / "plan.json").write_text(plan.to_json())
    entries = [Entry(one, one.name, {}, "on") for one in described_effects(plan.camera)]
    (tmp_path / "effects.json").write_text(entries_json(entries))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def until(lfcal: Lfcal, *more: str) -> Run:
    return lfcal("acquire", "plan.json", "-o", "s", "--unknowns", "geometry", "--workers", "1", *SIMULATED, *more)


def test_a_dry_run_states_the_largest_number_of_positions(lfcal: Lfcal, place: Path) -> None:
    run = until(lfcal, "--until-error", "1%", "--most", "30", "--dry-run", "--json").ok()
    assert run.json["positions"] == 30 and not (place / "s").exists()
    assert "the forecast is for the largest number of positions" in run.err


def test_goals_by_their_words() -> None:
    given = {"plan": "plan.json", "out": "s"}
    goal = AcquireUntil(**given, until_error="0.5%").goal
    assert goal.error == pytest.approx(0.005) and goal.most is None and goal.unknowns == "auto"
    named = AcquireUntil(**given, until_error="0.02", most=50, unknowns="iris,geometry,iris").goal
    assert named == replace(goal, error=0.02, most=50, unknowns=("iris", "geometry"))
    assert AcquireUntil(**given, until_error=0.01, unknowns="auto").goal.unknowns == "auto"
    with pytest.raises(InputError, match="until_error: expected a number, or percent, got 'half'"):
        assert AcquireUntil(**given, until_error="half").goal


def test_goals_that_cannot_be_reached_are_refused(lfcal: Lfcal, place: Path) -> None:
    good = "a scan until H is good enough (--until-error)"
    for words, said in (
        ("--until-error 0", "target error of H"),
        ("--until-error 200%", "target error of H"),
        ("--until-error 0.01%", "the simulation of patterns itself has an error of 0.06 %"),
        ("--until-error 1% --most 3", "largest number of positions"),
        ("--until-error 1% --unknowns gap", "--unknowns: expected auto, geometry, "),
        ("--until-error 1% --redo list.json", f"got {good}; leave --redo out"),
        ("--until-error 1% --positions list.json", f"got {good}; leave --positions out"),
        ("--most 20", f"--most: expected {good}, got a scan of one region"),
        ("--unknowns iris", f"--unknowns: expected {good}"),
        ("--until-error 1% --resume", "expected a session folder"),
        ("--until-error 1% --bracket 1,0.5", "single exposures, whose noise is known"),
    ):
        lfcal("acquire", "plan.json", "-o", "s", "--no-check-stage", *words.split()).refused(said)
        assert not (place / "s" / "session.json").exists(), words


# -- ``lfcal verify``, and what `acquire` and `assemble` do with what it finds --
SAMPLE = Path(__file__).parents[2] / "sample_data" / "recorded"


@pytest.fixture
def sample(tmp_path: Path) -> Path:
    return Path(shutil.copytree(SAMPLE, tmp_path / "recorded"))


@pytest.mark.long
def test_a_whole_session_and_its_h(lfcal: Lfcal, sample: Path, tmp_path: Path) -> None:
    run = lfcal("verify", sample)
    assert (run.code, run.out, run.err) == (0, f"{sample}: This session is intact in 636 of 636 frames.\n", "")
    lfcal("assemble", sample, "-o", tmp_path / "H.h5").ok()
    run = lfcal("verify", tmp_path / "H.h5", "--workers", 1).ok()
    assert "This H file is intact in 1 of 1 plane (compared with their checksums)" in run.out


def test_a_missing_input_is_named_first(lfcal: Lfcal, tmp_path: Path) -> None:
    for name in ("gone.npy", "gone.h5", "recording.h5", "gone"):
        for more in ((), ("--redo", tmp_path / "redo.json")):
            said = f"lfcal: {tmp_path / name}: no such file or folder; check the path\n"
            assert lfcal("verify", tmp_path / name, *more).refused().err == said


def test_one_damaged_frame_is_named_listed_and_left_out(lfcal: Lfcal, sample: Path, tmp_path: Path) -> None:
    rot_frame(sample / "recording.h5", 400)
    run = lfcal("verify", sample, "--redo", tmp_path / "redo.json")
    assert run.code == 1 and run.err == "" and "What remains is intact in 635 of 636 frames." in run.out
    assert "should not be used as it is: damaged position frames. Damaged position frames: 1 frame in rec" in run.out
    assert "position (z, y, x) = (0, 12, 4), recording.h5[400]: frame damaged" in run.out
    assert "Record these frames again (lfcal acquire --resume)." in run.out and "1 position to record again" in run.out
    assert RedoList.read(tmp_path / "redo.json").positions == (Position(0, 12, 4),)
    said = "recording.h5[400], (z, y, x) = (0, 12, 4): "
    lfcal("assemble", sample, "-o", tmp_path / "H.h5").refused(said, "--resume", "--skip-damaged")
    assert not (tmp_path / "H.h5").exists()
    run = lfcal("assemble", sample, "-o", tmp_path / "H.h5", "--skip-damaged").ok()
    assert "left out: recording.h5[400], (z, y, x) = (0, 12, 4)" in run.err
    with open_psf(tmp_path / "H.h5") as matrix:
        assert matrix.recorded[0, 12, 4] == 0


@pytest.mark.long
def test_an_h_without_a_damaged_frame_and_the_list_of_it(lfcal: Lfcal, sample: Path, tmp_path: Path) -> None:
    rot_frame(sample / "recording.h5", 400)
    assert lfcal("verify", sample, "--redo", tmp_path / "redo.json").code == 1
    assert lfcal("verify", sample, "--redo", tmp_path / "redo.json").code == 2, "an earlier list is not replaced"
    assert lfcal("verify", sample, "--redo", tmp_path / "redo.json", "--force").code == 1
    data: Any = lfcal("assemble", sample, "-o", tmp_path / "H.h5", "--skip-damaged", "--json").json
    assert data["missing"] == [[0, 12, 4]] and data["left_out"][0]["position"] == [0, 12, 4]
    with open_psf(tmp_path / "H.h5") as matrix:
        assert matrix.recorded[0, 12, 4] == 0
    lfcal("assemble", sample, "-o", tmp_path / "H.h5", "--force", "--skip-damaged").ok()
    said = "Positions never recorded: 1 position. Record these positions, or fill them"
    assert said in lfcal("verify", tmp_path / "H.h5").out


@pytest.mark.long
def test_json_lists_everything(lfcal: Lfcal, sample: Path) -> None:
    for slot in range(30):
        rot_frame(sample / "recording.h5", slot)
    text = lfcal("verify", sample).out
    assert "and 10 more (--json lists all)" in text and text.count("frame damaged") == 20
    run = lfcal("verify", sample, "--json")
    found: Any = run.json
    assert run.code == 1 and not found["ok"] and len(found["damaged"]) == len(found["to_redo"]) == 30
    first = {"file": "recording.h5", "slot": 0, "kind": "position", "position": [0, 0, 0], "what": "frame damaged"}
    assert found["damaged"][0] == first | {"replaced": False}


@pytest.mark.long
def test_damaged_frames_are_recorded_again(lfcal: Lfcal, tmp_path: Path) -> None:
    plan, session, redo = tmp_path / "plan.json", tmp_path / "session", tmp_path / "redo.json"
    plan.write_text(small_plan().to_json())
    options = ("acquire", plan, "--out", session, "--no-check-stage")
    lfcal(*options, "--assemble", tmp_path / "H.h5").ok()
    assert "not written, because there are no positions" in lfcal("verify", session, "--redo", redo).out
    assert not redo.exists()
    rot_frame(session / "recording.h5", 13)
    rot_frame(session / "checks.h5", 1)
    assert lfcal("verify", session).code == 1
    run = lfcal(*options, "--resume", "--assemble", tmp_path / "again.h5").ok()
    assert "2 damaged frames were found; those recorded now replace them" in run.out
    assert "recording.h5[13]: frame damaged, but recorded again since then" in lfcal("verify", session).ok().out
    with open_psf(tmp_path / "H.h5") as before, open_psf(tmp_path / "again.h5") as after:
        assert all(np.array_equal(before.plane(z), after.plane(z)) for z in range(3))
    rot_frame(session / "recording.h5", 12)
    assert lfcal("verify", session, "--redo", redo).code == 1
    lfcal(*options, "--redo", redo).ok()
    lfcal("verify", session).ok()


def test_damage_of_h_is_located(lfcal: Lfcal, tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((2, 3, 3, 9, 9)).astype(np.float32)
    path = save(PSFMatrix(values), tmp_path / "H.h5")

    with h5py.File(path) as file:
        info = file["H"].id.get_chunk_info_by_coord((1, 2, 0, 0, 0))
    flip(path, int(info.byte_offset) + 20)
    run = lfcal("verify", path)
    assert run.code == 1 and "plane 1: damaged at (z, y, x) = (1, 2, 0)" in run.out
    found: Any = lfcal("verify", path, "--json").json
    assert found["damaged"] == [{"region": "", "z": 1, "what": "damaged", "positions": [[1, 2, 0]]}]


def test_what_cannot_be_checked_is_refused_in_one_line(lfcal: Lfcal, sample: Path, tmp_path: Path) -> None:
    text = tmp_path / "text.h5"
    text.write_text("text")
    (tmp_path / "empty").mkdir()
    for path in (tmp_path / "none", text, tmp_path / "empty", sample / "recording.h5", sample / "session.json"):
        assert not lfcal("verify", path).refused().out
    lfcal("verify", text, "--redo", tmp_path / "r.json").refused()
    rot_frame(sample / "recording.h5", 3)
    before = (sample / "session.json").read_bytes()
    lfcal("verify", sample, "--redo", sample / "session.json").refused()
    assert (sample / "session.json").read_bytes() == before, "only a list is replaced by a list"
    assert "give its folder" in lfcal("verify", sample / "recording.h5").err


def test_deviations_from_the_format_are_located(lfcal: Lfcal, tmp_path: Path) -> None:
    H = PSFMatrix(np.ones((2, 3, 3, 5, 5), np.float32))
    path = save(H, tmp_path / "H.h5")
    save(H.T, tmp_path / "HT.h5")
    for name in ("H.h5", "HT.h5"):
        lfcal("verify", tmp_path / name).ok()
    with h5py.File(path, "r+") as file:
        del file["used_window"], file.attrs["region"]
    run = lfcal("verify", path)
    assert run.code == 1 and "deviation from the format: /used_window: missing" in run.out
    assert "deviation from the format: , attribute" not in run.out and "/, attribute region: missing" in run.out
    found: Any = lfcal("verify", path, "--json").json
    assert not found["ok"] and len(found["deviations"]) == 2


# -- Frames of a target through the commands: assembled where they show positions, inspected, refused by name --
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


def test_frames_of_a_target_are_assembled(lfcal: Lfcal, recorded: Path, tmp_path: Path) -> None:
    run = lfcal("assemble", recorded / "frames", "-o", tmp_path / "H.h5").ok()
    assert "points in 2 frames" in run.out and "row 2 is missing" in run.out and "positions without a frame" in run.out


@pytest.mark.long
def test_frames_of_a_target_are_assembled_and_inspected(lfcal: Lfcal, recorded: Path, tmp_path: Path) -> None:
    out = tmp_path / "H.h5"
    lfcal("assemble", recorded / "frames", "-o", out).ok()
    told = json.loads(lfcal("inspect", out, "--seconds", "0", "--json").out)
    found = {one["key"]: one for one in told["metrics"]}
    assert found["target_pose"]["merit"] == "good" and found["target_crosstalk"]["value"] == pytest.approx(0.4, rel=0.5)
    assert found["target_stage"]["value"] < 0.1 and found["target_labels"]["merit"] == "good"
    again = json.loads(lfcal("assemble", recorded / "frames", "-o", out, "--force", "--json").out)
    assert again["target"]["missing"] == 5 and again["frames"] <= again["target"]["points"]
    assert again["target"]["mistakes"][0]["kind"] == "missing row"


def test_what_does_not_fit_the_frames_of_a_target_is_refused(lfcal: Lfcal, recorded: Path, tmp_path: Path) -> None:
    (tmp_path / "other.json").write_text(plan_of([(0.0, 0.0), (3.0, -2.0), (1.0, 1.0)]).to_json())
    frames, other = recorded / "frames", ("--plan", tmp_path / "other.json")
    for command, options, said in (
        ("assemble", ("--channel", "R"), "target"),
        ("assemble", ("--half-cell",), "target"),
        ("assemble", ("--first", "1"), "target"),
        ("assemble", ("--columns", "x=a,y=b"), "target"),
        ("fit", ("--hybrid",), "target"),
        ("fit", ("--executor", "threads"), "target"),
        ("fit", ("--noise", "1,1"), "target"),
    ):
        lfcal(command, frames, *options, "-o", tmp_path / "out").refused(said, options[0])
    for command in ("assemble", "fit"):
        lfcal(command, frames, *other, "-o", tmp_path / "out").refused("plan of the target needs 3")
        none = lfcal(command, tmp_path / "none", "--plan", recorded / "plan.json", "-o", tmp_path / "out")
        none.refused("none: no such file or folder")
    assert not (tmp_path / "out").exists()


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
        lfcal("fit", recorded / "frames", *options, "-o", tmp_path / "out").refused("begun")
    assert [plan.scan.camera for plan in begun] == [camera, other]
