"""Faults of the simulator set on screen, and a session that holds because of one."""

from __future__ import annotations

from pathlib import Path

import pytest
from pytestqt.qtbot import QtBot

from gui.context import Context
from gui.models.project import ProjectState
from gui.pages.acquire.model import AcquireSettings
from gui.pages.acquire.model_faults import COUNTED, KINDS, fault_words
from gui.pages.acquire.page import Page
from lfcal.devices.simulated.faults import FAULTS, Fault
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
    assert fault_words(Fault("too warm", 4, 3)) == "reading 4 to 6: the room is too warm (gauge)"


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
    assert not faults.add.isEnabled() and "disconnect" in faults.hint.text()


def test_a_recording_holds_in_the_window_and_goes_on_by_itself(
    page: Page, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    settings = AcquireSettings.of(context.state)
    assert page.record._check_field("suspend", "temperature") != "", "what says no bounds is refused"
    changed, _ = settings.changed(PLAN, "suspend", "temperature=20:22")
    options = (*changed.device_options, ("faults", "too warm@1*4"))
    changed = AcquireSettings.from_dict(changed.to_dict() | {"device_options": options, "steady_s": 2.0})
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
