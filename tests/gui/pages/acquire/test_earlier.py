"""A session opened again shows what all its runs recorded, read from its files."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.acquire.control import Control
from lfcal.acquire.earlier import EarlierFrames
from lfcal.acquire.live_coverage import LiveCoverage
from lfcal.acquire.live_quality import LiveQuality, QualityState
from lfcal.acquire.schedule import window_shape
from lfcal.acquire.session import record
from lfcal.base.errors import LfcalError
from lfcal.devices.simulated._targets import TargetPattern
from lfcal.devices.simulated.backend import simulated_rig
from lfcal.devices.simulated.faults import DeviceFault
from lfcal.frames.source import Position
from lfcal_gui.context import Context
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.model_folder import folder_state
from lfcal_gui.pages.acquire.model_recorder import Recorder, coverage_picture, record_picture
from lfcal_gui.pages.acquire.page import Page
from tests.acquire.rigs import CAREFUL, rig_for, small_plan
from tests.acquire.test_live_coverage import small_target
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle

PLAN = small_plan((3, 4), 2, settle_s=0.0)


@pytest.fixture
def state() -> ProjectState:
    settings = AcquireSettings(device_options=(("optics", "pattern"),), darks=0, reference_every=0)
    return ProjectState(camera=PLAN.camera, plan=PLAN, settings={"acquire": settings.to_dict()})


def recorded(folder: Path, *, redo: bool = False) -> QualityState:
    """Record `PLAN` in two runs, and with ``redo`` a position again; return what was seen of the two."""
    live, control = LiveQuality(PLAN, window_shape(PLAN, CAREFUL)), Control()

    def enough(*_: object) -> None:
        if live.state().done == 7:
            control.stop()

    record(folder, PLAN, rig_for(PLAN), CAREFUL, control=control, observers=(live, enough))
    record(folder, PLAN, rig_for(PLAN), None, resume=True, observers=(live,))
    if redo:
        record(folder, PLAN, rig_for(PLAN), None, redo=[Position(0, 1, 2)])
    return live.state()


def read_again(folder: Path, z: int, **options: float | Callable[[], float]) -> tuple[QualityState, EarlierFrames]:
    quality = LiveQuality(PLAN, window_shape(PLAN, CAREFUL))
    earlier = EarlierFrames(folder, quality, folder_state(str(folder)).known(), **options)  # type: ignore[arg-type]
    assert earlier.want(z) and not earlier.want(z)
    earlier.read(z)
    return quality.state(z), earlier


@pytest.mark.parametrize("z", [0, 1])
def test_all_runs_are_read_as_they_were_seen(tmp_path: Path, z: int) -> None:
    live = recorded(tmp_path)
    found, earlier = read_again(tmp_path, z)
    np.testing.assert_allclose(found.energy[z], live.energy[z], rtol=1e-9)
    np.testing.assert_allclose(found.energy, live.energy, rtol=0.02)  # of other planes the background is sampled
    np.testing.assert_allclose(found.residual_px, live.residual_px, rtol=1e-5)
    np.testing.assert_array_equal(found.saturated, live.saturated)
    summed = earlier.sum_of(z)
    assert summed is not None and summed.ended and summed.words == ""
    np.testing.assert_allclose(summed.light, live.depth_sums[z], atol=1e-6)
    assert {a.kind for a in found.alarms} == {a.kind for a in live.alarms}


def test_a_position_recorded_again_counts_once(tmp_path: Path) -> None:
    live = recorded(tmp_path, redo=True)
    _, earlier = read_again(tmp_path, 0)
    summed = earlier.sum_of(0)
    assert summed is not None and (summed.read, summed.total) == (12, 12)
    np.testing.assert_allclose(summed.light.sum(), live.depth_sums[0].sum(), rtol=0.05)
    folder = folder_state(str(tmp_path))
    known = folder.known([Position(0, 1, 2)])
    assert known is not None and len(known.flat) == 23 and 6 not in known.flat


def test_a_slow_disk_ends_the_reading_with_a_part_of_the_plane(tmp_path: Path) -> None:
    recorded(tmp_path)
    ticks = count()
    found, earlier = read_again(tmp_path, 0, seconds=4.5, clock=lambda: float(next(ticks)))
    summed = earlier.sum_of(0)
    assert np.isfinite(found.energy).all(), "records are read whatever the frames take"
    assert summed is not None and summed.ended and summed.words == "5 of 12 frames"


def test_a_damaged_frame_is_left_out_and_counted(tmp_path: Path) -> None:
    recorded(tmp_path)
    with open(tmp_path / "recording.h5", "r+b") as file:
        from lfcal.acquire.recording.recording_file import read_layout

        layout = read_layout(tmp_path / "recording.h5")
        file.seek(layout.frames_at + 3 * layout.frame_bytes + 10)
        file.write(b"\xff\x00\xff")
    _, earlier = read_again(tmp_path, 0)
    summed = earlier.sum_of(0)
    assert summed is not None and summed.words == "11 of 12 frames" and summed.damaged == 1


def test_reading_ends_for_another_plane_and_for_a_window_that_closes(tmp_path: Path) -> None:
    recorded(tmp_path)
    earlier = EarlierFrames(
        tmp_path, LiveQuality(PLAN, window_shape(PLAN, CAREFUL)), folder_state(str(tmp_path)).known()
    )
    assert earlier.want(0) and earlier.want(1)
    earlier.read(0)
    assert earlier.sum_of(0) is None
    earlier.read(1, lambda: False)
    assert earlier.sum_of(1) is None
    assert earlier.want(0)
    earlier.read(0)
    assert earlier.want(1) and not earlier.want(0), "a plane that is read is kept"


def test_the_light_of_a_targets_frames_is_read(tmp_path: Path) -> None:
    plan = small_target()
    live, again = LiveCoverage(plan), LiveCoverage(plan)
    rig = simulated_rig(plan.scan, optics=TargetPattern(plan.scan, plan.target, np.full(9, 1.0)))
    record(tmp_path, plan, rig, CAREFUL, observers=(live,))
    earlier = EarlierFrames(tmp_path, again, folder_state(str(tmp_path)).known())
    assert earlier.want(1)
    earlier.read(1)
    picture, want = coverage_picture(again.state(), 1), coverage_picture(live.state(), 1)
    np.testing.assert_array_equal(picture.values, want.values)
    np.testing.assert_allclose(picture.curves["energy"][1], want.curves["energy"][1], rtol=0.02)
    assert picture.done == 8 and not earlier.want(0)


def opened(page: Page, context: Context, qtbot: QtBot, folder: Path) -> Page:
    page.panel.setCurrentWidget(page.panel.record)
    page.record.folder_choice.take(str(folder))
    qtbot.waitUntil(lambda: page.record.folder.there is not None, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    return page


def test_a_finished_session_opened_again_shows_its_own_state(
    open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    live = recorded(tmp_path / "s")
    page = opened(open_page("acquire"), context, qtbot, tmp_path / "s")
    pictures = page.panel.record.pictures
    for z in (0, 1):
        page.panel.record.strip.setCurrentRow(z)
        idle(context.jobs, qtbot)
        assert pictures.depth_sum.values is not None
        np.testing.assert_allclose(1e3 * pictures.depth_sum.values, live.depth_sums[z], atol=1e-6)
        np.testing.assert_allclose(page.panel.record.map.values, live.energy[z], rtol=0.02)
    curve = pictures.curves["energy"].plot.items[0]
    assert len(curve.getData()[1]) == 24 and pictures.third_title.text() == "Depth-plane sum"
    assert not pictures.depth_sum.blank.isVisible() and not page.record.read_timer.isActive()


def test_after_a_fault_and_resume_all_runs_are_shown(
    open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    with pytest.raises(LfcalError):
        record(tmp_path / "s", PLAN, rig_for(PLAN, DeviceFault("vanishes", 8, 1)), CAREFUL)
    page = opened(open_page("acquire"), context, qtbot, tmp_path / "s")
    page.record.start()
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: not page.record.recording and page.record.folder.complete, timeout=GUARD_MS)
    page.panel.record.strip.setCurrentRow(0)
    idle(context.jobs, qtbot)
    recorder: Recorder | None = page.record.recorder
    assert recorder is not None and 0 < recorder.taken < 24
    found, earlier = read_again(tmp_path / "s", 0)
    shown, summed = page.panel.record.pictures, earlier.sum_of(0)
    assert summed is not None and shown.depth_sum.values is not None
    np.testing.assert_allclose(1e3 * shown.depth_sum.values, summed.light, rtol=0.02, atol=5)
    np.testing.assert_allclose(page.panel.record.map.values, found.energy[0], rtol=0.02)
    picture = record_picture(recorder.quality.state(0), recorder.order, 0, "energy", None)  # type: ignore[arg-type]
    assert len(picture.curves["energy"][0]) == 24
