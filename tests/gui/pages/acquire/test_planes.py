"""The strip of planes of Record > Rig, the map of the plane that is looked at, and what connects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import Qt
from pytestqt.qtbot import QtBot

from lfcal_gui.context import Context
from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.stamp import stamp_of
from lfcal_gui.models.verdict import Verdict, with_verdict
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.page import Page
from lfcal_gui.widgets.period_map import UNKNOWN, PeriodMap
from lfcal_gui.widgets.strip import PlaneTile, Strip
from tests.acquire.rigs import small_plan
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle

PLAN = small_plan((3, 4), 2, settle_s=0.0)


@pytest.fixture
def state() -> ProjectState:
    settings = AcquireSettings(device_options=(("optics", "pattern"),), darks=0, reference_every=0)
    return ProjectState(camera=PLAN.camera, plan=PLAN, settings={"acquire": settings.to_dict()})


@pytest.fixture
def page(open_page: OpenPage, qtbot: QtBot, context: Context) -> Page:
    made: Page = open_page("acquire")
    made.entered()
    qtbot.waitUntil(lambda: made.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    return made


def connect(page: Page, qtbot: QtBot) -> None:
    page.panel.setup.connect_buttons[-1].click()
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)


def click(page: Page, z: int, qtbot: QtBot) -> None:
    strip = page.panel.record.strip
    where = strip.visualItemRect(strip.item(z)).center()
    qtbot.mouseClick(strip.viewport(), Qt.MouseButton.LeftButton, pos=where)


def test_the_strip_shows_what_is_expected_before_anything_is_recorded(page: Page) -> None:
    tiles = page.panel.record.strip.tiles
    assert [one.depth_um for one in tiles] == list(PLAN.depths_um) and page.panel.record.map_box.isHidden()
    assert all(one.shape == PLAN.cutout and one.image is None and one.word == "" for one in tiles)
    assert any(one.expected is not None for one in tiles)


def test_a_click_on_a_plane_moves_the_stage_there(page: Page, qtbot: QtBot) -> None:
    click(page, 1, qtbot)
    assert page.panel.record.z == 1 == page.panel.setup.z, "without a rig it is looked at"
    connect(page, qtbot)
    station = page.setup.station
    assert station is not None
    for z in (0, 1):
        click(page, z, qtbot)
        wanted = PLAN.stage_um(np.array([z, PLAN.period[0] // 2, PLAN.period[1] // 2]))
        qtbot.waitUntil(lambda wanted=wanted: np.allclose(station.position(), wanted, atol=0.5), timeout=GUARD_MS)
    qtbot.keyClick(page.panel.record.strip, Qt.Key.Key_Left)
    qtbot.waitUntil(lambda: not page.setup.moves.moving, timeout=GUARD_MS)
    assert page.panel.record.z == 0 and np.allclose(station.position(), wanted, atol=0.5), "keys only look"


def test_planes_fill_while_they_are_recorded_and_another_can_be_looked_at(
    page: Page, qtbot: QtBot, context: Context, tmp_path: Path
) -> None:
    context.project.update("folder", recording=str(tmp_path / "s"))
    connect(page, qtbot)
    page.record.start()
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    recorder, panel = page.record.recorder, page.panel.record
    assert recorder is not None
    qtbot.waitUntil(lambda: recorder.taken > 14 or not page.record.recording, timeout=GUARD_MS)
    page.record.pause()
    qtbot.waitUntil(lambda: recorder.control.held == "paused" or not page.record.recording, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: panel.strip.tiles[0].word == "recorded", timeout=GUARD_MS)
    if page.record.recording:
        done = recorder.taken - 12
        qtbot.waitUntil(lambda: panel.strip.tiles[1].word == f"{100 * done / 12:.0f} %", timeout=GUARD_MS)
        assert panel.strip.tiles[1].progress == pytest.approx(done / 12) and panel.z == 1
        assert panel.map_box.isVisible() and panel.map_words.text().startswith("within")
        panel.strip.setCurrentRow(0)
        page.record._poll_frame()
        assert panel.z == 0, "the plane that was chosen stays"
        panel.strip.setCurrentRow(1)
        page.record.pause()
    qtbot.waitUntil(lambda: page.record.folder.complete and not page.record.recording, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    assert [one.word for one in panel.strip.tiles] == ["recorded", "recorded"]
    assert panel.strip.tiles[1].image is not None and panel.strip.tiles[1].progress is None
    state = context.state
    stamp = stamp_of(state.psf)
    assert stamp is not None and panel.strip.tiles[0].merit == ""
    verdict = Verdict("bad", "One position is bad.", 1, 0.04, "good", 1, 39, ((1, 0, 0),))
    context.project.update("verdict", settings=with_verdict(state, stamp, verdict))
    idle(context.jobs, qtbot)
    page.record.refresh()
    idle(context.jobs, qtbot)
    assert [one.merit for one in panel.strip.tiles] == ["good", "bad"]


def test_the_simulated_rig_is_one_click_away(page: Page, qtbot: QtBot, context: Context) -> None:
    """Without devices it was named, and the only button was called Connect; its options must stay."""
    own, choose, simulated = page.panel.setup.connect_buttons
    assert own.isHidden() and choose.isVisible() and simulated.isVisible() and page.panel.setup.overlay.isHidden()
    choose.click()
    assert page.panel.devices.head.isChecked() and page.panel.setup.devices.isVisible()
    simulated.click()
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)
    assert AcquireSettings.of(context.state).device_options == (("optics", "pattern"),)
    assert choose.isHidden() and simulated.isHidden()
    page.setup.disconnect_devices()
    page.setup._devices_edited("folder", (), "")
    page.setup.show_controls()
    assert own.isVisible() and choose.isHidden() and simulated.isVisible()
    simulated.click()
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)
    assert AcquireSettings.of(context.state).backend == "sim" and page.setup.station.name == "sim"  # type: ignore[union-attr]
    assert own.isHidden() and page.panel.setup.overlay.isVisible()


def test_the_folds_say_how_much_is_done(page: Page, qtbot: QtBot, context: Context) -> None:
    head, panel = page.panel.adjust.head, page.panel
    assert head.words == "0 of 5 done" and panel.devices.head.words == "not connected"
    connect(page, qtbot)
    page.setup.measuring.find("stage")
    qtbot.waitUntil(lambda: page.setup.free, timeout=GUARD_MS)
    assert head.words == "1 of 5 done" and panel.devices.head.words == panel.setup.devices.backend.currentText() != ""
    assert panel.recording.head.words == "2 changed", "dark and reference frames"
    page.record._field_edited("retries", 1)
    assert panel.recording.head.words == "3 changed"
    other = replace(PLAN, depths_um=PLAN.depths_um[:1], exposure_s=PLAN.exposures[:1])
    context.project.start(ProjectState(camera=other.camera, plan=other))
    assert head.words == "0 of 5 done" and panel.recording.head.words == "defaults"


def test_a_map_draws_what_is_not_known_in_grey(qtbot: QtBot) -> None:
    shown = PeriodMap()
    qtbot.addWidget(shown)
    values = np.array([[1.0, np.nan], [2.0, 0.0]])
    shown.set_values(values)
    assert "#{:02x}{:02x}{:02x}".format(*shown.item.image[0, 1, :3]) == UNKNOWN
    assert len({tuple(colour) for colour in shown.item.image.reshape(4, -1).tolist()}) == 4


def test_a_word_below_a_depth_has_room(qtbot: QtBot) -> None:
    """The strip forgot the line of the word when it was resized, and cut the depth as well."""
    strip = Strip(lambda z, tile, count: "", 52, worded=True)
    qtbot.addWidget(strip)
    strip.show_tiles([PlaneTile(-26017.3, word="recorded")])
    strip.resize(600, 100)
    assert strip.height() >= strip.gridSize().height()
