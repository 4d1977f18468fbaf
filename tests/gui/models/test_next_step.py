"""The next step: one scene for each row, what holds for all sittings, and what a sitting is gathered from."""

from __future__ import annotations

import re
import shutil
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base import Finding, Judgement
from lfcal.psf import Facts, Origin, PSFMatrix, save
from lfcal_gui.models import PageState, kept_verdict, page_states, verdict_of
from lfcal_gui.models.gathering import sitting_of
from lfcal_gui.models.next_step import JOBS, LONGEST, PLACES, ROWS, Sitting, Step, next_step, rail_words
from lfcal_gui.models.pace import KEPT, Paces
from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.stamp import stamp_of
from lfcal_gui.models.verdict import Verdict, with_verdict
from tests.cli.conftest import small_plan

CAMERA = Sitting(camera=True, white=True, plan=True, positions=5643, planes=9)
RIG = replace(CAMERA, rig=True, rig_measured=True, record_s=677, free_bytes=412e9, frame_bytes=1.2e9)
H = replace(CAMERA, h=True, h_camera=True, export_ht=True, export_bytes=179e6, verdict=Verdict("good"))
FEW = Verdict("bad", "Five frames are misplaced.", bad=5, share=0.008, failed=1, checks=39)
FOLDER = replace(CAMERA, source="folder", folder=True, frames=1254)


def row(
    line: str, action: str, base: Sitting, rail: dict[str, str] | None = None, **changes: Any
) -> tuple[Sitting, str, str, dict[str, str]]:
    """Return a sitting with its line, the action of its button, and words of the rail."""
    return replace(base, **changes), line, action, rail or {}


