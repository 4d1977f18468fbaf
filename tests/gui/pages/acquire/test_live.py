"""The live view is an instrument: frame, cutout, words and numbers of one moment, and it is seldom anything to set."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest
from PySide6.QtWidgets import QAbstractButton, QAbstractSpinBox, QComboBox, QLineEdit, QSlider, QWidget
from pytestqt.qtbot import QtBot

from lfcal.acquire import LiveFrame
from lfcal.devices import Roi
from lfcal.frames import Position
from lfcal_gui.context import Context
from lfcal_gui.models import Outline
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.model_live import Pace
from lfcal_gui.pages.acquire.model_recorder import Recorder
from lfcal_gui.pages.acquire.page import Page
from lfcal_gui.theme import canvas_fair
from lfcal_gui.widgets import Contrast
from tests.acquire.rigs import small_plan
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle

PLAN = small_plan((3, 4), 2, settle_s=0.0)
CONTROLS = (QAbstractButton, QAbstractSpinBox, QComboBox, QLineEdit, QSlider, Contrast)


@pytest.fixture
def state() -> ProjectState:
    quick = AcquireSettings(device_options=(("optics", "pattern"),))
    return ProjectState(camera=PLAN.camera, plan=PLAN, settings={"acquire": quick.to_dict()})


@pytest.fixture
def page(open_page: OpenPage, qtbot: QtBot) -> Page:
    made: Page = open_page("acquire", 700)
    made.entered()
    qtbot.waitUntil(lambda: made.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    return made


def connect(page: Page, qtbot: QtBot) -> None:
    page.setup.connect_devices()
    qtbot.waitUntil(lambda: page.panel.setup.view.values is not None, timeout=GUARD_MS)


def controls(page: QWidget) -> list[QWidget]:
    """Return what can be operated and is seen; the line inside a box is part of the box."""
    found = [one for one in page.findChildren(QWidget) if isinstance(one, CONTROLS) and one.isVisible()]
    return [one for one in found if not isinstance(one.parent(), QAbstractSpinBox | QComboBox | QLineEdit)]


def test_few_controls_are_seen_at_first(page: Page, qtbot: QtBot) -> None:
    assert len(controls(page)) <= 20
    connect(page, qtbot)
    assert 10 < len(controls(page)) <= 20
    page.panel.session.click()
    assert len(controls(page)) <= 20


class Camera:
    """Frames of a recording at 150 positions/s: the value of every pixel says which position it is."""

    def __init__(self, recorder: Recorder) -> None:
        self.positions = [Position(*place) for place in PLAN.order_indices().tolist()]
        self.recorder, self.put = recorder, 0
        self.thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        for k in range(300):
            number = k % len(self.positions)
            where = self.positions[number]
            data = np.full((30, 40), 100 + number, np.uint16)
            cutout = Roi(20 + number, 10, 5, 6)
            self.recorder.preview.put(LiveFrame(data, Roi(10, 5, 30, 40), cutout, where, 0, "position"))
            self.put += 1
            time.sleep(1 / 150)


def test_frame_cutout_words_and_numbers_are_of_one_position(
    page: Page, context: Context, qtbot: QtBot, tmp_path: Any
) -> None:
    """At 150 positions/s nothing is shown together with what belongs to another frame."""
    task = AcquireSettings(darks=0).task("", str(tmp_path))
    recorder = Recorder(task, PLAN, AcquireSettings(darks=0).options())
    camera, view, seen = Camera(recorder), page.panel.setup.view, list[tuple[int, str, float, str]]()

    def drawn() -> None:
        border = next(one for one in view.overlays if isinstance(one, Outline))
        assert view.values is not None
        seen.append((int(view.values[0, 0]) - 100, view.shot.caption, border.points[0, 0], view.shot.readout))

    view.changed.connect(drawn)
    page.record.recorder = recorder
    page.record.frame_timer.start()
    camera.thread.start()
    qtbot.waitUntil(lambda: not camera.thread.is_alive(), timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    page.record.frame_timer.stop()
    page.record.recorder = None
    assert camera.put == 300 and len(seen) > 3
    for number, caption, top, readout in seen:
        where = camera.positions[number]
        peak = (100 + number - 64) / (4095 - 64)
        assert caption == f"plane {where.z}, position y {where.y}, x {where.x}"
        assert top == 20 + number - 10 - 0.5 and f"peak {100 * peak:.0f} % of range" in readout


def test_the_age_of_a_frame_counts_up_where_none_comes(page: Page, qtbot: QtBot, context: Context) -> None:
    connect(page, qtbot)
    panel, shown = page.panel.setup, page.panel.setup.show_age
    page.setup.reserved = True  # no further frame
    idle(context.jobs, qtbot)
    page.setup.moves.follow(False)
    assert panel._last is not None
    picture = panel._last[0]
    shown(picture.taken_s + 0.1, picture.stage_um)
    assert panel.view.note == ("0.1 s old", "")
    shown(picture.taken_s + picture.due_s + 4.0, picture.stage_um)
    assert panel.view.note[0].endswith("s old") and panel.view.note[1] == canvas_fair()


def test_the_rate_is_that_of_the_last_frames() -> None:
    pace = Pace()
    assert np.isnan(pace.rate) and pace.due_s(0.5) == 1.5
    for k in range(40):
        pace.add(0.1 * k)
    assert pace.rate == pytest.approx(10.0) and pace.due_s(0.5) == 1.5
    pace.add(100.0)
    assert np.isnan(pace.rate), "after a break it begins again"
    pace.add(102.0)
    assert pace.due_s(0.0) == pytest.approx(6.0)


def test_where_no_plane_is_near_it_leads_to_one(page: Page, qtbot: QtBot) -> None:
    connect(page, qtbot)
    panel, station = page.panel.setup, page.setup.station
    assert station is not None
    qtbot.waitUntil(lambda: not panel.go.isHidden(), timeout=GUARD_MS)
    assert panel.near_words.text().startswith("No plane of the plan is near this depth")
    panel.go.click()
    qtbot.waitUntil(lambda: panel.go.isHidden(), timeout=GUARD_MS)
    depth = float(PLAN.stage.to_object(np.array(station.position()))[2])
    assert np.abs(np.array(PLAN.depths_um) - depth).min() < 1.0
    qtbot.waitUntil(lambda: "correlation" in panel.correlation.text(), timeout=GUARD_MS)


def test_a_camera_that_fails_is_asked_again(page: Page, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    connect(page, qtbot)
    station, said = page.setup.station, list[str]()
    assert station is not None
    monkeypatch.setattr("lfcal_gui.pages.acquire.setup_tab.AGAIN_MS", 1)
    page.context.message.connect(said.append)
    look = station.look
    failing = [True]

    def failed(*asked: Any) -> Any:
        if failing[0]:
            raise OSError("the cable is loose")
        return look(*asked)

    monkeypatch.setattr(station, "look", failed)
    qtbot.waitUntil(lambda: "the cable is loose" in page.panel.setup.readout.text(), timeout=GUARD_MS)
    before = page.panel.setup.view.shot
    failing[0] = False
    qtbot.waitUntil(lambda: page.panel.setup.view.shot is not before, timeout=GUARD_MS)
    assert len([words for words in said if "cable" in words]) == 1
