"""The menus of the window: every action with its key."""

from __future__ import annotations

from typing import Any

from PySide6.QtGui import QAction, QKeySequence
from PySide6.QtWidgets import QMessageBox

from lfcal_gui._help import about_text, cheat_sheet
from lfcal_gui.crash_dialog import open_folder
from lfcal_gui.log import log_folder
from lfcal_gui.models import ATLAS

__all__ = ["WindowMenus", "page_key"]


def page_key(row: int) -> QKeySequence | None:
    """Return the shortcut of a page in the rail: there are nine digits."""
    return QKeySequence(f"Ctrl+{row + 1}") if row < 9 else None


class WindowMenus:
    """Fills the menu bar of a `lfcal_gui.window.MainWindow`: undo and redo are renamed as the project changes."""

    def __init__(self, window: Any) -> None:
        self._window = window
        self._project()
        self._edit()
        self._view()
        self._tools()
        self._help()

    def _project(self) -> None:
        window, files, keys = self._window, self._window.files, QKeySequence.StandardKey
        menu = window.menuBar().addMenu("&Project")
        self._action(menu, "New project", files.new, keys.New)
        self._action(menu, "Open the sample session", lambda: window.tools.sample())
        self._action(menu, "Open project …", lambda: files.open(), keys.Open)
        self.recent = menu.addMenu("Open recent")
        self.recent.aboutToShow.connect(lambda: files.fill_recent(self.recent))
        self._action(menu, "Save project", lambda: files.save(), keys.Save)
        self._action(menu, "Save project as …", lambda: files.save_as(), "Ctrl+Shift+S")
        self._action(menu, "Restore unsaved work …", lambda: files.rescue.look(asked=True))
        menu.addSeparator()
        self._action(menu, "Quit", window.close, keys.Quit)

    def _edit(self) -> None:
        window = self._window
        menu = window.menuBar().addMenu("&Edit")
        self.undo = self._action(menu, "Undo", window.project.undo, QKeySequence.StandardKey.Undo)
        self.redo = self._action(menu, "Redo", window.project.redo, QKeySequence.StandardKey.Redo)
        menu.addSeparator()
        self._action(menu, "Copy picture of the page", window.copy_page, "Ctrl+Shift+C")
        self._action(menu, "Copy page as command", lambda: window.scripts.copy_step(), "Ctrl+Shift+K")
        self._action(menu, "Copy page as Python", lambda: window.scripts.copy_step(python=True), "Ctrl+Shift+Y")
        self._action(menu, "Copy history as a script", lambda: window.scripts.copy_history(), "Ctrl+Shift+H")
        self._action(menu, "Save history as a script …", lambda: window.scripts.save_history())

    def _view(self) -> None:
        window = self._window
        menu = window.menuBar().addMenu("&View")
        for row, spec in enumerate(window.specs):
            self._action(menu, spec.title, lambda _=False, key=spec.key: window.go(key, None), page_key(row))
        menu.addSeparator()
        self._action(menu, "Command palette …", window.show_palette, "Ctrl+Shift+P")
        self._action(menu, "Enlarge the picture, or put it back", window.enlarge_picture, "Ctrl+E")
        self._action(menu, "Light or dark", window.toggle_theme, "Ctrl+T")
        self._action(menu, "Jobs", lambda: window.job_line.toggle(), "Ctrl+J")
        menu.addAction(window.log_dock.toggleViewAction())

    def _tools(self) -> None:
        tools = self._window.tools
        menu = self._window.menuBar().addMenu("&Tools")
        self._action(menu, "Verify …", lambda: tools.verify())
        self._action(menu, "Doctor …", lambda: tools.doctor())
        menu.addSeparator()
        self._action(menu, "Preferences …", lambda: tools.preferences(), "Ctrl+,")

    def _help(self) -> None:
        window, title = self._window, "Keyboard shortcuts"
        menu, sheet = window.menuBar().addMenu("&Help"), cheat_sheet(window.specs)
        self._action(menu, "Welcome …", lambda: window.tools.welcome())
        self._action(menu, title, lambda: QMessageBox.information(window, title, sheet), "F1")
        self._action(menu, "Fault atlas", lambda: window.show_manual(ATLAS))
        self._action(menu, "Open log folder", lambda: open_folder(log_folder()))
        self._action(menu, "About lfcal", lambda: QMessageBox.about(window, "About lfcal", about_text()))

    def _action(self, menu: Any, text: str, slot: Any, key: Any = None) -> QAction:
        action = QAction(text, self._window)
        if key is not None:
            action.setShortcut(QKeySequence(key))
        action.triggered.connect(slot)
        menu.addAction(action)
        return action
