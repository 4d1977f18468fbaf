"""Sessions begun, paused, stopped, aborted, resumed, redone."""

from __future__ import annotations

import json
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire.control import Control
from lfcal.acquire.errors import AcquisitionStopped
from lfcal.acquire.options import Options
from lfcal.acquire.preview import Preview
from lfcal.acquire.recording.recording_file import RecordingFile
from lfcal.acquire.recording.records import Kind
from lfcal.acquire.recording.source import RecordingSource, read_checks
from lfcal.acquire.session import iter_record, record
from lfcal.acquire.session_file import SessionFile
from lfcal.acquire.setup.live import levels
from lfcal.base.errors import FileFormatError, InputError, StorageError
from lfcal.base.progress import drain
from lfcal.camera import StageAxes
from lfcal.devices.errors import DeviceLost, LimitError
from lfcal.devices.protocols import Frame, Point, Roi, Setting
from lfcal.devices.rig import Rig
from lfcal.devices.simulated._camera import LightPatch, Renderer
from lfcal.devices.simulated._optics import PatternRenderer
from lfcal.frames import CorrectionRecipe, corrected_view
from lfcal.frames.described import sensor_noise
from lfcal.frames.source import FrameSource, Position
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, rig_for, small_plan

PLAN = small_plan()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    record(folder, PLAN, rig_for(PLAN), CAREFUL)
    return folder


def stop_after(count: int, control: Control, how: str = "stop") -> Any:
    seen = []

    def observer(*_: object) -> None:
        seen.append(1)
        if len(seen) == count:
            getattr(control, how)()

    return observer


def test_a_session_is_a_frame_source(whole: Path) -> None:
    with RecordingSource(whole) as source:
        assert isinstance(source, FrameSource)
        assert source.shape == (21, 21)
        assert source.dtype == np.uint16
        assert len(source) == 27
        assert [source.info(k).position for k in range(27)] == sorted(PLAN.positions())
        row, column = source.info(5).origin
        y, x = source.info(5).position[1:]
        assert (row, column) == (48 + y - 10, 48 + x - 10)
        assert source.info(0).exposure_s == 0.02
        assert source.info(3).label == "recording.h5[3]"
        assert source.metadata.bit_depth == 12


def test_cutouts_follow_the_source(whole: Path) -> None:
    """The brightest pixel stays near the middle of every cutout though the source moves."""
    for frame in frames_of(whole).values():
        at = np.unravel_index(np.argmax(frame), frame.shape)
        assert np.all(np.abs(np.array(at) - 10) <= 3)


@pytest.mark.parametrize("how", ["stop", "abort"])
def test_stop_and_abort_end_and_can_be_resumed(tmp_path: Path, whole: Path, how: str) -> None:
    control = Control()
    outcome = record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, control=control, observers=(stop_after(6, control, how),))
    assert outcome.how == {"stop": "stopped", "abort": "aborted"}[how]
    assert 6 <= outcome.acknowledged < 16
    assert len(frames_of(tmp_path)) == outcome.acknowledged
    assert record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, resume=True).how == "complete"
    assert_same_frames(frames_of(tmp_path), frames_of(whole))
    runs = SessionFile.read(tmp_path).runs
    assert [run.how for run in runs] == [outcome.how, "complete"]
    with RecordingSource(tmp_path) as source:
        elapsed = sorted(float(source.record(k)["elapsed_s"]) for k in range(27))
    assert np.all(np.diff(elapsed) > 0)


def test_pause_holds_with_everything_safe_and_resume_goes_on(tmp_path: Path, whole: Path) -> None:
    control = Control()
    rig = rig_for(PLAN)
    work = iter_record(tmp_path, PLAN, rig, CAREFUL, control=control, observers=(stop_after(4, control, "pause"),))
    held = 0
    moves = -1
    for progress in work:
        if progress.note == "paused":
            held += 1
            assert control.held == "paused"
            if held == 2:
                moves = rig.stage.moves  # type: ignore[attr-defined]
                assert len(frames_of(tmp_path)) == progress.done
            if held == 4:
                assert rig.stage.moves == moves  # type: ignore[attr-defined]
                control.resume()
    assert held >= 4
    assert control.held == ""
    assert_same_frames(frames_of(tmp_path), frames_of(whole))


