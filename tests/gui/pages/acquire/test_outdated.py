"""Devices and findings belong to a camera and a plan: with others they are let go."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from lfcal.camera import MainLens
from lfcal_gui.context import Context
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.page import Page
from tests.acquire.rigs import small_plan
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS

PLAN = small_plan((3, 4), 2, settle_s=0.0)


@pytest.fixture
def state() -> ProjectState:
    quick = AcquireSettings(device_options=(("optics", "pattern"),))
    return ProjectState(camera=PLAN.camera, plan=PLAN, settings={"acquire": quick.to_dict()})


@pytest.fixture
def page(open_page: OpenPage, qtbot: QtBot) -> Page:
    """Return the page with the simulator connected."""
    made: Page = open_page("acquire")
    made.entered()
    qtbot.waitUntil(lambda: made.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    connect(made, qtbot)
    return made


def connect(page: Page, qtbot: QtBot) -> None:
    page.setup.connect_devices()
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)


def find(page: Page, qtbot: QtBot, key: str) -> None:
    page.setup.measuring.find(key)
    qtbot.waitUntil(lambda: page.setup.free, timeout=GUARD_MS)
    assert key in page.setup.measuring.found


def test_a_simulator_of_another_camera_is_let_go(page: Page, context: Context, qtbot: QtBot) -> None:
    """It went on showing, and recording, the camera for which it had been connected."""
    optics = PLAN.camera.optics
    assert isinstance(optics, MainLens)
    station = page.setup.station
    context.project.update("exposure", plan=replace(PLAN, exposure_s=0.03, order="raster"))
    assert page.setup.station is station, "what is set and not described"
    qtbot.waitUntil(lambda: page.panel.setup.view.values is not None, timeout=GUARD_MS)
    camera = replace(PLAN.camera, optics=replace(optics, f_number=11.0))
    context.project.update("f-number", camera=camera, plan=replace(PLAN, camera=camera))
    devices = page.panel.setup.devices
    assert page.setup.station is None and devices.button.text() == "Connect" and devices.button.isEnabled()
    assert "connect again" in devices.reason.text() and page.panel.setup.view.values is None
    connect(page, qtbot)
    assert page.setup.station is not None
    said: list[str] = []
    context.message.connect(said.append)
    page.hide()
    context.project.undo()
    assert page.setup.station is None and said == [], "on another page it is of no use"


def test_devices_that_are_not_those_chosen_are_let_go(page: Page, context: Context, qtbot: QtBot) -> None:
    """Undo, or another project, showed other options beside devices that had been connected with the first."""
    chosen = AcquireSettings.of(context.state)
    options = (*chosen.device_options, ("velocity", "500"))
    context.project.update("choice", settings=replace(chosen, device_options=options).into(context.state))
    assert page.setup.station is None and "than those connected" in page.panel.setup.devices.reason.text()


def test_devices_at_work_are_let_go_afterwards(page: Page, context: Context, qtbot: QtBot) -> None:
    page.setup.measuring.find("axis")
    assert not page.setup.free
    changed = replace(PLAN, depths_um=(*PLAN.depths_um, 2 * PLAN.depths_um[-1] - PLAN.depths_um[0]), exposure_s=0.02)
    context.project.update("planes", plan=changed)
    assert page.setup.station is not None
    qtbot.waitUntil(lambda: page.setup.free, timeout=GUARD_MS)
    assert page.setup.station is None and "axis" not in page.setup.measuring.found
    assert "measure again" in page.panel.setup.results["axis"].text()


def test_findings_are_not_used_for_other_planes(page: Page, context: Context, qtbot: QtBot) -> None:
    """Exposures of two planes were offered for a plan of five, and raised."""
    find(page, qtbot, "exposure")
    find(page, qtbot, "stage")
    results = page.panel.setup.results
    other = small_plan((3, 4), 5, settle_s=0.0)
    context.project.update("planes", plan=other, camera=other.camera)
    assert "exposure" not in page.setup.measuring.found and results["exposure"].text() == ""
    assert "stage" in page.setup.measuring.found, "the stage moves as it does"
    assert context.state.plan == other


def test_another_project_knows_nothing_of_what_was_found(page: Page, context: Context, qtbot: QtBot) -> None:
    find(page, qtbot, "stage")
    context.project.start(ProjectState())
    context.project.update("plan", plan=PLAN, camera=PLAN.camera)
    assert page.setup.measuring.found == {} and all(label.text() == "" for label in page.panel.setup.results.values())


def test_what_is_connected_for_an_earlier_project_begins_nothing(
    open_page: OpenPage, context: Context, qtbot: QtBot
) -> None:
    """It asked for a folder, and would have recorded the new project's plan."""
    page: Any = open_page("acquire")
    begun: list[str] = []
    page.setup.connect_devices(lambda: begun.append("recording"))
    assert page.setup.connecting
    context.project.start(ProjectState(camera=PLAN.camera, plan=replace(PLAN, cutout=(7, 7))))
    qtbot.waitUntil(lambda: not page.setup.connecting, timeout=GUARD_MS)
    assert begun == [] and page.setup.station is None