# fmt: off
TABLE = (
    row("Stopped: at position 4,120 the camera gave no frame for 5 s. Recorded data are safe.", "acquire.resume", RIG,
        {"record": "stopped"}, stopped="at position 4,120 the camera gave no frame for 5 s", done=4119, total=5643),
    row("Stopped: simulated camera: no answer. Recorded data are safe.", "acquire.resume", RIG, {"record": "stopped"},
        stopped="at position (z, y, x) = (1, 12, 7) by the device: simulated camera: no answer; check the cable",
        done=4119, total=5643),
    row("Stopped: the stage moves and moves and moves and moves and… Recorded data are safe.", "acquire.resume", RIG,
        {"record": "stopped"}, stopped="the stage " + "moves and " * 12, done=4119, total=5643),
    row("Recording: plane 7 of 9: 4,120 of 5,643 positions, 3 min 03 s left.", "acquire.pause", RIG,
        {"record": "plane 7 of 9"}, recording=True, done=4120, total=5643, plane=6, left_s=183),
    row("Next: record the target: 120 frames in 4 planes, about 32 s.", "acquire.connect", CAMERA, {"record": "no rig"},
        counted="frame", positions=120, planes=4, record_s=32),
    row("Next: assemble H from 120 recorded frames.", "acquire.assemble", CAMERA, {"record": "complete"},
        counted="frame", done=120, total=120),
    row("Paused: 1,523 positions are left, 3 min 03 s.", "acquire.resume", CAMERA, {"record": "paused"}, done=4120,
        total=5643, left_s=183),
    row("Assembling H: plane 3 of 9, 4 s left.", "jobs.make", FOLDER, {"h": "being made"}, job="make",
        job_words="plane 3 of 9", job_left_s=4),
    row("Next: choose the camera.", "setup.import", Sitting(), {"setup": "start here", "use": "needs H"}),
    row("Next: choose the camera of this H, to judge it fully.", "setup.import", Sitting(),
        {"setup": "no camera", "h": "not judged"}, h=True),
    row("Next: change the plan: the period is off by 0.46 px.", "setup.show", CAMERA, {"setup": "cannot work"},
        wrong="the period is off by 0.46 px"),
    row("Next: the cutout leaves the sensor: move the scan.", "setup.move", CAMERA, {"setup": "cannot work"},
        wrong="the cutout leaves the sensor", movable=True),
    row("Next: confirm 2 assumed values: f-number, gap.", "setup.assumed", CAMERA, {"setup": "2 assumed"},
        assumed=("f-number", "gap")),
    row("Next: compare the camera with a white image.", "setup.white", CAMERA, {"setup": "to check"}, white=False),
    row("Next: say which column holds x.", "frames.columns", CAMERA, {"record": "folder"}, source="folder",
        unread="say which column holds x"),
    row("Next: choose the folder with the frames.", "frames.import", CAMERA, {"record": "folder"}, source="folder"),
    row("Next: assemble H from 1,254 frames, about 3 s.", "frames.assemble", FOLDER,
        {"record": "folder", "h": "none yet"}, make_s=3),
    row("Next: assemble H from 3 frames; 20,897 of 20,900 positions have none.", "frames.assemble", FOLDER,
        {"record": "folder"}, frames=3, missing=20897, make_s=0.1),
    row("Next: assemble H from 1,250 frames.", "frames.assemble", FOLDER, {"record": "folder"}, frames=1250, missing=4),
    row("Next: assemble H from 1,254 frames.", "frames.assemble", FOLDER, {"record": "folder"}, h=True, h_camera=True,
        fresh=True, verdict=Verdict("good")),
    row("Next: plan the scan; lfcal derives it from the camera.", "setup.make", CAMERA, {"record": "needs a plan"},
        plan=False),
    row("Next: compute H: 9 planes, error 1.4 %, about 1 s.", "simulate.compute", CAMERA, {"record": "compute"},
        source="compute", error=0.014, compute_s=1),
    row("Next: assemble H from 5,643 recorded positions.", "acquire.assemble", RIG, {"record": "complete"}, done=5643,
        total=5643),
    row("Next: record the scan: 5,643 positions in 9 planes, about 11 min 17 s.", "acquire.connect", CAMERA,
        {"setup": "checked", "record": "no rig"}, record_s=677),
    row("Next: the frames need 1.8 TB, but only 412.0 GB are free: choose another folder.", "acquire.folder", RIG,
        {"record": "ready"}, frame_bytes=1.8e12),
    row("Next: measure the scale and axes of the stage.", "acquire.adjust", RIG, rig_measured=False),
    row("Next: record 5,643 positions in 9 planes, about 11 min 17 s.", "acquire.record", RIG, {"record": "ready"}),
    row("Next: judge H.", "h.judge", H, {"h": "not judged"}, verdict=None),
    row("Next: record 5 positions again; the rest of H is good.", "acquire.redo", H, {"h": "5 to redo"}, verdict=FEW,
        rig=True),
    row("Next: look at 5 bad positions; the rest of H is good.", "h.worst", H, {"h": "5 to redo"}, verdict=FEW),
    row("Next: leave 5 bad positions out of H, and fill them from the fit; the rest is good.", "h.leave_out", H,
        {"h": "5 to redo"}, verdict=FEW, folder=True),
    row("Next: leave 1 bad position out of H, and fill it from the fit; the rest is good.", "h.leave_out", H,
        {"h": "1 to redo"}, verdict=replace(FEW, bad=1), folder=True),
    row("Next: export H and HT, 179.0 MB uncompressed: H is good.", "reconstruct.export", H, {"h": "good"},
        verdict=replace(FEW, merit="good"), folder=True, filled=5),
    row("Next: record 5 positions again; the rest of H is good.", "acquire.redo", H, {"h": "5 to redo"},
        verdict=replace(FEW, merit="good"), filled=5, rig=True),
    row("Next: subtract the dark frames: background.", "frames.correct_dark", H, {"h": "bad"}, corrections=("dark",),
        verdict=Verdict("bad", remedy="dark", cause="background", failed=1, checks=39)),
    row("Next: see why H is bad: 3 of 39 checks fail.", "h.why", H, {"h": "bad"},
        verdict=Verdict("bad", rest="bad", failed=3, checks=39)),
    row("Next: see why H is not fully judged.", "h.why", H, {"h": "in doubt"},
        verdict=Verdict("unknown", rest="unknown")),
    row("Next: reconstruct 130 × 132 × 9 voxels, about 10 s.", "reconstruct.start", H, {"use": "ready"},
        light_field=True, place="use", voxels=(9, 132, 130), reconstruct_s=10),
    row("Next: export H and HT, 179.0 MB uncompressed: H is good.", "reconstruct.export", H,
        {"h": "good", "use": "ready"}),
    row("Done: H is exported to bench_oLaF.mat, 179.0 MB.", "reconstruct.folder", H, {"use": "exported"},
        exported="/data/bench_oLaF.mat", exported_bytes=179e6),
)