def test_stop_is_heard_while_paused(tmp_path: Path) -> None:
    control = Control()
    control.pause()
    threading.Timer(0.1, control.stop).start()
    outcome = record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, control=control)
    assert (outcome.how, outcome.acknowledged) == ("stopped", 0)


def test_closing_the_work_ends_the_session_in_order(tmp_path: Path, whole: Path) -> None:
    work = iter_record(tmp_path, PLAN, rig_for(PLAN), CAREFUL)
    for progress in work:
        if progress.done >= 5:
            break
    work.close()
    assert 5 <= len(frames_of(tmp_path)) < 27
    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, resume=True)
    assert_same_frames(frames_of(tmp_path), frames_of(whole))


def test_low_disk_holds_until_there_is_space(tmp_path: Path, whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lfcal.acquire import session as session_module

    class Low:
        def __init__(self, *_: object) -> None:
            self.calls = 0

        def __call__(self) -> str:
            self.calls += 1
            return "disk low: free some space" if 5 < self.calls < 9 else ""

    monkeypatch.setattr(session_module, "DiskGuard", Low)
    notes = [p.note for p in iter_record(tmp_path, PLAN, rig_for(PLAN), CAREFUL) if p.note]
    assert notes
    assert set(notes) == {"disk low: free some space"}
    assert_same_frames(frames_of(tmp_path), frames_of(whole))


def test_disk_that_cannot_hold_the_session_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    huge = small_plan((200, 200), 3, cutout=(1501, 1501), shape=(2400, 2400))
    with pytest.raises(StorageError, match="disk space for the recording"):
        record(tmp_path / "s", huge, rig_for(huge), CAREFUL)
    assert not list((tmp_path / "s").glob("*.h5"))
    assert not (tmp_path / "s" / "session.json").exists()


def test_limits_are_checked_before_anything_moves_or_is_made(tmp_path: Path) -> None:
    from lfcal.devices.simulated._stage import StageModel

    rig = rig_for(PLAN, model=StageModel(limits=((-1e5, 1e5), (-1e5, 0.0), (-1e5, 1e5))))
    with pytest.raises(LimitError, match="nothing was moved"):
        record(tmp_path / "s", PLAN, rig, CAREFUL)
    assert rig.stage.moves == 0  # type: ignore[attr-defined]
    assert not list((tmp_path / "s").glob("*.h5"))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"plan": small_plan(settle_s=0.1)}, "plan.settle_s"),
        ({"plan": small_plan(stage=StageAxes(origin_um=(1.0, 0.0, 0.0)))}, "plan.stage.origin_um"),
        ({"plan": small_plan((3, 4))}, "plan.period"),
        ({"options": replace(CAREFUL, reference_every=5)}, "option reference_every"),
        ({"options": replace(CAREFUL, bracket=(1.0, 0.5))}, "option bracket"),
        ({"camera": "another camera"}, "devices.camera"),
        ({"stage": "another stage"}, "devices.stage"),
    ],
)
def test_resume_takes_only_the_same_session(whole: Path, change: dict[str, Any], named: str) -> None:
    plan = change.get("plan", PLAN)
    rig = rig_for(plan)
    for device in ("camera", "stage"):
        if device in change:
            getattr(rig, device).name = change[device]
    before = (whole / "session.json").read_bytes()
    with pytest.raises(InputError, match=named):
        record(whole, plan, rig, change.get("options", CAREFUL), resume=True)
    assert (whole / "session.json").read_bytes() == before


