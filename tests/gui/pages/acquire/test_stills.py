"""White and dark frames of the window: taken, checked, used."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from pytestqt.qtbot import QtBot

from lfcal.acquire import Options
from lfcal.acquire.finish import iter_assemble_session
from lfcal.acquire.session import iter_record
from lfcal.acquire.stills import Stills, iter_stills, recipe_of, still_files
from lfcal.base.errors import InputError, StorageError
from lfcal.base.progress import Work, drain
from lfcal.camera import ScanPlan
from lfcal.simulate import sample_session
from lfcal_gui.context import Context
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.acquire._measuring import still_taker
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.model_station import Station, open_station
from tests.acquire.rigs import small_plan
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS

PLAN = small_plan((3, 4), 2, settle_s=0.0)


def taken(station: Station, plan: ScanPlan, exposure_s: float, folder: Path, kind: str) -> Work[Stills]:
    """Take frames as the page does."""
    take = still_taker(station, plan, exposure_s, kind)
    return iter_stills(take, plan, folder, kind, light=station.rig.light)


@pytest.fixture
def state() -> ProjectState:
    quick = AcquireSettings(device_options=(("optics", "pattern"),))
    return ProjectState(camera=PLAN.camera, plan=PLAN, settings={"acquire": quick.to_dict()})


@pytest.fixture
def station() -> Iterator[Station]:
    made = open_station(PLAN, "sim", {"optics": "pattern"})
    yield made
    made.close()


def test_dark_frames_are_taken_without_light_and_the_light_is_on_again(station: Station, tmp_path: Path) -> None:
    found = drain(taken(station, PLAN, 0.02, tmp_path, "dark"))
    assert found.files == still_files(tmp_path, "dark") and found.level < 0.02
    frames = [tifffile.imread(path) for path in found.files]
    black = PLAN.camera.sensor.black_level
    assert frames[0].shape == PLAN.camera.sensor.shape and abs(np.mean(frames) - black) < 1
    frame = station.look(0.02, PLAN).frame
    assert frame is not None and frame.data.max() > 10 * black


def test_light_is_on_again_when_dark_frames_are_stopped(station: Station, tmp_path: Path) -> None:
    work = taken(station, PLAN, 0.02, tmp_path, "dark")
    next(work)
    work.close()
    frame = station.look(0.02, PLAN).frame
    assert frame is not None and frame.data.max() > 1000
    assert not (tmp_path / "dark").exists()


def test_a_session_folder_that_is_a_file_is_told_before_a_frame_is_taken(station: Station, tmp_path: Path) -> None:
    """It ended in the traceback of a job, after all frames had been taken."""
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


def test_they_are_taken_on_the_page(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    """There was no way to record a white image in the window."""
    page: Any = open_page("acquire")
    page.entered()
    qtbot.waitUntil(lambda: page.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    buttons = page.panel.setup.find_buttons
    assert not buttons["white"].isEnabled()
    context.project.update("folder", recording=str(tmp_path / "session"))
    page.setup.connect_devices()
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)
    for kind in ("white", "dark"):
        buttons[kind].click()
        assert not buttons["white"].isEnabled()
        qtbot.waitUntil(lambda: page.setup.free, timeout=GUARD_MS)
        assert f"8 {kind} frames" in page.panel.setup.results[kind].text()
        assert all(path.is_file() for path in still_files(tmp_path / "session", kind))