def steps_of(sitting: Sitting) -> tuple[Step, ...]:
    """Return the step that has to be done, and the optional one next to it."""
    step = next_step(sitting)
    return (step,) if step.other is None else (step.other, step)


OPTIONAL = {
    *("setup.import", "setup.assumed", "setup.white", "acquire.adjust", "h.judge", "h.why", "h.worst"),
    *("acquire.redo", "h.leave_out"),
}
TEXT = st.text(max_size=200) | st.just("the camera gave no frame for a while. " * 6)
NUMBERS = st.floats(0, 1e8) | st.none()
COUNTS = st.integers(0, 10**7)
QUALITIES = st.sampled_from(("good", "fair", "bad", "unknown"))
VERDICTS = st.none() | st.builds(
    Verdict,
    *(QUALITIES, TEXT, COUNTS, st.floats(0, 1), QUALITIES, COUNTS, COUNTS, st.just(())),
    *(st.sampled_from(("", "dark")), TEXT),
)
SPECIAL = {
    "counted": st.sampled_from(("position", "frame")),
    "place": st.sampled_from(PLACES),
    "source": st.sampled_from(("rig", "folder", "compute")),
    "job": st.sampled_from(("", *JOBS)),
    "verdict": VERDICTS,
    "declined": st.frozensets(st.sampled_from(sorted(OPTIONAL))),
    "assumed": st.lists(st.sampled_from(("f-number", "gap", "focal length of the main lens"))).map(tuple),
    "corrections": st.sampled_from(((), ("dark",))),
    "plane": st.integers(0, 9998),
    "planes": st.integers(0, 9999),
    "free_bytes": st.none() | st.floats(0, 1e15),
    "voxels": st.tuples(COUNTS, COUNTS, COUNTS),
    "error": st.none() | st.floats(0, 10),
    "export_title": st.sampled_from(("Export H", "Export for Prevedel", "Export as .mat")),
}
BY_TYPE = {"bool": st.booleans(), "str": TEXT, "int": COUNTS, "float": st.floats(0, 1e15), "float | None": NUMBERS}
SITTINGS = st.builds(
    Sitting, **{f.name: SPECIAL[f.name] if f.name in SPECIAL else BY_TYPE[str(f.type)] for f in fields(Sitting)}
)


def test_a_folder_of_frames_that_is_gone_is_asked_for_again(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    plan = small_plan()
    project = ProjectState("gone", plan.camera, plan, frames=str(folder))

    def button() -> str:
        return next_step(sitting_of(project, {}, (), page="frames", place="record")).button

    assert button() == "Assemble H"
    shutil.rmtree(folder)
    assert button() == "Import folder …"


def test_the_time_of_the_scan_follows_the_speed_and_frame_rate_of_set_up() -> None:
    plan = small_plan()

    def seconds(**rates: Any) -> float:
        found = sitting_of(ProjectState("", plan.camera, plan, settings={"plan": rates}), {}, ()).record_s
        assert found is not None
        return found

    usual = seconds()
    assert seconds(frame_rate=2.0) - usual == pytest.approx(plan.n_positions / 2)
    steps_um = np.abs(np.diff(plan.stage_um(plan.order_indices()), axis=0)).max(axis=1)
    assert seconds(speed=10.0) - usual == pytest.approx(steps_um.sum() * (1 / 10 - 1 / 1000))
    assert seconds(speed=-1.0, frame_rate="fast") == usual, "refused values take their defaults"


STOPPERS = (
    (replace(CAMERA, white=False, assumed=("gap",), plan=False), "Plan the scan"),
    (replace(RIG, white=False, assumed=("gap",), rig_measured=False), "Record"),
    (replace(H, h_camera=False, camera=False), "Export H"),
)


def test_an_optional_step_can_be_left_out_and_holds_up_nothing() -> None:
    for sitting, _, action, _ in TABLE:
        step, after = steps_of(sitting)[0], steps_of(replace(sitting, declined=frozenset({action})))[0]
        assert step.optional == (after != step)
        assert not step.optional or action in OPTIONAL
    assert next_step(replace(Sitting(), declined=frozenset({"setup.import"}))).action == "setup.import"
    for sitting, button in STOPPERS:
        step = next_step(sitting)
        assert (step.button, step.optional) == (button, False) and step.other.optional
    bad = replace(H, verdict=Verdict("bad", rest="bad"), declined=frozenset({"h.why"}))
    assert next_step(bad).words == "export H and HT, 179.0 MB uncompressed: H is bad."
    assert rail_words(bad)["h"].words == "bad", "what was declared unnecessary changes no word on what H is worth"


def test_every_row_has_a_scene_and_the_first_that_holds_is_next() -> None:
    for sitting, line, action, rail in TABLE:
        assert (line, action) in [(step.line, step.action) for step in steps_of(sitting)], line
        assert {place: rail_words(sitting)[place].words for place in rail} == rail, line
    assert {next(row for row in ROWS if row(sitting) is not None) for sitting, *_ in TABLE} == set(ROWS)


def test_the_devices_that_are_connected_next_are_named() -> None:
    plan = small_plan()
    for chosen, button in (
        ({}, "Use the simulated rig"),
        ({"acquire": {"backend": "micromanager"}}, "Connect camera and stage"),
    ):
        project = ProjectState(camera=plan.camera, plan=plan, settings=chosen)
        found = sitting_of(project, {}, (), page="acquire", place="record")
        step = next_step(replace(found, wrong="", white=True))
        assert (step.button, step.action) == (button, "acquire.connect")


@given(st.dictionaries(st.sampled_from(("make", "compute")), st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=KEPT)))
def test_paces_are_kept_between_starts(runs: dict[str, list[float]]) -> None:
    again = Paces.of(Paces(runs).texts())
    assert again.runs.keys() == runs.keys()
    assert all(again.runs[kind] == pytest.approx(runs[kind], rel=1e-3) for kind in runs)
    for text in ("make", "make x", "other 1", "make nan", "make -1", "make 0", "make inf"):
        assert Paces.of([text]).runs == Paces.of([]).runs == {}, text


