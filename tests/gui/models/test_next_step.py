"""The line that leads through a sitting: one scene for each of its rows, and what holds for all sittings."""

from __future__ import annotations

import re
from dataclasses import fields, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal_gui.models.next_step import JOBS, LONGEST, PLACES, ROWS, Sitting, Step, next_step, rail_words
from lfcal_gui.models.verdict import Verdict

CAMERA = Sitting(camera=True, white=True, plan=True, positions=5643, planes=9)
RIG = replace(CAMERA, rig=True, rig_measured=True, record_s=677, free_bytes=412e9, frame_bytes=1.2e9)
H = replace(CAMERA, h=True, h_camera=True, export_ht=True, export_bytes=179e6, verdict=Verdict("good"))
FEW = Verdict("bad", "Five frames are misplaced.", bad=5, share=0.008, failed=1, checks=39)
FOLDER = replace(CAMERA, source="folder", folder=True, frames=1254)

TABLE = (
    (
        replace(RIG, stopped="at position 4,120 the camera gave no frame for 5 s", done=4119, total=5643),
        "Stopped: at position 4,120 the camera gave no frame for 5 s. Recorded data are safe.",
        "acquire.resume",
        {"record": "stopped"},
    ),
    (
        replace(
            RIG,
            stopped="at position (z, y, x) = (1, 12, 7) by the device: simulated camera: no answer; check the cable",
            done=4119,
            total=5643,
        ),
        "Stopped: simulated camera: no answer. Recorded data are safe.",
        "acquire.resume",
        {"record": "stopped"},
    ),
    (
        replace(RIG, stopped="the stage " + "moves and " * 12, done=4119, total=5643),
        "Stopped: the stage moves and moves and moves and moves and… Recorded data are safe.",
        "acquire.resume",
        {"record": "stopped"},
    ),
    (
        replace(RIG, recording=True, done=4120, total=5643, plane=6, left_s=183),
        "Recording: plane 7 of 9: 4,120 of 5,643 positions, 3 min 03 s left.",
        "acquire.pause",
        {"record": "plane 7 of 9"},
    ),
    (
        replace(CAMERA, counted="frame", positions=120, planes=4, record_s=32),
        "Next: record the target: 120 frames in 4 planes, about 32 s.",
        "acquire.connect",
        {"record": "no rig"},
    ),
    (
        replace(CAMERA, counted="frame", done=120, total=120),
        "Next: assemble H from 120 recorded frames.",
        "acquire.assemble",
        {"record": "complete"},
    ),
    (
        replace(CAMERA, done=4120, total=5643, left_s=183),
        "Paused: 1,523 positions are left, 3 min 03 s.",
        "acquire.resume",
        {"record": "paused"},
    ),
    (
        replace(FOLDER, job="make", job_words="plane 3 of 9", job_left_s=4),
        "Assembling H: plane 3 of 9, 4 s left.",
        "jobs.make",
        {"h": "being made"},
    ),
    (Sitting(), "Next: choose the camera.", "setup.import", {"setup": "start here", "use": "needs H"}),
    (
        Sitting(h=True),
        "Next: choose the camera of this H, to judge it fully.",
        "setup.import",
        {"setup": "no camera", "h": "not judged"},
    ),
    (
        replace(CAMERA, wrong="the period is off by 0.46 px"),
        "Next: change the plan: the period is off by 0.46 px.",
        "setup.show",
        {"setup": "cannot work"},
    ),
    (
        replace(CAMERA, wrong="the cutout leaves the sensor", movable=True),
        "Next: the cutout leaves the sensor: move the scan.",
        "setup.move",
        {"setup": "cannot work"},
    ),
    (
        replace(CAMERA, assumed=("f-number", "gap")),
        "Next: confirm 2 assumed values: f-number, gap.",
        "setup.assumed",
        {"setup": "2 assumed"},
    ),
    (
        replace(CAMERA, white=False),
        "Next: compare the camera with a white image.",
        "setup.white",
        {"setup": "to check"},
    ),
    (
        replace(CAMERA, source="folder", unread="say which column holds x"),
        "Next: say which column holds x.",
        "frames.columns",
        {"record": "folder"},
    ),
    (
        replace(CAMERA, source="folder"),
        "Next: choose the folder with the frames.",
        "frames.import",
        {"record": "folder"},
    ),
    (
        replace(FOLDER, make_s=3),
        "Next: assemble H from 1,254 frames, about 3 s.",
        "frames.assemble",
        {"record": "folder", "h": "none yet"},
    ),
    (
        replace(FOLDER, frames=3, missing=20_897, make_s=0.1),
        "Next: assemble H from 3 frames; 20,897 of 20,900 positions have none.",
        "frames.assemble",
        {"record": "folder"},
    ),
    (
        replace(FOLDER, frames=1_250, missing=4),
        "Next: assemble H from 1,250 frames.",
        "frames.assemble",
        {"record": "folder"},
    ),
    (
        replace(FOLDER, h=True, h_camera=True, fresh=True, verdict=Verdict("good")),
        "Next: assemble H from 1,254 frames.",
        "frames.assemble",
        {"record": "folder"},
    ),
    (
        replace(CAMERA, plan=False),
        "Next: plan the scan; lfcal derives it from the camera.",
        "setup.make",
        {"record": "needs a plan"},
    ),
    (
        replace(CAMERA, source="compute", error=0.014, compute_s=1),
        "Next: compute H: 9 planes, error 1.4 %, about 1 s.",
        "simulate.compute",
        {"record": "compute"},
    ),
    (
        replace(RIG, done=5643, total=5643),
        "Next: assemble H from 5,643 recorded positions.",
        "acquire.assemble",
        {"record": "complete"},
    ),
    (
        replace(CAMERA, record_s=677),
        "Next: record the scan: 5,643 positions in 9 planes, about 11 min 17 s.",
        "acquire.connect",
        {"setup": "checked", "record": "no rig"},
    ),
    (
        replace(RIG, frame_bytes=1.8e12),
        "Next: the frames need 1.8 TB, but only 412.0 GB are free: choose another folder.",
        "acquire.folder",
        {"record": "ready"},
    ),
    (replace(RIG, rig_measured=False), "Next: measure the scale and axes of the stage.", "acquire.adjust", {}),
    (RIG, "Next: record 5,643 positions in 9 planes, about 11 min 17 s.", "acquire.record", {"record": "ready"}),
    (replace(H, verdict=None), "Next: judge H.", "h.judge", {"h": "not judged"}),
    (
        replace(H, verdict=FEW, rig=True),
        "Next: record 5 positions again; the rest of H is good.",
        "acquire.redo",
        {"h": "5 to redo"},
    ),
    (
        replace(H, verdict=FEW),
        "Next: look at 5 bad positions; the rest of H is good.",
        "h.worst",
        {"h": "5 to redo"},
    ),
    (
        replace(H, verdict=FEW, folder=True),
        "Next: leave 5 bad positions out of H, and fill them from the fit; the rest is good.",
        "h.leave_out",
        {"h": "5 to redo"},
    ),
    (
        replace(H, verdict=replace(FEW, bad=1), folder=True),
        "Next: leave 1 bad position out of H, and fill it from the fit; the rest is good.",
        "h.leave_out",
        {"h": "1 to redo"},
    ),
    (
        replace(H, verdict=replace(FEW, merit="good"), folder=True, filled=5),
        "Next: export H and HT, 179.0 MB uncompressed: H is good.",
        "reconstruct.export",
        {"h": "good"},
    ),
    (
        replace(H, verdict=replace(FEW, merit="good"), filled=5, rig=True),
        "Next: record 5 positions again; the rest of H is good.",
        "acquire.redo",
        {"h": "5 to redo"},
    ),
    (
        replace(
            H, corrections=("dark",), verdict=Verdict("bad", remedy="dark", cause="background", failed=1, checks=39)
        ),
        "Next: subtract the dark frames: background.",
        "frames.correct_dark",
        {"h": "bad"},
    ),
    (
        replace(H, verdict=Verdict("bad", rest="bad", failed=3, checks=39)),
        "Next: see why H is bad: 3 of 39 checks fail.",
        "h.why",
        {"h": "bad"},
    ),
    (
        replace(H, verdict=Verdict("unknown", rest="unknown")),
        "Next: see why H is not fully judged.",
        "h.why",
        {"h": "in doubt"},
    ),
    (
        replace(H, light_field=True, place="use", voxels=(9, 132, 130), reconstruct_s=10),
        "Next: reconstruct 130 × 132 × 9 voxels, about 10 s.",
        "reconstruct.start",
        {"use": "ready"},
    ),
    (
        H,
        "Next: export H and HT, 179.0 MB uncompressed: H is good.",
        "reconstruct.export",
        {"h": "good", "use": "ready"},
    ),
    (
        replace(H, exported="/data/bench_oLaF.mat", exported_bytes=179e6),
        "Done: H is exported to bench_oLaF.mat, 179.0 MB.",
        "reconstruct.folder",
        {"use": "exported"},
    ),
)


