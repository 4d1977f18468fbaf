"""Fixtures of the window, which is tested offscreen in its own process and leaves no thread behind."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QEvent
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from lfcal_gui.app import make_window, parse
from lfcal_gui.base_page import page_class
from lfcal_gui.context import Context
from lfcal_gui.jobs import Jobs
from lfcal_gui.models.page import PAGES
from lfcal_gui.models.project import Project, ProjectState
from lfcal_gui.theme import LIGHT, apply_theme, current_theme
from lfcal_gui.window import MainWindow
from tests.gui.waiting import GUARD_MS
from tests.psf.shared_apertures import shared_apertures

os.environ["QT_QPA_PLATFORM"] = "offscreen"

OpenPage = Callable[..., Any]


@pytest.fixture(scope="package", autouse=True)
def _shared_apertures() -> Iterator[None]:
    with shared_apertures():
        yield


@pytest.fixture(autouse=True)
def no_thread_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    for thread in set(threading.enumerate()) - before:
        if "lfcal" in thread.name:
            thread.join(GUARD_MS / 1e3)
            assert not thread.is_alive(), f"thread left behind: {thread}"


@pytest.fixture(autouse=True)
def _light_again() -> Iterator[None]:
    """Reset the theme after each test."""
    yield
    app = QApplication.instance()
    if isinstance(app, QApplication) and current_theme() is not LIGHT:
        apply_theme(app, LIGHT)


@pytest.fixture(autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return where pictures and verdicts of results are kept."""
    folder = tmp_path_factory.getbasetemp() / "results"
    monkeypatch.setattr("lfcal_gui.pages.sessions.model_kept.cache_folder", lambda: folder)
    return folder


@pytest.fixture(autouse=True)
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return where files are named by the window in a project without a file and without data."""
    folder = tmp_path / "results"
    monkeypatch.setattr("lfcal_gui.context.results", lambda: folder)
    return folder


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """Where the window keeps recent projects and autosave."""
    folder = tmp_path / "state"
    folder.mkdir()
    return folder


@pytest.fixture
def window(qapp: QApplication, place: Path, qtbot: QtBot) -> Iterator[MainWindow]:
    """Return a whole window with a new project."""
    made = make_window(qapp, parse([]), folder=place)
    made.show()
    qtbot.waitExposed(made, timeout=GUARD_MS)
    made.activateWindow()
    yield made
    made.shut_down()
    made.close()
    made.deleteLater()
    # otherwise the next change of theme also restyles the widgets of this window
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)


@pytest.fixture
def state() -> ProjectState:
    """Return the project that `context` begins with; a module may have another."""
    return ProjectState()


@pytest.fixture
def context(qapp: QApplication, state: ProjectState) -> Iterator[Context]:
    """Return what a page needs, without a window."""
    apply_theme(qapp, LIGHT)
    jobs = Jobs()
    made = Context(Project(state), jobs)
    yield made
    jobs.close()
    made.close()


@pytest.fixture
def jobs(qapp: QApplication) -> Iterator[Jobs]:
    """Return jobs without a window."""
    made = Jobs()
    yield made
    made.close()


@pytest.fixture
def open_page(context: Context, qtbot: QtBot) -> OpenPage:
    """Return a function that makes a page by itself and shows it as large as in a small window."""

    def made(key: str, height: int = 560) -> Any:
        spec = PAGES.get(key)
        kind: Any = page_class(spec)
        page = kind(spec, context, *[*kind.parts(context)][-1:])
        qtbot.addWidget(page)
        page.resize(1060, height)
        page.show()
        return page

    return made