def test_forecasts_are_corrected_by_the_median_of_the_last_runs() -> None:
    paces = Paces()
    assert paces.corrected({"make_s": 2.0, "compute_s": None}) == {"make_s": 2.0, "compute_s": None}
    for seconds in (100.0, 100.0, 3.0, 3.0, 0.1, 3.0, 3.0):
        paces.take("make", 1.0, seconds)
    assert len(paces.runs["make"]) == KEPT and paces.corrected({"make_s": 2.0})["make_s"] == 6.0
    assert paces.corrected({"compute_s": 2.0})["compute_s"] == 2.0, "another kind of job"
    paces.take("make", 0.0, 5.0)
    assert len(paces.runs["make"]) == KEPT
    told = {"frames": {"make_s": 2.0}, "simulate": {"compute_s": 1.0, "error": 0.01}}
    plain = sitting_of(ProjectState(), told, ())
    assert (plain.make_s, plain.compute_s, plain.error) == (2.0, 1.0, 0.01)
    found = sitting_of(ProjectState(), told, (), paces=Paces({"make": [1.5], "compute": [0.5]}))
    assert (found.make_s, found.compute_s, found.error) == (3.0, 0.5, 0.01)
    assert sitting_of(ProjectState(), {}, ()).make_s is None


def test_positions_that_a_model_filled_are_not_to_be_left_out_again(tmp_path: Path) -> None:
    origin = np.zeros((1, 4, 4), np.uint8)
    origin[0, 1, 2] = Origin.MODEL
    recorded = np.ones((1, 4, 4), int)
    recorded[0, 1, 2] = recorded[0, 3, 3] = 0
    facts = Facts.of((1, 4, 4), (5, 5), recorded=recorded, origin=origin)
    matrix = PSFMatrix(np.ones((1, 4, 4, 5, 5)), facts=facts)
    save(matrix, path := tmp_path / "H.h5")
    project = ProjectState(psf=str(path))
    stamp = stamp_of(str(path))
    assert stamp is not None
    verdict = Verdict("good", "", bad=2, share=0.01, failed=1, checks=9, redo=((0, 1, 2), (0, 3, 3)))
    project = replace(project, settings=with_verdict(project, stamp, verdict))
    for one in (matrix, matrix.T):
        found = sitting_of(project, {}, (), matrix=one)
        assert (found.filled, found.bad, replace(found, rig=True).bad) == (1, 1, 2)
    assert sitting_of(project, {}, ()).filled == 0


LOST = Finding(kind="misplaced", what="misplaced frames", merit="bad", repeat=5)
DARK = Finding(kind="background", what="background", merit="bad")
REDO = ((5, 3, 7), (5, 11, 25), (5, 12, 4), (5, 16, 18), (4, 6, 30))