def steps_of(sitting: Sitting) -> tuple[Step, ...]:
    """Return the step that has to be done, and the optional one next to it."""
    step = next_step(sitting)
    return (step,) if step.other is None else (step.other, step)


@pytest.mark.parametrize(("sitting", "line", "action", "rail"), TABLE, ids=[line for _, line, _, _ in TABLE])
def test_the_first_row_that_holds_says_what_comes_next(
    sitting: Sitting, line: str, action: str, rail: dict[str, str]
) -> None:
    assert (line, action) in [(step.line, step.action) for step in steps_of(sitting)]
    assert {place: rail_words(sitting)[place].words for place in rail} == rail


def test_every_row_has_a_scene() -> None:
    first = {next(row for row in ROWS if row(sitting) is not None) for sitting, *_ in TABLE}
    assert first == set(ROWS)


OPTIONAL = {
    "setup.import",
    "setup.assumed",
    "setup.white",
    "acquire.adjust",
    "h.judge",
    "h.why",
    "h.worst",
    "acquire.redo",
    "h.leave_out",
}


def test_an_optional_step_can_be_left_out() -> None:
    for sitting, _, action, _ in TABLE:
        step, after = steps_of(sitting)[0], steps_of(replace(sitting, declined=frozenset({action})))[0]
        assert step.optional == (after != step)
        assert not step.optional or action in OPTIONAL
    assert next_step(replace(Sitting(), declined=frozenset({"setup.import"}))).action == "setup.import"


