"""A small plan with quick simulated devices, and the page connected to them."""

from __future__ import annotations

from typing import Any

from pytestqt.qtbot import QtBot

from lfcal_gui.models import ProjectState
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.page import Page
from tests.acquire.rigs import small_plan
from tests.gui.waiting import GUARD_MS

PLAN = small_plan((3, 4), 2, settle_s=0.0)


def project_of(**settings: Any) -> ProjectState:
    """Return a project of the plan; the quick pattern suits its period, which no lenslet array has."""
    quick = AcquireSettings(device_options=(("optics", "pattern"),), **settings)
    return ProjectState(camera=PLAN.camera, plan=PLAN, settings={"acquire": quick.to_dict()})


def entered(page: Page, qtbot: QtBot) -> Page:
    """Enter the page, and wait until it knows the kinds of devices."""
    page.entered()
    qtbot.waitUntil(lambda: page.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    return page


def connect(page: Page, qtbot: QtBot) -> None:
    page.panel.setup.connect_buttons[-1].click()
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)
