"""Faults of the simulator set on screen, and a session that holds because of one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from pytestqt.qtbot import QtBot

from lfcal.base.errors import InputError
from lfcal.devices.errors import StageError
from lfcal.devices.simulated.backend import inject, simulated_rig
from lfcal.devices.simulated.faults import FAULTS, DeviceFault
from lfcal_gui.context import Context
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.acquire._devices import COUNTED, KINDS, fault_words
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.page import Page
from tests.acquire.rigs import small_plan
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle

PLAN = small_plan((3, 4), 2, settle_s=0.0)


@pytest.fixture
def state() -> ProjectState:
    quick = AcquireSettings(device_options=(("optics", "pattern"),), darks=0, reference_every=0)
    return ProjectState(camera=PLAN.camera, plan=PLAN, settings={"acquire": quick.to_dict()})


@pytest.fixture
def page(open_page: OpenPage, qtbot: QtBot) -> Page:
    made: Page = open_page("acquire", 900)
    made.entered()
    qtbot.waitUntil(lambda: made.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    return made


def test_every_fault_has_words_and_what_it_counts() -> None:
    assert [kind for kind, _ in KINDS] == list(FAULTS) and all(words != kind for kind, words in KINDS)
    assert set(COUNTED) == set(FAULTS)
    assert fault_words(DeviceFault("too warm", 4, 3)) == "reading 4 to 6: the room is too warm (gauge)"


def test_faults_are_added_and_removed_on_screen(page: Page, context: Context, qtbot: QtBot) -> None:
    faults = page.panel.setup.faults
    for kind, at, times in (("times out", 5, 2), ("lamp low", 3, 1)):
        faults.kind.setCurrentIndex(faults.kind.findData(kind))
        faults.at.setValue(at)
        faults.times.setValue(times)
        faults.add.click()
    assert dict(AcquireSettings.of(context.state).device_options)["faults"] == "times out@5*2;lamp low@3"
    assert faults.list.count() == 2
    faults.list.setCurrentRow(0)
    faults.remove.click()
    assert dict(AcquireSettings.of(context.state).device_options)["faults"] == "lamp low@3"
    context.project.undo()
    assert faults.list.count() == 2, "undo takes a fault back"
    context.project.undo()
    page.setup.connect_devices()
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)
    assert faults.add.isEnabled() and faults.add.text() == "Inject fault" and not faults.list.isEnabled()


def test_a_fault_is_injected_into_the_connected_simulator(page: Page, context: Context, qtbot: QtBot) -> None:
    """Faults could be set before it was connected only."""
    faults = page.panel.setup.faults
    page.setup.connect_devices()
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    station = page.setup.station
    assert station is not None
    station.rig.stage.move((1.0, 0.0, 0.0))
    faults.kind.setCurrentIndex(faults.kind.findData("move fails"))
    faults.at.setValue(1)
    faults.add.click()
    assert "move 1 from now" in faults.hint.text() and not AcquireSettings.of(context.state).to_dict().get("faults")
    station.move((2.0, 0.0, 0.0))
    with pytest.raises(StageError, match="move refused because of the simulated fault"):
        station.move((3.0, 0.0, 0.0))
    station.move((4.0, 0.0, 0.0))
    faults.kind.setCurrentIndex(faults.kind.findData("too warm"))
    faults.at.setValue(0)
    faults.add.click()
    assert [gauge.read() for gauge in station.rig.gauges] == [27.0, 100.0]
    assert station.rig.gauges[0].read() == 21.0
    page.setup.disconnect_devices()
    assert faults.add.text() == "Add" and faults.hint.text().startswith("Rehearse faults")


def test_only_simulated_devices_have_faults() -> None:
    rig = simulated_rig(PLAN)
    with pytest.raises(InputError, match="connect the simulator"):
        inject(replace(rig, gauges=()), DeviceFault("too warm", 0))


def test_a_recording_holds_in_the_window_and_goes_on_by_itself(
    page: Page, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    settings = AcquireSettings.of(context.state)
    assert page.record._check_field("suspend", "temperature") != "", "what says no bounds is refused"
    changed, _ = settings.changed_on(PLAN, "suspend", "temperature=20:22")
    options = (*changed.device_options, ("faults", "too warm@1*4"))
    changed = AcquireSettings.from_dict(changed.to_dict() | {"device_options": options, "steady": 2.0})
    context.project.update("try", settings=changed.into(context.state), recording=str(tmp_path / "session"))
    idle(context.jobs, qtbot)
    told: list[str] = []
    page.panel.record.pressed.emit("start")
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    context.jobs.changed.connect(lambda job: told.append(job.progress.note) if job.progress else None)
    qtbot.waitUntil(lambda: not page.record.recording, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    assert any("outside 20 to 22" in words for words in told), "why it holds is shown"
    assert page.record.folder.complete
