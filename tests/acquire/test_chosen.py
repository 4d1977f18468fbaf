"""Sessions of chosen positions: recorded, interrupted, resumed, extended and read like any other."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.acquire._forecast import forecast
from lfcal.acquire.errors import AcquisitionStopped
from lfcal.acquire.finish import iter_assemble_session, iter_finish
from lfcal.acquire.options import Options
from lfcal.acquire.recording._verify import verify
from lfcal.acquire.recording.records import Kind
from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.redo import RedoList
from lfcal.acquire.session import record
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import FileFormatError, InputError
from lfcal.base.progress import drain
from lfcal.camera import Forecast
from lfcal.devices.simulated.faults import DeviceFault
from lfcal.frames.source import Position
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, rig_for, small_plan

PLAN = small_plan()
CHOSEN = [Position(*p) for p in ((2, 1, 1), (0, 0, 2), (0, 2, 0), (1, 1, 1), (2, 0, 0))]
WHOLE = Options(darks=2, reference_every=2, keep_free_bytes=0)


def test_only_chosen_positions_are_recorded(tmp_path: Path) -> None:
    outcome = record(tmp_path / "s", PLAN, rig_for(PLAN), WHOLE, only=CHOSEN, kept_aside=CHOSEN[:1])
    assert (outcome.how, outcome.acknowledged, outcome.total) == ("complete", 5, 5)
    session = SessionFile.read(tmp_path / "s")
    schedule = session.schedule(0)
    assert schedule.count(Kind.POSITION) == 5 and schedule.count(Kind.DARK) == 1 and schedule.count(Kind.REFERENCE) == 4
    # in the order of the scan, and all over the region that the whole scan needs
    flat = schedule.flat[schedule.kinds == Kind.POSITION]
    order = PLAN.order_indices()
    place = {int(np.ravel_multi_index(tuple(p), PLAN.shape[:3])): k for k, p in enumerate(order)}
    assert [place[int(f)] for f in flat] == sorted(place[int(f)] for f in flat)
    report = verify(tmp_path / "s")
    assert report.ok and not report.never_taken and session.was_complete(0)
    record(tmp_path / "all", PLAN, rig_for(PLAN), WHOLE)
    assert schedule.roi == SessionFile.read(tmp_path / "all").schedule(0).roi
    with RecordingSource(tmp_path / "s") as source:
        assert source.metadata.kept_aside == [[2, 1, 1]] and len(source.metadata.darks) == 1
    made = drain(iter_assemble_session(tmp_path / "s"))
    assert {tuple(p) for p in np.argwhere(made.matrix.recorded > 0).tolist()} == set(CHOSEN)


def test_such_a_session_is_interrupted_and_resumed(tmp_path: Path) -> None:
    options = replace(CAREFUL, retries=0)
    with pytest.raises(AcquisitionStopped, match="2 of 5 positions are safe"):
        record(tmp_path / "s", PLAN, rig_for(PLAN, DeviceFault("times out", 2, 9)), options, only=CHOSEN)
    assert len(verify(tmp_path / "s").never_taken) == 3
    done = record(tmp_path / "s", PLAN, rig_for(PLAN), resume=True)
    assert done.how == "complete" and done.acknowledged == 5 and set(frames_of(tmp_path / "s")) == set(CHOSEN)


def test_further_positions_are_added(tmp_path: Path) -> None:
    record(tmp_path / "s", PLAN, rig_for(PLAN), WHOLE, only=CHOSEN[:3], kept_aside=CHOSEN[:1])
    before = frames_of(tmp_path / "s")
    drain(iter_finish(tmp_path / "s"))
    record(tmp_path / "s", PLAN, rig_for(PLAN), redo=CHOSEN[3:], kept_aside=CHOSEN[3:4])
    session = SessionFile.read(tmp_path / "s")
    assert session.kept_aside == (tuple(CHOSEN[0]), tuple(CHOSEN[3])) and len(session.recordings) == 2
    found = frames_of(tmp_path / "s")
    assert set(found) == set(CHOSEN) and verify(tmp_path / "s").ok
    assert_same_frames(before, {place: found[place] for place in before})


def test_an_interrupted_recording_of_as_many_positions_as_another_is_not_complete(tmp_path: Path) -> None:
    """What was never taken is not lost because another recording of the session had as many positions."""
    record(tmp_path / "s", PLAN, rig_for(PLAN), CAREFUL, only=CHOSEN[:2])
    with pytest.raises(AcquisitionStopped):
        faulty = rig_for(PLAN, DeviceFault("times out", 1, 99))
        record(tmp_path / "s", PLAN, faulty, replace(CAREFUL, retries=0), redo=CHOSEN[2:4])
    assert len(frames_of(tmp_path / "s")) == 3
    report = verify(tmp_path / "s")
    assert report.ok and len(report.never_taken) == 1
    session = SessionFile.read(tmp_path / "s")
    assert session.was_complete(0) and not session.was_complete(1)
    # a session of an older version does not say of which recording a run is
    data = json.loads((tmp_path / "s" / "session.json").read_text())
    for run in data["runs"]:
        del run["recording"]
    (tmp_path / "s" / "session.json").write_text(json.dumps(data))
    assert SessionFile.read(tmp_path / "s").was_complete(0)
    assert record(tmp_path / "s", PLAN, rig_for(PLAN), resume=True).how == "complete"


def test_what_it_costs(tmp_path: Path) -> None:
    some, every = (forecast(PLAN, rig_for(PLAN), CAREFUL, tmp_path / "s", only=only) for only in (CHOSEN, ()))
    assert some.positions == 5 and every.positions == 27 and some.recording_bytes < 0.2 * every.recording_bytes
    cost = Forecast.of(PLAN, positions=PLAN.in_scan_order(CHOSEN))
    assert some.seconds == pytest.approx(3600 * cost.hours) and cost.frames == 5
    steps = np.diff(PLAN.stage_um(PLAN.in_scan_order(CHOSEN)), axis=0)
    assert cost.move_hours * 3600 == pytest.approx(np.abs(steps).max(axis=1).sum() / 1000)
    assert (
        cost.exposure_hours * 3600 == pytest.approx(5 * 0.02)
        and cost.h_float32_bytes == Forecast.of(PLAN).h_float32_bytes
    )
    whole = Forecast.of(PLAN, positions=PLAN.order_indices())
    assert whole == Forecast.of(PLAN)
    uneven = replace(PLAN, exposure_s=(0.01, 0.02, 0.04))
    exposed = Forecast.of(uneven, positions=uneven.in_scan_order(CHOSEN)).exposure_hours
    assert exposed * 3600 == pytest.approx(2 * 0.01 + 0.02 + 2 * 0.04)


def test_every_exposure_is_read_out(tmp_path: Path) -> None:
    """Those of a bracket, of repetitions, and of dark frames; where the rate is not known, none is counted."""
    plan, options = replace(PLAN, frames_averaged=3), replace(CAREFUL, bracket=(1.0, 0.25), darks=4)
    without, known = (
        forecast(plan, rig_for(plan), options, tmp_path / "s", frames_per_s=rate) for rate in (None, 10.0)
    )
    lit = known.positions + known.other_frames - 1  # a dark frame at the start
    assert without.readout_seconds is None
    assert known.readout_seconds == pytest.approx(2 * (3 * lit + 4) / 10)
    assert known.seconds == pytest.approx(without.seconds + known.readout_seconds)


@pytest.mark.parametrize(("only", "what"), [([], "at least one"), ([Position(0, 0, 3)], r"inside \(3, 3, 3\)")])
def test_what_cannot_be_recorded_leaves_nothing(tmp_path: Path, only: list[Position], what: str) -> None:
    with pytest.raises(InputError, match=what):
        record(tmp_path / "s", PLAN, rig_for(PLAN), CAREFUL, only=only)
    assert not (tmp_path / "s").exists()


def test_the_list_keeps_what_is_kept_aside(tmp_path: Path) -> None:
    path = tmp_path / "list.json"
    RedoList.of(CHOSEN, ["why"], kept_aside=CHOSEN[1:3]).write(path)
    found = RedoList.read(path)
    assert found.positions == tuple(CHOSEN) and found.kept_aside == tuple(CHOSEN[1:3])
    RedoList.of(CHOSEN).write(path)
    assert "kept_aside" not in json.loads(path.read_text()) and RedoList.read(path).kept_aside == ()
    for wrong in ([[9, 9, 9]], [1], "x", [[True, 0, 0]]):
        path.write_text(
            json.dumps({"format": "lfcal-redo", "version": 1, "positions": [[0, 0, 0]], "kept_aside": wrong})
        )
        with pytest.raises(FileFormatError, match="positions"):
            RedoList.read(path)


def test_a_whole_scan_is_no_session_of_chosen_positions(tmp_path: Path) -> None:
    """Positions of it that are recorded again do not make a fit take all of it."""
    record(tmp_path / "s", PLAN, rig_for(PLAN), CAREFUL)
    record(tmp_path / "s", PLAN, rig_for(PLAN), redo=CHOSEN[:3], kept_aside=CHOSEN[:1])
    with RecordingSource(tmp_path / "s") as source:
        assert not source.metadata.kept_aside and len(source) == 27


def test_sessions_of_all_positions_stay_as_they_were(tmp_path: Path) -> None:
    record(tmp_path / "s", PLAN, rig_for(PLAN), CAREFUL)
    data = json.loads((tmp_path / "s" / "session.json").read_text())
    assert "kept_aside" not in data and all("recording" not in run for run in data["runs"])
