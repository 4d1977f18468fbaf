"""Recorded sessions: opened again, with white and dark frames, and made into H."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PySide6.QtCore import Qt
from pytestqt.qtbot import QtBot

from lfcal.acquire import (
    Control,
    EarlierFrames,
    LiveCoverage,
    LiveQuality,
    Options,
    QualityState,
    SessionFile,
    iter_assemble_session,
    iter_record,
    iter_stills,
    recipe_of,
    record,
    still_files,
    window_shape,
)
from lfcal.acquire.recording.recording_file import read_layout
from lfcal.acquire.stills import Stills
from lfcal.base import InputError, LfcalError, StorageError, Work, drain
from lfcal.camera import ScanPlan
from lfcal.devices import simulated_rig
from lfcal.devices.simulated._targets import TargetPattern
from lfcal.devices.simulated.faults import DeviceFault
from lfcal.frames import Position
from lfcal.psf import AssemblyProgress, PSFMatrix, PSFWriter, open_psf, save
from lfcal.records import AssemblySettings
from lfcal.simulate import sample_recording, sample_session
from lfcal.tasks import Assemble
from lfcal.work import parts_folder
from lfcal_gui.context import Context
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.acquire._measuring import still_taker
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.model_folder import folder_state
from lfcal_gui.pages.acquire.model_recorder import Recorder, coverage_picture, record_picture
from lfcal_gui.pages.acquire.model_station import Station, open_station
from lfcal_gui.pages.acquire.page import Page
from lfcal_gui.pages.acquire.step import iter_assembly, remade
from tests.acquire.rigs import CAREFUL, rig_for, small_plan
from tests.acquire.test_live_coverage import small_target
from tests.gui.conftest import OpenPage
from tests.gui.pages.acquire._building import PLAN, project_of
from tests.gui.waiting import GUARD_MS, idle
from tests.psf.test_joining import contents


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


def read_again(folder: Path, z: int, **options: Any) -> tuple[QualityState, EarlierFrames]:
    quality = LiveQuality(PLAN, window_shape(PLAN, CAREFUL))
    earlier = EarlierFrames(folder, quality, folder_state(str(folder)).known(), **options)
    assert earlier.want(z) and not earlier.want(z)
    earlier.read(z)
    return quality.state(z), earlier


def test_all_runs_are_read_as_they_were_seen(known: tuple[Path, QualityState]) -> None:
    folder, live = known
    for z in (0, 1):
        found, earlier = read_again(folder, z)
        np.testing.assert_allclose(found.energy[z], live.energy[z], rtol=1e-9)
        np.testing.assert_allclose(found.energy, live.energy, rtol=0.02)  # of other planes the background is sampled
        np.testing.assert_allclose(found.residual_px, live.residual_px, rtol=1e-5)
        np.testing.assert_array_equal(found.saturated, live.saturated)
        summed = earlier.sum_of(z)
        assert summed.ended and summed.words == ""
        np.testing.assert_allclose(summed.light, live.depth_sums[z], atol=1e-6)
        assert {a.kind for a in found.alarms} == {a.kind for a in live.alarms}


def test_a_position_recorded_again_counts_once(tmp_path: Path) -> None:
    live = recorded(tmp_path, redo=True)
    _, earlier = read_again(tmp_path, 0)
    summed = earlier.sum_of(0)
    assert (summed.read, summed.total) == (12, 12)
    np.testing.assert_allclose(summed.light.sum(), live.depth_sums[0].sum(), rtol=0.05)
    folder = folder_state(str(tmp_path))
    known = folder.known([Position(0, 1, 2)])
    assert len(known.flat) == 23 and 6 not in known.flat


def test_a_slow_disk_ends_the_reading_with_a_part_of_the_plane(known: tuple[Path, QualityState]) -> None:
    ticks = count()
    found, earlier = read_again(known[0], 0, seconds=4.5, clock=lambda: float(next(ticks)))
    summed = earlier.sum_of(0)
    assert np.isfinite(found.energy).all(), "records are read whatever the frames take"
    assert summed.ended and summed.words == "5 of 12 frames"


def test_a_damaged_frame_is_left_out_and_counted(known: tuple[Path, QualityState], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(known[0], tmp_path / "s"))
    layout = read_layout(folder / "recording.h5")
    with open(folder / "recording.h5", "r+b") as file:
        file.seek(layout.frames_at + 3 * layout.frame_bytes + 10)
        file.write(b"\xff\x00\xff")
    summed = read_again(folder, 0)[1].sum_of(0)
    assert summed.words == "11 of 12 frames" and summed.damaged == 1


def test_reading_ends_for_another_plane_and_for_a_window_that_closes(known: tuple[Path, QualityState]) -> None:
    quality = LiveQuality(PLAN, window_shape(PLAN, CAREFUL))
    earlier = EarlierFrames(known[0], quality, folder_state(str(known[0])).known())
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
    open_page: OpenPage, context: Context, qtbot: QtBot, known: tuple[Path, QualityState], tmp_path: Path
) -> None:
    live = known[1]
    page = opened(open_page("acquire"), context, qtbot, Path(shutil.copytree(known[0], tmp_path / "s")))
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


def test_all_runs_are_shown_after_a_fault(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    with pytest.raises(LfcalError):
        record(tmp_path / "s", PLAN, rig_for(PLAN, DeviceFault("vanishes", 8, 1)), CAREFUL)
    page = opened(open_page("acquire"), context, qtbot, tmp_path / "s")
    page.record.start()
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: not page.record.recording and page.record.folder.complete, timeout=GUARD_MS)
    page.panel.record.strip.setCurrentRow(0)
    idle(context.jobs, qtbot)
    recorder: Recorder | None = page.record.recorder
    assert 0 < recorder.taken < 24
    found, earlier = read_again(tmp_path / "s", 0)
    shown, summed = page.panel.record.pictures, earlier.sum_of(0)
    assert summed is not None and shown.depth_sum.values is not None
    np.testing.assert_allclose(1e3 * shown.depth_sum.values, summed.light, rtol=0.02, atol=5)
    np.testing.assert_allclose(page.panel.record.map.values, found.energy[0], rtol=0.02)
    picture = record_picture(recorder.quality.state(0), recorder.order, 0, "energy", None)  # type: ignore[arg-type]
    assert len(picture.curves["energy"][0]) == 24


def taken(station: Station, plan: ScanPlan, exposure_s: float, folder: Path, kind: str) -> Work[Stills]:
    """Take frames as the page does."""
    take = still_taker(station, plan, exposure_s, kind)
    return iter_stills(take, plan, folder, kind, light=station.rig.light)


@pytest.fixture
def station() -> Iterator[Station]:
    made = open_station(PLAN, "sim", {"optics": "pattern"})
    yield made
    made.close()


def test_a_session_folder_that_is_a_file_is_told_before_a_frame_is_taken(station: Station, tmp_path: Path) -> None:
    (folder := tmp_path / "session.h5").write_bytes(b"a file")
    with pytest.raises(StorageError, match=r"session\.h5 is a file; check the path"):
        next(taken(station, PLAN, 0.02, folder, "dark"))
    assert folder.read_bytes() == b"a file" and not recipe_of(folder).white


def test_a_point_is_no_white_image_and_light_is_no_dark_one(station: Station, tmp_path: Path) -> None:
    station.name = "other"
    station.jog(0, 1e4)
    with pytest.raises(InputError, match="expose longer"):
        drain(taken(station, PLAN, 1e-5, tmp_path, "white"))
    station.jog(0, -1e4)
    with pytest.raises(InputError, match="white frames: expected"):
        drain(taken(station, PLAN, 0.02, tmp_path, "white"))
    station.rig = replace(station.rig, light=None)
    with pytest.raises(InputError, match="cover the lens"):
        drain(taken(station, PLAN, 20.0, tmp_path, "dark"))
    assert not list(tmp_path.iterdir())


def test_a_session_with_white_and_dark_frames_is_assembled_by_them(tmp_path: Path) -> None:
    # of the true period: a white scene repeats with it
    whole = ScanPlan.from_json((sample_session() / "plan.json").read_text())
    plan = replace(whole, depths_um=whole.depths_um[:1], exposure_s=whole.exposures[0], settle_s=0.0)
    station = open_station(plan, "sim", {"optics": "pattern"})
    assert recipe_of(tmp_path).white == ""
    for kind in ("dark", "white"):
        drain(taken(station, plan, 0.02, tmp_path, kind))
    assert recipe_of(tmp_path).white == tmp_path / "white"
    drain(station.use(iter_record(tmp_path, plan, station.rig, Options(keep_free_bytes=0))))
    station.close()
    plain = drain(iter_assemble_session(tmp_path)).matrix
    flat = drain(iter_assemble_session(tmp_path, recipe=recipe_of(tmp_path))).matrix
    assert flat.recorded.all() and not np.array_equal(np.asarray(plain), np.asarray(flat))


@pytest.fixture
def session(tmp_path: Path) -> Path:
    return Path(shutil.copytree(sample_recording(), tmp_path / "session"))


@pytest.fixture
def state() -> ProjectState:
    return project_of(darks=0, reference_every=0)


@pytest.fixture
def page(open_page: OpenPage, context: Context, qtbot: QtBot, session: Path) -> Any:
    """Return the page with the session of the sample."""
    plan = SessionFile.read(session).plan
    context.project.start(ProjectState(camera=plan.camera, plan=plan, recording=str(session)))
    made = open_page("acquire")
    made.entered()
    made.panel.record.pictures.show()
    idle(context.jobs, qtbot)
    return made


def test_h_fills_in_the_map_while_a_session_is_assembled(
    page: Any, context: Context, qtbot: QtBot, session: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures, go_on = page.panel.record, threading.Event()
    shown: list[Any] = []
    held_at: list[int] = []
    monkeypatch.setattr(pictures.map, "set_values", shown.append)

    def held(*asked: Any) -> Any:
        running, rows = iter_assembly(*asked), 0
        while True:
            try:
                record = next(running)
            except StopIteration as end:
                return end.value
            rows += isinstance(record, AssemblyProgress)
            if rows == 4 and not held_at:
                held_at.append(int(np.isfinite(record.energy).sum()))
            yield record
            while held_at and not go_on.wait(0.001):
                yield record

    monkeypatch.setattr("lfcal_gui.pages.acquire._after.iter_assembly", held)
    page.record.after.assemble(str(session / "H.h5"))
    qtbot.waitUntil(
        lambda: bool(held_at) and f"H fills: plane 0, {held_at[0]} of " in pictures.map_words.text(), timeout=GUARD_MS
    )
    values, count = shown[-1], len(shown)
    assert 0 < held_at[0] == np.isfinite(values).sum() < values.size
    page.record.refresh()  # another quantity is chosen meanwhile: H stays
    qtbot.waitUntil(lambda: len(shown) > count, timeout=GUARD_MS)
    assert np.array_equal(shown[-1], values, equal_nan=True)
    go_on.set()
    idle(context.jobs, qtbot)
    assert "H fills" not in pictures.map_words.text() and not np.isnan(shown[-1]).all()
    assert context.state.psf == str(session / "H.h5")


def test_a_session_s_h_that_failed_goes_on_to_the_same(
    page: Any, context: Context, qtbot: QtBot, session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full when the planes are joined: none is made again."""
    whole = tmp_path / "whole.h5"
    drain(iter_assembly(session, whole, None, recipe_of(session))).matrix.close()
    out, real = session / "H.h5", PSFWriter.adopt_plane

    def full(*_: Any) -> None:
        raise StorageError("H.h5: the disk is full; make room")

    monkeypatch.setattr(PSFWriter, "adopt_plane", full)
    page.record.after.assemble(str(out))
    idle(context.jobs, qtbot)
    job = context.jobs.jobs()[0]
    assert job.kept == "1 of 1 planes" and not out.exists() and parts_folder(out).exists()
    monkeypatch.setattr(PSFWriter, "adopt_plane", real)
    (session / "plane-00.h5").write_bytes(b"another that was made meanwhile")
    context.jobs.go_on(job.number)
    idle(context.jobs, qtbot)
    context.matrices.forget(str(out))
    assert contents(out) == contents(whole)
    assert "assemble plane" not in context.jobs.log(job.number).text().partition("resumed")[2]