def test_resume_may_change_how_careful_it_is(tmp_path: Path) -> None:
    control = Control()
    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, control=control, observers=(stop_after(3, control),))
    patient = replace(CAREFUL, retries=9, tolerance_um=(2.0, 2.0, 9.0), order="coarse")
    assert record(tmp_path, PLAN, rig_for(PLAN), patient, resume=True).how == "complete"


def moved_origin(plan: Any, px: float) -> Rig:
    """Return a rig whose stage lost its zero: the source stands elsewhere than its encoder says."""
    step = plan.camera.step_um(plan.depths_um[0])
    return rig_for(plan, axes=StageAxes(origin_um=(px * step, 0.0, 0.0)))


def test_resume_sees_a_lost_origin(tmp_path: Path) -> None:
    control = Control()
    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, control=control, observers=(stop_after(3, control),))
    done = frames_of(tmp_path)
    with pytest.raises(InputError, match=r"moved by \(-?0\.\d+, -(1\.9|2\.0)\d\) px"):
        record(tmp_path, PLAN, moved_origin(PLAN, 2.0), CAREFUL, resume=True)
    assert_same_frames(frames_of(tmp_path), done)
    record(tmp_path, PLAN, moved_origin(PLAN, 0.1), CAREFUL, resume=True)
    assert len(frames_of(tmp_path)) == 27


class Refocused:
    """Optics that somebody refocused: the image stands where it was, a third as wide."""

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


def test_resume_sees_optics_that_changed_though_the_image_stands_where_it_was(tmp_path: Path) -> None:
    control = Control()
    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, control=control, observers=(stop_after(3, control),))
    done = frames_of(tmp_path)
    rig = rig_for(PLAN, optics=Refocused(PatternRenderer(PLAN)))
    with pytest.raises(InputError, match=r"expected a correlation above 0\.8, got 0\.[0-7]"):
        record(tmp_path, PLAN, rig, CAREFUL, resume=True)
    assert_same_frames(frames_of(tmp_path), done)


def test_redo_records_some_positions_again_and_the_later_frame_counts(tmp_path: Path, whole: Path) -> None:
    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL)
    again = [Position(0, 1, 2), Position(2, 0, 0)]
    control = Control()
    record(
        tmp_path, PLAN, rig_for(PLAN, seed=7), CAREFUL, redo=again, control=control, observers=(stop_after(1, control),)
    )
    record(tmp_path, PLAN, rig_for(PLAN, seed=7), CAREFUL, resume=True)
    assert SessionFile.read(tmp_path).recordings == ("recording.h5", "recording-002.h5")
    old, new = frames_of(whole), frames_of(tmp_path)
    assert {key for key in old if not np.array_equal(old[key], new[key])} == set(again)


def test_nothing_is_recorded_over_a_session(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a new folder"):
        record(whole, PLAN, rig_for(PLAN), CAREFUL)
    with pytest.raises(StorageError, match="expected a session folder"):
        record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, resume=True)
    with pytest.raises(StorageError, match="expected a session folder"):
        record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, redo=[Position(0, 0, 0)])


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": "lfcal-session", "version": 1}', '{"format": "x"}'])
def test_damaged_session_files_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "session.json").write_text(text)
    with pytest.raises(FileFormatError):
        SessionFile.read(tmp_path)


def test_names_that_lead_out_of_the_folder_are_refused(tmp_path: Path, whole: Path) -> None:
    data = json.loads((whole / "session.json").read_text())
    for names in (["../../other.h5"], [], ["recording.h5", "recording.h5"]):
        (tmp_path / "session.json").write_text(json.dumps({**data, "recordings": names, "redo": [[]] * len(names)}))
        with pytest.raises(FileFormatError, match="recordings"):
            RecordingSource(tmp_path)


def test_a_recording_of_another_session_is_refused(tmp_path: Path, whole: Path) -> None:
    control = Control()
    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, control=control, observers=(stop_after(3, control),))
    (tmp_path / "recording.h5").write_bytes((whole / "recording.h5").read_bytes())
    with pytest.raises(FileFormatError, match="restore it from a copy"):
        record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, resume=True)