@pytest.mark.parametrize(
    ("sitting", "button"),
    [
        (replace(CAMERA, white=False, assumed=("gap",), plan=False), "Plan the scan"),
        (replace(RIG, white=False, assumed=("gap",), rig_measured=False), "Record"),
        (replace(H, h_camera=False, camera=False), "Export H"),
    ],
)
def test_no_optional_step_holds_up_what_has_to_be_done(sitting: Sitting, button: str) -> None:
    step = next_step(sitting)
    assert (step.button, step.optional) == (button, False) and step.other is not None and step.other.optional


def test_what_was_declared_unnecessary_changes_no_word_on_what_h_is_worth() -> None:
    bad = replace(H, verdict=Verdict("bad", rest="bad"), declined=frozenset({"h.why"}))
    assert next_step(bad).words == "export H and HT, 179.0 MB uncompressed: H is bad."
    assert rail_words(bad)["h"].words == "bad"


TEXT = st.text(max_size=200) | st.just("the camera gave no frame for a while. " * 6)
NUMBERS = st.floats(0, 1e8) | st.none()
COUNTS = st.integers(0, 10**7)
VERDICTS = st.none() | st.builds(
    Verdict,
    st.sampled_from(("good", "fair", "bad", "unknown")),
    TEXT,
    COUNTS,
    st.floats(0, 1),
    st.sampled_from(("good", "fair", "bad", "unknown")),
    COUNTS,
    COUNTS,
    st.just(()),
    st.sampled_from(("", "dark")),
    TEXT,
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


@settings(max_examples=300, deadline=None)
@given(SITTINGS)
def test_every_sitting_has_a_step_in_short_words(sitting: Sitting) -> None:
    step = next_step(sitting)
    assert len(step.line) <= LONGEST, step.line
    assert step.words.endswith(".") and "  " not in step.line
    assert all(len(sentence.split()) <= 25 for sentence in re.split(r"[.:] ", step.line))
    assert step.place in PLACES and re.fullmatch(r"[a-z]+\.[a-z_]+", step.action) and 0 < len(step.button) <= 28


@settings(max_examples=300, deadline=None)
@given(SITTINGS)
def test_rail_and_line_never_contradict_each_other(sitting: Sitting) -> None:
    step, rail = next_step(sitting), rail_words(sitting)
    assert set(rail) == set(PLACES)
    assert all(0 < len(one.words) <= 24 for one in rail.values())
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