def test_positions_are_recorded_again_and_h_is_made_anew_as_before(page: Any, qtbot: QtBot, session: Path) -> None:
    """The frames and the H of before stay; another H has them replaced, with the settings of the first."""
    folder = session.parent / "quick"
    plan = small_plan((3, 4), 2, settle_s=0.0)
    quick = AcquireSettings(device_options=(("optics", "pattern"), ("seed", "3")), darks=1, reference_every=0)
    page.context.project.update("quick", plan=plan, camera=plan.camera, settings=quick.into(page.context.state))
    page.context.project.update("folder", recording=str(folder))
    page.setup.connect_devices(page.record.start)
    qtbot.waitUntil(lambda: page.record.folder.complete and not page.record.recording, timeout=GUARD_MS)
    idle(page.context.jobs, qtbot)
    assert page.context.state.psf == str(folder / "H.h5"), "made without being asked for"
    made = Assemble(frames=folder, out=folder / "own.h5", settings=AssemblySettings(cutout=(15, 15)))
    drain(made.work())[0].report.matrix.close()
    page.setup.disconnect_devices()
    assert not page.redo(), "no position is asked for"
    again = ((0, 1, 2), (1, 0, 0), (1, 2, 3))
    page.context.project.update("open", psf=str(folder / "own.h5"), redo=again)
    # other noise, by which frames of the second run are known
    page.context.project.update(
        "seed", settings=replace(quick, device_options=(("optics", "pattern"), ("seed", "4"))).into(page.context.state)
    )
    before, went = (folder / "own.h5").read_bytes(), list[Any]()
    page.context.go.connect(lambda *sent: went.append(sent))
    assert not page.redo() and "3 positions are then recorded again" in page.notice.label.text()
    qtbot.mouseClick(page.notice.button, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: page.context.state.psf == str(folder / "own-2.h5"), timeout=GUARD_MS)
    idle(page.context.jobs, qtbot)
    assert page.context.state.reference == str(folder / "own.h5") and page.context.state.redo == ()
    assert (folder / "own.h5").read_bytes() == before
    assert went == [("h", {"place": (1, 0, 0), "view": "difference"})]
    with open_psf(folder / "own.h5") as old, open_psf(folder / "own-2.h5") as new:
        assert new.cutout == (15, 15)
        changed = np.argwhere((np.asarray(old) != np.asarray(new)).any(axis=(3, 4)))
        assert [tuple(place) for place in changed.tolist()] == sorted(again)