def test_wrong_camera_is_refused(tmp_path: Path) -> None:
    other = small_plan(shape=(97, 96))
    with pytest.raises(InputError, match="sensor of simulated camera: expected 97 x 96 px"):
        record(tmp_path, other, rig_for(PLAN), CAREFUL)


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
    camera = Watched(rig)
    rig = replace(rig, camera=camera)
    switched: list[bool] = []
    switch = rig.light.device.switch  # type: ignore[union-attr]
    rig.light.device.switch = lambda on: (switched.append(on), switch(on))[1]  # type: ignore[union-attr, method-assign]
    record(tmp_path, plan, rig, replace(CAREFUL, darks=3, bracket=(1.0, 0.5)))
    assert sorted(seconds for seconds, _ in set(camera.dark)) == [0.005, 0.01, 0.02, 0.04]
    assert set(camera.dark) == camera.lit
    assert len(camera.dark) == 3 * 2 * 3
    assert switched == [False, True]
    with RecordingFile(tmp_path / "darks.h5") as darks, RecordingFile(tmp_path / "recording.h5") as recording:
        roi = Roi(int(darks.records["row"][0]), int(darks.records["column"][0]), *darks.layout.shape)
        assert darks.taken.tolist() == [True] * 3
        assert set(darks.records["exposure_s"]) == set(recording.records["exposure_s"])
        for note in recording.records:
            assert roi.holds(Roi(int(note["row"]), int(note["column"]), *recording.layout.shape))


@pytest.mark.parametrize("count", [1, 5])
def test_a_dark_frame_is_the_mean_of_as_many_as_were_asked_for(tmp_path: Path, count: int) -> None:
    rig = rig_for(PLAN)
    camera = Watched(rig)
    record(tmp_path, PLAN, replace(rig, camera=camera), replace(CAREFUL, darks=count))
    assert len(camera.dark) == count
    with RecordingSource(tmp_path) as source:
        assert sorted(source.metadata.darks) == [0.02]


@pytest.mark.parametrize("how", ["stop", "abort", "fault"])
def test_the_light_is_on_again_however_a_session_ends(tmp_path: Path, how: str) -> None:
    control, rig = Control(), rig_for(PLAN)
    grab, grabbed = rig.camera.device.grab, []  # type: ignore[attr-defined]

    def interrupted(timeout_s: float) -> Frame:
        grabbed.append(rig.light.on)  # type: ignore[union-attr]
        if len(grabbed) == 3:
            if how == "fault":
                raise DeviceLost("camera: no answer; check the cable")
            getattr(control, how)()
        return grab(timeout_s)

    rig.camera.device.grab = interrupted  # type: ignore[attr-defined]
    with suppress(AcquisitionStopped):
        record(tmp_path, PLAN, rig, replace(CAREFUL, darks=8), control=control)
    assert not any(grabbed[:3])
    assert rig.light.on  # type: ignore[union-attr]


def test_a_session_goes_on_with_its_own_options_unless_others_are_given(tmp_path: Path) -> None:
    control = Control()
    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, control=control, observers=(stop_after(3, control),))
    assert record(tmp_path, PLAN, rig_for(PLAN), resume=True).how == "complete"
    record(tmp_path, PLAN, rig_for(PLAN), redo=[Position(0, 0, 0)])
    assert SessionFile.read(tmp_path).options == CAREFUL


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


def test_session_json_tells_what_was_recorded(whole: Path) -> None:
    data = json.loads((whole / "session.json").read_text())
    assert data["format"] == "lfcal-session"
    assert data["plan"] == json.loads(PLAN.to_json())
    assert data["devices"]["camera"] == "simulated camera"
    assert Options.from_dict(data["options"]) == CAREFUL
    assert SessionFile.read(whole).plan == PLAN


def test_no_thread_is_left_behind(tmp_path: Path) -> None:
    before = threading.active_count()
    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL)
    assert threading.active_count() == before
