"""The page of a recording with simulated devices; a module may have another project."""

from __future__ import annotations

import pytest
from pytestqt.qtbot import QtBot

from lfcal_gui.models import ProjectState
from lfcal_gui.pages.acquire.page import Page
from tests.gui.conftest import OpenPage
from tests.gui.pages.acquire._building import entered, project_of


@pytest.fixture
def state() -> ProjectState:
    return project_of()


@pytest.fixture
def page(open_page: OpenPage, qtbot: QtBot) -> Page:
    made: Page = entered(open_page("acquire"), qtbot)
    made.panel.recording.open()
    return made
