"""A page with a tiny H, before and after a fit of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from pytestqt.qtbot import QtBot

from gui.models.project import ProjectState
from gui.pages.fit.model_run import Kept, Question, asked_of, iter_fit
from gui.pages.fit.page import Page
from lfcal.progress import Progress, Work, drain
from tests.gui.conftest import OpenPage
from tests.gui.pages.fit.common import GEOMETRY, project_of, saved
from tests.gui.waiting import idle


@pytest.fixture
def state(tmp_path: Path) -> ProjectState:
    return project_of(saved(tmp_path / "H.h5"))


@pytest.fixture
def page(open_page: OpenPage, qtbot: QtBot) -> Page:
    made: Page = open_page("fit", height=680)
    idle(made.context.jobs, qtbot)
    return made


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Kept:
    """Return what a fit of the tiny H tells and finds, computed once."""
    kept, project = Kept(), project_of(saved(tmp_path_factory.mktemp("fit") / "H.h5"))
    drain(iter_fit(asked_of(project, GEOMETRY), kept))
    return kept


@pytest.fixture
def fitted(page: Page, known: Kept, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> Page:
    """Return the page after a fit, whose result was computed before."""

    def again(asked: Question, kept: Kept) -> Work[None]:
        yield Progress(0, 1, "known")
        assert known.found is not None
        kept.rounds += known.rounds
        kept.found = replace(known.found, question=asked)

    monkeypatch.setattr("gui.pages.fit.page.iter_fit", again)
    page.fit_button.click()
    idle(page.context.jobs, qtbot)
    assert page.found is not None
    return page
