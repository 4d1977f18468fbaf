"""Sessions of a target: whole frames of many points, as safe as those of single points."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.acquire.frame_plan import frame_grid
from lfcal.acquire.recording._verify import verify
from lfcal.acquire.recording.source import RecordingSource, TargetRecording, read_checks
from lfcal.acquire.redo import read_suspects
from lfcal.acquire.session import record
from lfcal.acquire.session_file import SessionFile
from lfcal.base.axes import Position
from lfcal.base.errors import FileFormatError, InputError
from lfcal.camera import ScanPlan
from lfcal.devices.rig import Rig
from lfcal.devices.simulated._targets import SwitchedRenderer, TargetPattern
from lfcal.devices.simulated.backend import simulated_rig
from lfcal.devices.simulated.faults import DeviceFault
from lfcal.frames import open_frames
from lfcal.frames.corrections.recipe import CorrectionRecipe, corrected_view
from lfcal.targets import Pose, Target, TargetPlan, Wishes, decoded, plan_target
from tests.acquire.rigs import CAREFUL, rig_for, small_plan
from tests.acquire.rotting import rot_frame
from tests.targets.common import small

FULL = replace(CAREFUL, darks=2, reference_every=3)


@pytest.fixture(scope="module")
def plan() -> TargetPlan:
    """Return six frames a plane of 3 x 3 holes, in two planes; the first plane lacks one: planes differ."""
    scan = ScanPlan.for_camera(small(200), virtual_depths=(4.0, 5.0), cutout=31, exposure_s=(0.02, 0.03))
    step = scan.camera.step_um(scan.depths_um[0])
    target = Target("square", (3, 3), (45 * step, 45 * step), pose=Pose(rotation_rad=math.radians(1.0)))
    made = plan_target(scan, target, Wishes(most_frames=6, level="geometric"))
    return replace(made, offsets_px=(made.offsets_px[0][:5], made.offsets_px[1]))


def rig_of(plan: TargetPlan, *faults: DeviceFault, target: Target | None = None) -> Rig:
    there = target or plan.target
    optics = TargetPattern(plan.scan, there, np.ones(len(there.holes)))
    return simulated_rig(plan.scan, optics=optics, faults=faults)


@pytest.fixture(scope="module")
def session(plan: TargetPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("target") / "session"
    assert record(folder, plan, rig_of(plan), FULL).acknowledged == 11
    return folder


def test_the_frames_of_a_session_are_those_of_its_plan(plan: TargetPlan, session: Path) -> None:
    source = open_frames(session)
    assert isinstance(source, TargetRecording)
    assert source.target == plan and source.frames == plan.frames and len(source) == 11
    assert source.shape == plan.scan.camera.sensor.shape
    assert frame_grid(plan) == (2, 1, 6)
    period = np.array(plan.scan.camera.period_px)
    for index, (z, k) in enumerate(plan.frames):
        info = source.info(index)
        assert info.origin == (0, 0) and info.exposure_s == pytest.approx(plan.scan.exposures[z])
        points = plan.points(z, k)
        assert len(info.points) == len(points) and {p.z for p in info.points} == {z}
        # positions are next to the holes: half a pixel, and what the period is not whole by
        for place, position in zip(points.pixels, info.points, strict=True):
            off = place - plan.scan.image_px(position)
            off -= period * np.round(off / period)
            assert np.abs(off).max() <= 0.5 + np.abs(period - plan.scan.period).max()
        # the holes are imaged where the plan expects them
        frame = source.read(index).astype(float)
        for row, column in np.rint(points.pixels).astype(int).tolist():
            assert frame[row - 3 : row + 4, column - 3 : column + 4].max() > 4 * np.median(frame)


def test_darks_and_references_belong_to_it(plan: TargetPlan, session: Path) -> None:
    source = open_frames(session)
    assert set(source.metadata.darks) == {0.02, 0.03}
    view = corrected_view(source, CorrectionRecipe())
    assert view.shape == source.shape and abs(float(np.median(view.read(0)))) < 1.5
    checks = read_checks(session)
    assert len(checks) == 5 and {c.position for c in checks} == {Position(1, 0, 0)}
    assert not read_suspects(session).positions
    report = verify(session)
    assert report.ok and not report.never_taken


def test_an_interrupted_session_is_resumed_unless_the_stage_was_moved(
    plan: TargetPlan, session: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "session"
    with pytest.raises(Exception, match=r"vanish|no answer"):
        record(folder, plan, rig_of(plan, DeviceFault("vanishes", 5)), CAREFUL)
    before = SessionFile.read(folder).runs[-1].acknowledged
    part = open_frames(folder)
    assert isinstance(part, TargetRecording) and part.frames == plan.frames[:before] and 0 < before < 11
    assert len(verify(folder).never_taken) == 11 - before
    step = plan.scan.camera.step_um(plan.scan.depths_um[0])
    lost = replace(plan.target, pose=replace(plan.target.pose, right_um=3 * step))
    with pytest.raises(InputError, match="image of the last recorded position"):
        record(folder, plan, rig_of(plan, target=lost), CAREFUL, resume=True)
    assert record(folder, plan, rig_of(plan), CAREFUL, resume=True).how == "complete"
    assert_same(session, folder)


def assert_same(one: Path, other: Path) -> None:
    a, b = open_frames(one), open_frames(other)
    assert len(a) == len(b) and all(np.array_equal(a.read(k), b.read(k)) for k in range(len(a)))


def test_damaged_frames_and_frames_of_a_list_are_taken_again(plan: TargetPlan, session: Path, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    record(folder, plan, rig_of(plan), CAREFUL)
    with TargetRecording(folder) as source:  # a frame whose holes all moved is as planned: nothing is taken twice
        assert [int(source.record(k)["attempts"]) for k in range(len(source))] == [1] * 11
    rot_frame(folder / "recording.h5", 7)
    assert verify(folder).to_redo == (Position(1, 0, 2),)
    with pytest.raises(FileFormatError, match=r"\(1, 0, 2\)"):
        open_frames(folder).read(7)
    assert record(folder, plan, rig_of(plan), CAREFUL, resume=True).damaged == 1
    assert_same(session, folder)
    record(folder, plan, rig_of(plan), CAREFUL, redo=[Position(1, 0, 5)])
    assert SessionFile.read(folder).recordings == ("recording.h5", "recording-002.h5")
    assert_same(session, folder)
    with pytest.raises(InputError, match="frame to record again"):
        record(folder, plan, rig_of(plan), CAREFUL, redo=[Position(0, 0, 5)])  # the first plane has five


def test_only_the_same_plan_is_resumed(plan: TargetPlan, session: Path) -> None:
    other = replace(plan, tolerance_px=0.2)
    with pytest.raises(InputError, match=r"plan\.tolerance_px"):
        record(session, other, rig_of(plan), FULL, resume=True)
    with pytest.raises(InputError, match="resumed session"):
        record(session, plan.scan, rig_of(plan), FULL, resume=True)


def test_wrong_frames_never_count_and_a_torn_one_is_taken_again(
    plan: TargetPlan, session: Path, tmp_path: Path
) -> None:
    for fault, doubt in (("blank", "light"), ("frozen", "repeats a buffer")):
        with pytest.raises(Exception, match=doubt):
            record(tmp_path / fault, plan, rig_of(plan, DeviceFault(fault, 4, 20)), CAREFUL)
        assert SessionFile.read(tmp_path / fault).runs[-1].acknowledged == 4
    record(tmp_path / "s", plan, rig_of(plan, DeviceFault("torn", 4)), CAREFUL)
    with TargetRecording(tmp_path / "s") as source, TargetRecording(session) as good:
        assert [int(source.record(k)["attempts"]) > 1 for k in range(len(source))] == [k == 4 for k in range(11)]
        for k in range(11):
            assert np.corrcoef(good.read(k).astype(float).ravel(), source.read(k).ravel())[0, 1] > 0.9


def test_options_of_single_points_are_refused(plan: TargetPlan, tmp_path: Path) -> None:
    for options in (replace(CAREFUL, order="coarse"), replace(CAREFUL, controls=2)):
        with pytest.raises(InputError, match="recording of a target of many points"):
            record(tmp_path / "s", plan, rig_of(plan), options)
    with pytest.raises(InputError, match="together with a target"):
        record(tmp_path / "s", plan, rig_of(plan), CAREFUL, only=[Position(0, 0, 0)])
    with pytest.raises(InputError, match="at least one frame"):
        record(tmp_path / "s", replace(plan, offsets_px=((), ())), rig_of(plan), CAREFUL)
    assert not (tmp_path / "s").exists()


def test_the_kinds_of_sessions_are_not_mistaken(session: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"open it with lfcal\.frames\.open_frames"):
        RecordingSource(session)
    scan = small_plan()
    record(tmp_path / "s", scan, rig_for(scan), CAREFUL)
    with pytest.raises(InputError, match="whole frames of a target"):
        TargetRecording(tmp_path / "s")
    data = json.loads((tmp_path / "s/session.json").read_text())
    assert data["version"] == 1 and "target" not in data  # as older versions read it


def test_a_session_file_whose_plans_disagree_is_refused(session: Path, tmp_path: Path) -> None:
    data = json.loads((session / "session.json").read_text())
    assert data["version"] == 2
    for change, text in (({"version": 1}, "a target in version 2"), ({"target": {}}, "plan of a target")):
        (tmp_path / "session.json").write_text(json.dumps({**data, **change}))
        with pytest.raises(FileFormatError, match=text):
            SessionFile.read(tmp_path)
    data["plan"]["settle_s"] = 0.5
    (tmp_path / "session.json").write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="that of the target"):
        SessionFile.read(tmp_path)


def test_brackets_and_averages_make_floats(plan: TargetPlan, tmp_path: Path) -> None:
    twice = replace(plan, scan=dataclasses.replace(plan.scan, frames_averaged=2))
    record(tmp_path / "s", twice, rig_of(twice), CAREFUL)
    with TargetRecording(tmp_path / "s") as source:
        assert source.dtype == np.float32 and source.metadata.noise


def test_frames_of_a_display_are_recorded_where_its_points_are_switched(
    plan: TargetPlan, session: Path, tmp_path: Path
) -> None:
    lit = ((0, 1), (1, 2), (0, 2))
    coded = replace(plan, offsets_px=(plan.offsets_px[0][:3], plan.offsets_px[1][:3]), lit=(lit, lit))
    optics = SwitchedRenderer(TargetPattern(plan.scan, plan.target, np.ones(len(plan.target.holes))), coded)
    rig = simulated_rig(plan.scan, optics=optics)
    still = replace(rig, switches=False)
    with pytest.raises(InputError, match="frames of a display"):
        record(tmp_path / "none", coded, still, CAREFUL)
    assert not (tmp_path / "none").exists()
    assert record(tmp_path / "session", coded, rig, FULL).acknowledged == 6
    source = open_frames(tmp_path / "session")
    assert isinstance(source, TargetRecording) and source.target == coded
    for index, (z, k) in enumerate(coded.frames):
        frame = source.read(index).astype(float)
        points = [coded.points(z, one) for one in lit[k]]
        assert len(source.info(index).points) == sum(map(len, points))
        for row, column in np.rint(np.concatenate([one.pixels for one in points])).astype(int).tolist():
            assert frame[row - 3 : row + 4, column - 3 : column + 4].max() > 4 * np.median(frame)
    alone = decoded(corrected_view(source, CorrectionRecipe(), source.plan), coded)
    # what an offset shows alone is the frame of a session that shows it alone
    single = open_frames(session)
    plain = corrected_view(single, CorrectionRecipe(), single.plan)
    alike = [[np.corrcoef(alone.read(m).ravel(), plain.read(k).ravel())[0, 1] for k in range(3)] for m in range(3)]
    assert np.argmax(alike, axis=1).tolist() == [0, 1, 2] and np.diag(alike).min() > 0.97
