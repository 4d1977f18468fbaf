"""Sessions begun, paused, stopped, aborted, resumed, and recorded again."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire._forecast import forecast
from lfcal.acquire.control import Control
from lfcal.acquire.errors import AcquisitionStopped
from lfcal.acquire.finish import iter_assemble_session, iter_finish
from lfcal.acquire.options import Options
from lfcal.acquire.preview import Preview
from lfcal.acquire.recording._verify import verify
from lfcal.acquire.recording.recording_file import RecordingFile
from lfcal.acquire.recording.records import Kind
from lfcal.acquire.recording.source import RecordingSource, read_checks
from lfcal.acquire.redo import RedoList
from lfcal.acquire.session import iter_record, record
from lfcal.acquire.session_file import SessionFile
from lfcal.acquire.setup.live import levels
from lfcal.acquire.suspending import Bound, Suspender
from lfcal.base.errors import FileFormatError, InputError, StorageError
from lfcal.base.progress import Progress, drain
from lfcal.camera import Forecast, RegionPlan, StageAxes
from lfcal.devices.errors import DeviceError, DeviceLost, LimitError
from lfcal.devices.protocols import Frame, Gauge, Point, Roi, Setting
from lfcal.devices.rig import FileGauge, Rig
from lfcal.devices.simulated._camera import LightPatch, Renderer
from lfcal.devices.simulated._optics import PatternRenderer
from lfcal.devices.simulated._stage import StageModel
from lfcal.devices.simulated.faults import DeviceFault
from lfcal.frames import CorrectionRecipe, corrected_view
from lfcal.frames.described import sensor_noise
from lfcal.frames.source import FrameSource, Position
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, intercept, rig_for, small_plan, stopped
from tests.cli.conftest import Run

PLAN = small_plan()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    record(folder, PLAN, rig_for(PLAN), CAREFUL)
    return folder


def test_a_session_is_a_frame_source_with_its_plan_and_options(whole: Path) -> None:
    with RecordingSource(whole) as source:
        assert isinstance(source, FrameSource) and len(source) == 27
        assert (source.shape, source.dtype, source.metadata.bit_depth) == ((21, 21), np.uint16, 12)
        assert [source.info(k).position for k in range(27)] == sorted(PLAN.positions())
        y, x = source.info(5).position[1:]
        assert source.info(5).origin == (48 + y - 10, 48 + x - 10)
        assert (source.info(0).exposure_s, source.info(3).label) == (0.02, "recording.h5[3]")
    for frame in frames_of(whole).values():  # the cutouts follow the source: its image stays in the middle
        at = np.unravel_index(np.argmax(frame), frame.shape)
        assert np.all(np.abs(np.array(at) - 10) <= 3)
    data = json.loads((whole / "session.json").read_text())
    assert data["format"] == "lfcal-session" and data["devices"]["camera"] == "simulated camera"
    assert data["plan"] == json.loads(PLAN.to_json()) and Options.from_dict(data["options"]) == CAREFUL
    assert SessionFile.read(whole).plan == PLAN


@pytest.mark.parametrize("how", ["stop", "abort", "close"])
def test_a_session_that_was_stopped_aborted_or_closed_is_resumed(tmp_path: Path, whole: Path, how: str) -> None:
    threads = threading.active_count()
    if how == "close":
        work = iter_record(tmp_path, PLAN, rig_for(PLAN), CAREFUL)
        next(progress for progress in work if progress.done >= 6)
        work.close()
    else:
        outcome = stopped(tmp_path, PLAN, 6, how=how)
        assert outcome.how == {"stop": "stopped", "abort": "aborted"}[how]
        assert len(frames_of(tmp_path)) == outcome.acknowledged
    assert 6 <= len(frames_of(tmp_path)) < 16
    # how careful a session is may change
    patient = replace(CAREFUL, retries=9, tolerance_um=(2.0, 2.0, 9.0), order="coarse")
    assert record(tmp_path, PLAN, rig_for(PLAN), patient, resume=True).how == "complete"
    assert_same_frames(frames_of(tmp_path), frames_of(whole))
    assert SessionFile.read(tmp_path).runs[-1].how == "complete" and threading.active_count() <= threads
    with RecordingSource(tmp_path) as source:
        notes = sorted((source.record(k) for k in range(27)), key=lambda note: int(note["sequence"]))
    assert np.all(np.diff([float(note["elapsed_s"]) for note in notes]) > 0)


def test_a_paused_session_holds_with_all_frames_safe_and_resumes(tmp_path: Path, whole: Path) -> None:
    control, rig, held, moves = Control(), rig_for(PLAN), 0, -1
    for progress in iter_record(tmp_path / "s", PLAN, rig, CAREFUL, control=control):
        if progress.done >= 4 and not held:
            control.pause()
        if progress.note == "paused":
            held += 1
            assert control.held == "paused"
            if held == 2:
                moves = rig.stage.moves
                assert len(frames_of(tmp_path / "s")) == progress.done
            if held == 4:
                assert rig.stage.moves == moves
                control.resume()
    assert held >= 4 and control.held == ""
    assert_same_frames(frames_of(tmp_path / "s"), frames_of(whole))
    control.pause()
    threading.Timer(0.1, control.stop).start()
    outcome = record(tmp_path / "t", PLAN, rig_for(PLAN), CAREFUL, control=control)
    assert (outcome.how, outcome.acknowledged) == ("stopped", 0), "a paused session can be stopped"


def test_what_cannot_be_recorded_is_refused_before_anything_moves_or_is_made(tmp_path: Path) -> None:
    narrow = rig_for(PLAN, model=StageModel(limits=((-1e5, 1e5), (-1e5, 0.0), (-1e5, 1e5))))
    for plan, rig, error, words in (
        (PLAN, narrow, LimitError, "nothing was moved"),
        (small_plan(shape=(97, 96)), rig_for(PLAN), InputError, "sensor of simulated camera: expected 97 x 96 px"),
    ):
        with pytest.raises(error, match=words):
            record(tmp_path / "s", plan, rig, CAREFUL)
        assert rig.stage.moves == 0 and not list((tmp_path / "s").glob("*.h5")), words
        assert not (tmp_path / "s" / "session.json").exists(), words


def test_only_the_same_session_is_resumed(whole: Path, tmp_path: Path) -> None:
    before = (whole / "session.json").read_bytes()
    for change, named in (
        ({"plan": small_plan(settle_s=0.1)}, "plan.settle_s"),
        ({"plan": small_plan(stage=StageAxes(origin_um=(1.0, 0.0, 0.0)))}, "plan.stage.origin_um"),
        ({"plan": small_plan((3, 4))}, "plan.period"),
        ({"options": replace(CAREFUL, reference_every=5)}, "option reference_every"),
        ({"options": replace(CAREFUL, bracket=(1.0, 0.5))}, "option bracket"),
        ({"camera": "another camera"}, "devices.camera"),
        ({"stage": "another stage"}, "devices.stage"),
    ):
        plan: Any = change.get("plan", PLAN)
        rig = rig_for(plan)
        for device in change.keys() & {"camera", "stage"}:
            getattr(rig, device).name = change[device]
        with pytest.raises(InputError, match=named):
            record(whole, plan, rig, change.get("options", CAREFUL), resume=True)
        assert (whole / "session.json").read_bytes() == before, named
    stopped(tmp_path, PLAN, 3)
    (tmp_path / "recording.h5").write_bytes((whole / "recording.h5").read_bytes())
    with pytest.raises(FileFormatError, match="restore it from a copy"):
        record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, resume=True)


def moved_origin(plan: Any, px: float) -> Rig:
    """Return a rig whose stage lost its zero: its encoder does not show where the source is."""
    step = plan.camera.step_um(plan.depths_um[0])
    return rig_for(plan, axes=StageAxes(origin_um=(px * step, 0.0, 0.0)))


class Refocused:
    """Optics that were refocused: the image has the same place, and a third of the width."""

    optics = PatternRenderer.optics

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer

    def render(self, source_um: Point, exposure_s: float, roi: Roi) -> LightPatch:
        patch = self._renderer.render(source_um, exposure_s, roi)
        profiles = []
        for axis, size in ((1, patch.counts.shape[0]), (0, patch.counts.shape[1])):
            pixels, middle = np.arange(size), (size - 1) / 2
            line = patch.counts.sum(axis=axis, dtype=float)
            profiles.append(np.interp(3 * (pixels - middle) + middle, pixels, line, left=0.0, right=0.0))
        counts = np.multiply.outer(*profiles)
        return patch._replace(counts=(counts * (patch.counts.max() / counts.max())).astype(np.float32))


def test_a_resumed_session_detects_a_lost_origin_and_other_optics(tmp_path: Path) -> None:
    stopped(tmp_path, PLAN, 3)
    done = frames_of(tmp_path)
    refocused = rig_for(PLAN, optics=Refocused(PatternRenderer(PLAN)))
    for rig, words in (
        (moved_origin(PLAN, 2.0), r"moved by \(-?0\.\d+, -(1\.9|2\.0)\d\) px"),
        (refocused, r"expected a correlation above 0\.8, got 0\.[0-7]"),
    ):
        with pytest.raises(InputError, match=words):
            record(tmp_path, PLAN, rig, CAREFUL, resume=True)
        assert_same_frames(frames_of(tmp_path), done)
    record(tmp_path, PLAN, moved_origin(PLAN, 0.1), resume=True)
    assert len(frames_of(tmp_path)) == 27
    assert SessionFile.read(tmp_path).options == CAREFUL, "without others it has the options it began with"


def test_positions_recorded_again_replace_the_earlier_frames(tmp_path: Path, whole: Path) -> None:
    shutil.copytree(whole, tmp_path, dirs_exist_ok=True)
    again, control = [Position(0, 1, 2), Position(2, 0, 0)], Control()
    stop = lambda *_: control.stop()  # noqa: E731
    record(tmp_path, PLAN, rig_for(PLAN, seed=7), CAREFUL, redo=again, control=control, observers=(stop,))
    record(tmp_path, PLAN, rig_for(PLAN, seed=7), resume=True)
    session = SessionFile.read(tmp_path)
    assert session.recordings == ("recording.h5", "recording-002.h5") and session.options == CAREFUL
    old, new = frames_of(whole), frames_of(tmp_path)
    assert {key for key in old if not np.array_equal(old[key], new[key])} == set(again)


def test_nothing_is_recorded_over_a_session(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a new folder"):
        record(whole, PLAN, rig_for(PLAN), CAREFUL)
    with pytest.raises(StorageError, match="expected a session folder"):
        record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, resume=True)
    with pytest.raises(StorageError, match="expected a session folder"):
        record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, redo=[Position(0, 0, 0)])


def test_damaged_session_files_and_paths_out_of_the_folder_are_refused(tmp_path: Path, whole: Path) -> None:
    for text in ("", "{", "[]", '{"format": "lfcal-session", "version": 1}', '{"format": "x"}'):
        (tmp_path / "session.json").write_text(text)
        with pytest.raises(FileFormatError):
            SessionFile.read(tmp_path)
    data = json.loads((whole / "session.json").read_text())
    for names in (["../../other.h5"], [], ["recording.h5", "recording.h5"]):
        (tmp_path / "session.json").write_text(json.dumps({**data, "recordings": names, "redo": [[]] * len(names)}))
        with pytest.raises(FileFormatError, match="recordings"):
            RecordingSource(tmp_path)


def test_darks_references_controls_and_exposures_per_plane(tmp_path: Path) -> None:
    plan = small_plan(exposure_s=(0.01, 0.02, 0.04))
    options = replace(CAREFUL, darks=4, dark_every=9, reference_every=9, controls=1)
    record(tmp_path, plan, rig_for(plan), options)
    checks = read_checks(tmp_path)
    references = [c for c in checks if c.kind is Kind.REFERENCE]
    controls = [c for c in checks if c.kind is Kind.CONTROL]
    assert [c.position for c in references] == [Position(1, 1, 1)] * 4
    assert len(controls) == 12
    frames = frames_of(tmp_path)
    for control in controls:  # a periodic pattern looks the same whole periods away
        same = frames[tuple(control.position)]  # type: ignore[index]
        difference = np.abs(control.frame.astype(float) - same).sum() / (same - 64.0).clip(0).sum()
        assert difference < 0.35
    with RecordingSource(tmp_path) as recording:
        source = corrected_view(recording, CorrectionRecipe(exposure="none"), PLAN)
        assert source.dtype == np.float32
        assert {source.info(k).exposure_s for k in range(27)} == {0.01, 0.02, 0.04}
        corners = [source.read(k)[[0, 0, -1, -1], [0, -1, 0, -1]] for k in range(27)]
    assert abs(float(np.mean(corners))) < 1.5


class Watched:
    """A camera that reads more than it is asked for, and notes what it exposes in the dark."""

    def __init__(self, rig: Rig) -> None:
        self._camera, self._light = rig.camera, rig.light
        self.dark: list[tuple[float, Roi]] = []
        self.lit: set[tuple[float, Roi]] = set()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._camera, name)

    def set_roi(self, roi: Roi) -> Setting[Roi]:
        self._roi = self._camera.set_roi(Roi(roi.row - 3, roi.column - 1, roi.rows + 8, roi.columns + 8)).actual
        return Setting(roi, self._roi)

    def set_exposure(self, seconds: float) -> Setting[float]:
        self._seconds = seconds
        return self._camera.set_exposure(seconds)

    def grab(self, timeout_s: float) -> Frame:
        if self._light.on:  # type: ignore[union-attr]
            self.lit.add((self._seconds, self._roi))
        else:
            self.dark.append((self._seconds, self._roi))
        return self._camera.grab(timeout_s)


def test_darks_have_the_region_and_every_exposure_of_the_positions(tmp_path: Path) -> None:
    plan = small_plan(exposure_s=(0.01, 0.02, 0.04))
    rig = rig_for(plan)
    camera, switched = Watched(rig), list[bool]()
    rig = replace(rig, camera=camera)
    intercept(rig, "light", "switch", lambda works, on: (switched.append(on), works(on))[1])
    record(tmp_path, plan, rig, replace(CAREFUL, darks=3, bracket=(1.0, 0.5)))
    assert sorted(seconds for seconds, _ in set(camera.dark)) == [0.005, 0.01, 0.02, 0.04]
    assert set(camera.dark) == camera.lit and len(camera.dark) == 3 * 2 * 3, "each dark frame is a mean of three"
    assert switched == [False, True]
    with RecordingFile(tmp_path / "darks.h5") as darks, RecordingFile(tmp_path / "recording.h5") as recording:
        roi = Roi(int(darks.records["row"][0]), int(darks.records["column"][0]), *darks.layout.shape)
        assert darks.taken.tolist() == [True] * 3
        assert set(darks.records["exposure_s"]) == set(recording.records["exposure_s"])
        for note in recording.records:
            assert roi.holds(Roi(int(note["row"]), int(note["column"]), *recording.layout.shape))


@pytest.mark.parametrize("how", ["stop", "abort", "fault"])
def test_the_light_is_on_again_however_a_session_ends(tmp_path: Path, how: str) -> None:
    control, rig, grabbed = Control(), rig_for(PLAN), list[bool]()

    def interrupted(works: Any, timeout_s: float) -> Frame:
        grabbed.append(rig.light.on)
        if len(grabbed) == 3:
            if how == "fault":
                raise DeviceLost("camera: no answer; check the cable")
            getattr(control, how)()
        return works(timeout_s)

    intercept(rig, "camera", "grab", interrupted)
    with suppress(AcquisitionStopped):
        record(tmp_path, PLAN, rig, replace(CAREFUL, darks=8), control=control)
    assert not any(grabbed[:3]) and rig.light.on


def test_averaging_and_bracketing_record_floats(tmp_path: Path) -> None:
    plan = small_plan((2, 2), 1, frames_averaged=8)
    record(tmp_path / "mean", plan, rig_for(plan), CAREFUL)
    one = small_plan((2, 2), 1)
    record(tmp_path / "one", one, rig_for(one), CAREFUL)
    mean, single = frames_of(tmp_path / "mean"), frames_of(tmp_path / "one")
    assert mean[0, 0, 0].dtype == np.float32
    edge = np.s_[:2]
    assert mean[0, 0, 0][edge].std() < 0.6 * single[0, 0, 0][edge].std()
    with RecordingSource(tmp_path / "mean") as source:
        noise = source.samples(0).noise
        assert noise is not None and noise == sensor_noise(plan.camera.sensor).of_mean(8)
    with RecordingSource(tmp_path / "one") as source:
        assert source.samples(0).noise is None, "the plan's own, which the corrected view takes for raw samples"
    bright = small_plan((2, 2), 1, exposure_s=0.1)
    rig = rig_for(bright, optics=None)
    dim = rig_for(one)
    rig.camera.device._renderer = dim.camera._renderer  # type: ignore[attr-defined]
    record(tmp_path / "hdr", bright, rig, replace(CAREFUL, bracket=(1.0, 0.1)))
    merged = frames_of(tmp_path / "hdr")[0, 0, 0]
    assert merged.max() > 1.5 * 4095
    truth = 5 * (single[0, 0, 0] - 64.0) + 64
    assert np.abs(merged - truth).max() < 0.12 * truth.max()
    with RecordingSource(tmp_path / "hdr") as source:
        assert int(source.record(0)["saturated"]) == 0
        assert source.samples(0).noise is None, "a bracket has no one variance"


def test_only_the_preview_may_drop_frames(tmp_path: Path) -> None:
    preview = Preview(size=2)
    drain(iter_record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, preview=preview))
    assert preview.dropped == 25
    shown = preview.latest()
    assert shown is not None
    assert shown.cutout is not None
    assert shown.position == Position(2, 2, 2)
    assert shown.saturated == levels(shown.data, 4095).saturated
    assert preview.latest() is None
    last = frames_of(tmp_path)[2, 2, 2]
    top, left = shown.cutout.row - shown.roi.row, shown.cutout.column - shown.roi.column
    assert np.array_equal(shown.data[top : top + 21, left : left + 21], last)


# -- chosen positions: recorded, interrupted, resumed, extended ------------------------------------------
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


def test_a_session_of_chosen_positions_is_interrupted_and_resumed(tmp_path: Path) -> None:
    options = replace(CAREFUL, retries=0)
    with pytest.raises(AcquisitionStopped, match="2 of 5 positions are safe"):
        record(tmp_path / "s", PLAN, rig_for(PLAN, DeviceFault("times out", 2, 9)), options, only=CHOSEN)
    assert len(verify(tmp_path / "s").never_taken) == 3
    done = record(tmp_path / "s", PLAN, rig_for(PLAN), resume=True)
    assert done.how == "complete" and done.acknowledged == 5 and set(frames_of(tmp_path / "s")) == set(CHOSEN)


def test_further_positions_are_added_to_a_packed_session(tmp_path: Path) -> None:
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
    """Frames never taken are not called lost because another recording of the session had as many positions."""
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


def test_the_forecast_of_chosen_positions_counts_only_these(tmp_path: Path) -> None:
    some, every = (forecast(PLAN, rig_for(PLAN), CAREFUL, tmp_path / "s", only=only) for only in (CHOSEN, ()))
    assert some.positions == 5 and every.positions == 27 and some.recording_bytes < 0.2 * every.recording_bytes
    cost = Forecast.of(PLAN, positions=PLAN.in_scan_order(CHOSEN))
    assert some.seconds == pytest.approx(3600 * cost.hours) and cost.frames == 5
    steps = np.diff(PLAN.stage_um(PLAN.in_scan_order(CHOSEN)), axis=0)
    assert cost.move_hours * 3600 == pytest.approx(np.abs(steps).max(axis=1).sum() / 1000)
    assert cost.exposure_hours * 3600 == pytest.approx(5 * 0.02)
    assert cost.h_float32_bytes == Forecast.of(PLAN).h_float32_bytes
    assert Forecast.of(PLAN, positions=PLAN.order_indices()) == Forecast.of(PLAN)
    uneven = replace(PLAN, exposure_s=(0.01, 0.02, 0.04))
    exposed = Forecast.of(uneven, positions=uneven.in_scan_order(CHOSEN)).exposure_hours
    assert exposed * 3600 == pytest.approx(2 * 0.01 + 0.02 + 2 * 0.04)


def test_the_forecast_counts_the_readout_of_every_exposure(tmp_path: Path) -> None:
    """Exposures of a bracket, of repetitions, and of dark frames; without a known rate, none is counted."""
    plan, options = replace(PLAN, frames_averaged=3), replace(CAREFUL, bracket=(1.0, 0.25), darks=4)
    rates = (None, 10.0)
    without, known = (forecast(plan, rig_for(plan), options, tmp_path / "s", frames_per_s=rate) for rate in rates)
    lit = known.positions + known.other_frames - 1  # a dark frame at the start
    assert without.readout_seconds is None
    assert known.readout_seconds == pytest.approx(2 * (3 * lit + 4) / 10)
    assert known.seconds == pytest.approx(without.seconds + known.readout_seconds)


def test_choices_that_cannot_be_recorded_leave_nothing(tmp_path: Path) -> None:
    for only, what in (([], "at least one"), ([Position(0, 0, 3)], r"inside \(3, 3, 3\)")):
        with pytest.raises(InputError, match=what):
            record(tmp_path / "s", PLAN, rig_for(PLAN), CAREFUL, only=only)
        assert not (tmp_path / "s").exists()


def test_redo_lists_are_read_as_written_and_checked(tmp_path: Path) -> None:
    path = tmp_path / "list.json"
    RedoList.of(CHOSEN, ["why"], kept_aside=CHOSEN[1:3]).write(path)
    found = RedoList.read(path)
    assert found.positions == tuple(CHOSEN) and found.kept_aside == tuple(CHOSEN[1:3])
    RedoList.of([(0, 1, 2), (3, 4, 5)], ["missing"]).write(path)
    plain = {"format": "lfcal-redo", "version": 1, "positions": [[0, 1, 2], [3, 4, 5]], "reasons": ["missing", ""]}
    assert json.loads(path.read_text()) == plain and RedoList.read(path).kept_aside == ()
    kept = [{"kept_aside": wrong} for wrong in ([[9, 9, 9]], [1], "x", [[True, 0, 0]])]
    places = [{"positions": wrong} for wrong in ([[0, 1]], [[0, 1, 2.5]], [])]
    for change in (*kept, *places, {"version": 2}):
        path.write_text(json.dumps({**plain, **change}))
        with pytest.raises(FileFormatError, match="version" if "version" in change else "positions|reasons"):
            RedoList.read(path)
    for text in ("", "[]"):
        path.write_text(text)
        with pytest.raises(FileFormatError):
            RedoList.read(path)


def test_a_whole_scan_is_no_session_of_chosen_positions(tmp_path: Path) -> None:
    """Positions of it that are recorded again do not make a fit take all of it."""
    record(tmp_path / "s", PLAN, rig_for(PLAN), CAREFUL)
    data = json.loads((tmp_path / "s" / "session.json").read_text())
    assert "kept_aside" not in data and all("recording" not in run for run in data["runs"]), "the file is as before"
    record(tmp_path / "s", PLAN, rig_for(PLAN), redo=CHOSEN[:3], kept_aside=CHOSEN[:1])
    with RecordingSource(tmp_path / "s") as source:
        assert not source.metadata.kept_aside and len(source) == 27


# -- sessions that hold while a gauge is out of bounds ---------------------------------------------------
def test_bounds_are_read_and_others_refused() -> None:
    for text, bound in (
        ("temperature=20:22", Bound("temperature", 20, 22)),
        ("lamp=95:", Bound("lamp", low=95)),
        ("/lab/a=b.csv=:0.5", Bound("/lab/a=b.csv", high=0.5)),
    ):
        assert Bound.parse(text) == bound
    for text in ("", "temperature", "temperature=20", "=1:2", "t=:", "t=2:1", "t=nan:1", "t=a:b"):
        with pytest.raises(InputError, match=r"GAUGE=LOW:HIGH"):
            Options(suspend=(text,))


@pytest.mark.parametrize(("gauge", "fault"), [("temperature=20:22", "too warm"), ("lamp=95:105", "lamp low")])
def test_a_session_holds_and_resumes_automatically(tmp_path: Path, gauge: str, fault: str) -> None:
    record(tmp_path / "usual", PLAN, rig_for(PLAN), CAREFUL)
    rig = rig_for(PLAN, DeviceFault(fault, 1, 5))
    assert all(isinstance(one, Gauge) for one in rig.gauges)
    shown: list[Progress] = []
    options = replace(CAREFUL, suspend=(gauge,), steady_s=3.0)
    outcome = drain(iter_record(tmp_path / "held", PLAN, rig, options), shown.append)
    held = [(one.done, one.note) for one in shown if one.note]
    assert outcome.how == "complete" and SessionFile.read(tmp_path / "held").options == options
    # what is under way when it begins to hold is acknowledged then
    assert held and 0 < held[1][0] < 27, "it began, held in between, and continued"
    assert len({done for done, _ in held[1:]}) == 1, "nothing is recorded while it holds"
    assert gauge.partition("=")[0] in held[0][1] and "outside" in held[0][1]
    assert "continues in" in held[-1][1]
    assert_same_frames(frames_of(tmp_path / "held"), frames_of(tmp_path / "usual"))
    # a reading each second: five bad ones, then three seconds within
    assert outcome.seconds < 8 < rig.time.monotonic(), "the time that was held is no recording time"


def test_the_file_of_a_logger_is_a_gauge(tmp_path: Path) -> None:
    file = tmp_path / "room.csv"
    file.write_text("time, T\n2026-05-04 12:00:03, 21.5\n2026-05-04 12:00:04, 2")
    assert FileGauge(file).read() == 21.5, "the last line is half written"
    rig = rig_for(PLAN)
    suspended = Suspender(rig, (Bound(str(file), 20, 22),), 0.0)
    assert suspended() == ""
    for text, words in (("27.5\n", "27.5, outside 20 to 22"), ("no number\n", "a last line with a number")):
        file.write_text(text)
        rig.time.sleep(2)
        assert words in suspended()
    file.unlink()
    rig.time.sleep(2)
    assert "cannot be read" in suspended()
    file.write_text("21\n")
    rig.time.sleep(2)
    assert suspended() == ""
    with pytest.raises(DeviceError, match="cannot be read"):
        FileGauge(tmp_path / "none").read()


def test_an_unknown_gauge_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"temperature, lamp.*humidity"):
        record(tmp_path / "s", PLAN, rig_for(PLAN), replace(CAREFUL, suspend=("humidity=0:50",)))
    assert not (tmp_path / "s").exists()


# -- cameras that change pixel values automatically: refused, or recorded with a note -------------------------
ONE = small_plan(planes=1)
ALLOWED = replace(CAREFUL, allow_automatic=True, on_suspect="flag")
REFUSED = r"of simulated camera: expected frames proportional to light, got GainAuto = Continuous, Gamma = 2\.2; switch"


def devices_in(folder: Path) -> dict[str, Any]:
    devices: dict[str, Any] = json.loads((folder / "session.json").read_text())["devices"]
    return devices


def rig_with(settings: dict[str, Setting[str | None]] | None) -> Rig:
    """Return a simulated rig whose camera gives these settings, or has no such method."""
    rig = rig_for(ONE)
    camera: Any = rig.camera
    camera.device.fixed_settings = None if settings is None else lambda: settings
    return rig


def test_a_camera_that_stays_automatic_is_refused_before_anything_moves(tmp_path: Path) -> None:
    with rig_for(ONE, automatic=("GainAuto", "Gamma")) as rig:
        for refused in (
            lambda: record(tmp_path / "s", ONE, rig, CAREFUL),
            lambda: forecast(ONE, rig, CAREFUL, tmp_path / "s"),
        ):
            with pytest.raises(InputError, match=REFUSED):
                refused()
        assert not (tmp_path / "s").exists()
        assert rig.stage.moves == 0  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("automatic", "options"), [(("GainAuto", "Gamma"), ALLOWED), ((), CAREFUL)], ids=["allowed", "off"]
)
def test_settings_are_recorded_with_the_session_and_with_h(
    tmp_path: Path, automatic: tuple[str, ...], options: Options
) -> None:
    with rig_for(ONE, automatic=automatic) as rig:
        assert forecast(ONE, rig, options, tmp_path / "s").positions == ONE.n_positions
        assert record(tmp_path / "s", ONE, rig, options).how == "complete"
    gain, gamma = ("Continuous", "2.2") if automatic else ("Off", "1")
    settings = {"ExposureAuto": "Off", "GainAuto": gain, "Gamma": gamma, "Gain": "0"}
    session = SessionFile.read(tmp_path / "s")
    assert session.options.allow_automatic is bool(automatic) and session.devices.automatic == automatic
    with drain(iter_assemble_session(tmp_path / "s", tmp_path / "H.h5")).matrix as matrix:
        for noted in (devices_in(tmp_path / "s"), matrix.provenance["devices"]):
            assert noted["settings"] == settings and tuple(noted.get("automatic", ())) == automatic


def test_a_camera_without_the_method_is_recorded(tmp_path: Path) -> None:
    stopped(tmp_path / "s", ONE, 1, rig=rig_with(None))
    assert not {"settings", "automatic"} & set(devices_in(tmp_path / "s"))
    assert SessionFile.read(tmp_path / "s").devices.settings == {}
    # as were sessions of older versions: they are resumed with a camera that states its settings
    with pytest.raises(InputError, match="GainAuto = Continuous"):
        record(tmp_path / "s", ONE, rig_for(ONE, automatic=("GainAuto",)), resume=True)
    assert record(tmp_path / "s", ONE, rig_for(ONE), resume=True).how == "complete"


@pytest.mark.parametrize(
    ("before", "now", "named"),
    [
        ((), ("GainAuto",), r"devices\.settings\.GainAuto: expected Off as recorded, got Continuous"),
        (("GainAuto",), (), r"devices\.settings\.GainAuto: expected Continuous as recorded, got Off"),
        (("GainAuto",), ("Gamma",), r"devices\.settings\.GainAuto: expected Continuous as recorded, got Off"),
    ],
)
def test_a_session_is_resumed_with_the_settings_and_permission_it_began_with(
    tmp_path: Path, before: tuple[str, ...], now: tuple[str, ...], named: str
) -> None:
    stopped(tmp_path / "s", ONE, 1, ALLOWED, rig_for(ONE, automatic=before))
    with pytest.raises(InputError, match=named):
        record(tmp_path / "s", ONE, rig_for(ONE, automatic=now), ALLOWED, resume=True)
    if before:
        with pytest.raises(InputError, match="expected frames proportional to light, got GainAuto = Continuous"):
            record(tmp_path / "s", ONE, rig_for(ONE, automatic=before), CAREFUL, resume=True)
    assert record(tmp_path / "s", ONE, rig_for(ONE, automatic=before), resume=True).how == "complete"
    assert len(frames_of(tmp_path / "s")) == ONE.n_positions


def test_only_automatic_values_may_differ_when_a_session_is_resumed(tmp_path: Path) -> None:
    def rig(automatic: str, gain: str) -> Rig:
        return rig_with({"GainAuto": Setting("Off", automatic), "Gain": Setting(None, gain)})

    stopped(tmp_path / "auto", ONE, 1, ALLOWED, rig("Continuous", "3.1"))
    assert record(tmp_path / "auto", ONE, rig("Continuous", "2.7"), resume=True).how == "complete"
    stopped(tmp_path / "off", ONE, 1, CAREFUL, rig("Off", "3.1"))
    with pytest.raises(InputError, match=r"devices\.settings\.Gain: expected 3\.1 as recorded, got 2\.7"):
        record(tmp_path / "off", ONE, rig("Off", "2.7"), resume=True)


def test_settings_of_a_crafted_session_are_refused(tmp_path: Path) -> None:
    stopped(tmp_path, ONE, 1)
    whole = (tmp_path / "session.json").read_text()
    for change in ({"settings": [1]}, {"settings": {"Gain": 1}}, {"automatic": ["GainAuto", "Focus"]}):
        data = json.loads(whole)
        data["devices"] |= change
        (tmp_path / "session.json").write_text(json.dumps(data))
        with pytest.raises(FileFormatError, match="settings: expected names"):
            SessionFile.read(tmp_path)


@pytest.mark.parametrize("regions", [False, pytest.param(True, marks=pytest.mark.long)])
def test_acquire_refuses_and_records_with_permission(tmp_path: Path, lfcal: Callable[..., Run], regions: bool) -> None:
    plan, out = tmp_path / "plan.json", tmp_path / "s"
    two = RegionPlan(ONE, ("a", "b"), (ONE.anchor, (30.0, 30.0)))
    plan.write_text(two.to_json() if regions else ONE.to_json())
    command = ("acquire", plan, "-o", out, "--darks", 0, "--on-suspect", "flag", "--no-check-origin")
    assert "ExposureAuto" in lfcal(*command, "--option", "automatic=Focus").err, "the option names its choices"
    automatic = ("--option", "optics=pattern", "--option", "automatic=GainAuto")
    for more in ((), ("--dry-run",), ("--no-check-stage",)):
        refused = lfcal(*command, *automatic, *more)
        assert refused.code == 2 and "got GainAuto = Continuous; switch this off" in refused.err
        assert "--allow-automatic" in refused.err and not out.exists()
    done = lfcal(*command, *automatic, "--allow-automatic", "--no-check-stage")
    assert done.code == 0 and "note: GainAuto = Continuous: frames, and an H made from them," in done.err
    folder = out / "a" if regions else out
    assert devices_in(folder)["automatic"] == ["GainAuto"]
    # the permission is of the session, which shows it
    assert lfcal(*command, *automatic, "--resume").code == 0
    assert "camera: GainAuto = Continuous: frames may not be proportional to light" in lfcal("status", folder).out
    assert lfcal("status", folder, "--json").json["automatic"] == {"GainAuto": "Continuous"}