def test_an_h_of_another_scan_is_not_made_anew(session: Path, tmp_path: Path) -> None:
    save(PSFMatrix(np.zeros((2, 3, 4, 5, 5), np.float32)), tmp_path / "one.h5")
    with pytest.raises(InputError, match="expected H of all planes of the session in"):
        remade(session, tmp_path / "one.h5", tmp_path / "two.h5", recipe_of(session))


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, QualityState]:
    """Return a session of two runs, which is only read, and what was seen while it was recorded."""
    folder = tmp_path_factory.mktemp("known") / "s"
    return folder, recorded(folder)


def test_dark_frames_are_taken_without_light_which_is_on_afterwards(station: Station, tmp_path: Path) -> None:
    black = PLAN.camera.sensor.black_level
    work = taken(station, PLAN, 0.02, tmp_path, "dark")
    next(work)
    work.close()
    assert station.look(0.02, PLAN).frame.data.max() > 1000 and not (tmp_path / "dark").exists()
    found = drain(taken(station, PLAN, 0.02, tmp_path, "dark"))
    assert found.files == still_files(tmp_path, "dark") and found.level < 0.02
    frames = [tifffile.imread(path) for path in found.files]
    assert frames[0].shape == PLAN.camera.sensor.shape and abs(np.mean(frames) - black) < 1
    assert station.look(0.02, PLAN).frame.data.max() > 10 * black