def test_a_verdict_is_kept_as_long_as_the_file_is_the_same(tmp_path: Path) -> None:
    file = tmp_path / "H.h5"
    file.write_text("H")
    project = ProjectState(psf=str(file))
    assert kept_verdict(project) is None and page_states(project)["h"] is PageState.DONE
    stamp = stamp_of(str(file))
    for verdict, state in (
        (Verdict("good"), PageState.DONE),
        (Verdict("bad", "x", 1, 0.01, redo=((5, 3, 7),)), PageState.ATTENTION),
    ):
        project = replace(project, settings=with_verdict(project, stamp, verdict))
        again = ProjectState.from_json(project.to_json())
        assert kept_verdict(again) == verdict and page_states(again)["h"] is state
    (kept,) = project.settings["verdicts"]
    for damaged in (None, [], 3, [3], [{**kept, "bad": "many"}], [{"stamp": list(stamp[1:])}]):
        assert kept_verdict(replace(project, settings={"verdicts": damaged})) is None
    file.write_text("another H")
    assert kept_verdict(project) is None


def test_verdicts_on_other_h_stay(tmp_path: Path) -> None:
    project = ProjectState()
    for name, merit in (("a", "good"), ("b", "bad"), ("a", "fair")):
        file = tmp_path / f"{name}.h5"
        if not file.exists():
            file.write_text(f"H {'of ' * (name == 'b')}{name}")
        stamp = stamp_of(str(file))
        assert stamp is not None
        project = replace(project, settings=with_verdict(project, stamp, Verdict(merit)))
    assert [kept_verdict(project, str(tmp_path / f"{name}.h5")) for name in "ab"] == [Verdict("fair"), Verdict("bad")]
    assert len(project.settings["verdicts"]) == 2 and kept_verdict(project) is None


def test_a_verdict_says_what_is_left_and_the_correction_that_is_a_remedy() -> None:
    few = verdict_of(Judgement("H", (LOST,), "good by 30 checks"), REDO, 627, 39)
    assert few.few and (few.bad, few.rest, few.failed, few.checks) == (5, "good", 1, 39)
    assert few.share == 4 / 627 and few.sentence.startswith("This H should not be used")
    assert not verdict_of(Judgement("H", (LOST,), ""), REDO, 40, 39).few, "a tenth of a plane"
    both = verdict_of(Judgement.of("H", (LOST, DARK), ""), REDO, 627, 39)
    assert both.rest == "bad" and not both.few
    doubt = Finding(kind="unfinished", what="comparison", merit="unknown")
    assert verdict_of(Judgement.of("H", (LOST, doubt), ""), REDO, 627).rest == "unknown"
    assert verdict_of(Judgement("H", (DARK,), "")).remedy == "dark"
    assert verdict_of(Judgement("H", (LOST,), "")).remedy == ""
    good = verdict_of(Judgement("H", (), "good by 30 checks"))
    assert good.usable and not good.few and good == Verdict("good", "This H is good by 30 checks.")


@settings(max_examples=200, deadline=None, derandomize=True)
@given(SITTINGS)
def test_every_sitting_has_a_short_step_that_the_rail_does_not_contradict(sitting: Sitting) -> None:
    step, rail = next_step(sitting), rail_words(sitting)
    assert len(step.line) <= LONGEST and step.words.endswith(".") and "  " not in step.line, step.line
    assert all(len(sentence.split()) <= 25 for sentence in re.split(r"[.:] ", step.line))
    assert step.place in PLACES and re.fullmatch(r"[a-z]+\.[a-z_]+", step.action) and 0 < len(step.button) <= 28
    assert set(rail) == set(PLACES) and all(0 < len(one.words) <= 24 for one in rail.values())
    if step.lead == "Done":
        assert rail["use"].mark == "good"
    if step.lead == "Stopped":
        assert rail["record"].words == "stopped"
    if step.lead == "Paused":
        assert rail["record"].words in ("paused", "stopped")
    if step.action == "reconstruct.export" and "H is good" in step.words:
        assert rail["h"].words in ("good", f"{sitting.verdict.bad:,} to redo" if sitting.verdict else "")
    if rail["h"].words == "bad" and not sitting.job:
        assert "H is good" not in step.words
    if rail["use"].words == "needs H":
        assert step.action not in ("reconstruct.export", "reconstruct.folder", "reconstruct.start", "h.judge")
