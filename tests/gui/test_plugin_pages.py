"""Pages of plug-ins: the page in the documentation appears, works and is saved."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from lfcal_gui._help import cheat_sheet
from lfcal_gui.base_page import page_class
from lfcal_gui.models.page import PAGES, PageSpec, PageState, available_pages, page_registry
from lfcal_gui.models.project import Project
from lfcal_gui.window import MainWindow
from tests.distribution import text_of
from tests.gui.waiting import GUARD_MS, go, idle


@pytest.fixture
def pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[PageSpec, ...]]:
    """Write the four files of the documentation, and find the page by its entry point."""
    text = text_of("extending.md", "A page of the window")
    blocks = re.findall(r"`(notes/\w+\.py)`.*?```python\n(.*?)```", text, re.DOTALL)
    assert [name for name, _ in blocks] == [f"notes/{name}.py" for name in ("__init__", "model", "panel", "page")]
    for name, code in blocks:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(code)
    declared = re.search(r'\[project\.entry-points\."([\w.]+)"\]\n(\w+) = "([\w:]+)"', text)
    assert declared is not None
    group, name, value = declared.groups()
    points = [metadata.EntryPoint(name, value, group)]
    PAGES.names()  # pages of lfcal are found before
    monkeypatch.setattr(metadata, "entry_points", lambda group: [p for p in points if p.group == group])
    monkeypatch.syspath_prepend(str(tmp_path))
    registry = page_registry()
    yield available_pages(registry)
    for module in [m for m in sys.modules if m.split(".")[0] == "notes"]:
        del sys.modules[module]


@pytest.fixture
def window(qapp: QApplication, place: Path, qtbot: QtBot, pages: tuple[PageSpec, ...]) -> Iterator[MainWindow]:
    made = MainWindow(Project(), place, pages=pages)
    made.show()
    qtbot.waitExposed(made, timeout=GUARD_MS)
    yield made
    made.shut_down()
    made.close()
    made.deleteLater()


def test_the_documented_page_works(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    spec = window.specs[-1]
    assert spec.key == "notes" and window.menus.own[spec].text() == f"Notes ({PageState.NOTHING.value})"
    assert "Ctrl+Return" in cheat_sheet(window.specs)
    page = go(window, "notes")
    assert window.shown is page
    page.panel.editor.setPlainText("the lamp was warm")
    idle(window.jobs, qtbot)
    assert page.panel.count.text() == "4 words"
    assert window.menus.own[spec].text() == f"Notes ({PageState.DONE.value})"
    qtbot.keyClick(page, Qt.Key.Key_Return, Qt.KeyboardModifier.ControlModifier)
    assert "4 words" in window.log_view.toPlainText()
    window.project.undo()
    idle(window.jobs, qtbot)
    assert page.panel.editor.toPlainText() == ""
    window.project.redo()
    window.project.save(tmp_path / "p.lfcal")
    other = Project()
    other.open(tmp_path / "p.lfcal")
    assert other.state.settings["notes"] == {"text": "the lamp was warm"}


def test_a_page_in_a_folder_of_the_window_needs_no_entry_point(
    pages: tuple[PageSpec, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import lfcal_gui.pages

    monkeypatch.setattr(metadata, "entry_points", lambda group: [])
    monkeypatch.setattr(lfcal_gui.pages, "__path__", [*lfcal_gui.pages.__path__, str(tmp_path)])
    try:
        spec = page_registry().get("notes")
        assert spec.package == "lfcal_gui.pages.notes"
        assert page_class(spec).__module__ == "lfcal_gui.pages.notes.page"
    finally:
        for module in [m for m in sys.modules if m.startswith("lfcal_gui.pages.notes")]:
            del sys.modules[module]
