"""A page with a tiny H, before and after a fit of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from pytestqt.qtbot import QtBot

from lfcal.base import Progress, Work
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.h.model_fit_run import FitRequest, FitRun
from lfcal_gui.pages.h.page import Page
from tests.fit.shared import shared_models
from tests.gui.conftest import OpenPage
from tests.gui.pages.h.fit.common import fit_of, project_of, saved, with_outlier
from tests.gui.waiting import idle


@pytest.fixture(scope="session", autouse=True)
def _shared_models() -> Iterator[None]:
    with shared_models():
        yield


@pytest.fixture
def state(tmp_path: Path) -> ProjectState:
    return project_of(saved(tmp_path / "H.h5"))


@pytest.fixture
def page(open_page: OpenPage, qtbot: QtBot) -> Page:
    made: Page = open_page("h", height=680)
    idle(made.context.jobs, qtbot)
    made.look_into("fit")
    return made


@pytest.fixture(scope="session")
def known(tmp_path_factory: pytest.TempPathFactory) -> FitRun:
    """Return what a fit of the tiny H tells and finds, computed once."""
    return fit_of(saved(tmp_path_factory.mktemp("fit") / "H.h5"))


@pytest.fixture(scope="session")
def known_outlier(tmp_path_factory: pytest.TempPathFactory) -> FitRun:
    """Return the same of the H in which one pattern is not like the others."""
    return fit_of(saved(tmp_path_factory.mktemp("outlier") / "outlier.h5", with_outlier()))


def told(known: FitRun) -> Callable[[FitRequest, FitRun], Work[None]]:
    """Return the work of a fit whose result was computed before."""

    def again(asked: FitRequest, kept: FitRun) -> Work[None]:
        yield Progress(0, 1, "known")
        assert known.found is not None
        kept.rounds += known.rounds
        kept.found = replace(known.found, question=asked)

    return again


@pytest.fixture
def fitted(page: Page, known: FitRun, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> Page:
    """Return the page after a fit, whose result was computed before."""
    monkeypatch.setattr("lfcal_gui.pages.h._fitting.iter_fit", told(known))
    page.fitting.view.fit_button.click()
    idle(page.context.jobs, qtbot)
    assert page.fitting.found is not None
    return page
