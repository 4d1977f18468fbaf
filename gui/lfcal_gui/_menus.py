"""The menus of the window, with all actions and their keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide6.QtGui import QAction, QKeySequence
from PySide6.QtWidgets import QMenu, QMessageBox

from lfcal_gui._help import about_text, cheat_sheet
from lfcal_gui.crash_dialog import open_folder
from lfcal_gui.log import log_folder
from lfcal_gui.models import ATLAS, PLACES, PageSpec, PageState

VIEW_KEYS = 3
"""Number of views of a place that have keys."""

OWN_KEYS = {"multiplex": "Ctrl+M"}
"""Keys of pages that open in a separate window."""


class WindowMenus:
    """Menus of a `lfcal_gui.window.MainWindow`, which renames ``undo`` and ``redo`` as the project changes."""

    def __init__(self, window: Any) -> None:
        self._window = window
        self.menus: list[QMenu] = []
        self.own: dict[PageSpec, QAction] = {}
        self._project()
        self._edit()
        self._view()
        self._tools()
        self._help()
        self._more()
        bar = window.menuBar()
        for action in bar.actions():
            window.header.menu.addAction(action)
        if not bar.isNativeMenuBar():
            bar.hide()  # keys work all the same: the window has the actions, too
            self._act("Menus", window.header.button.showMenu, "F10")
        else:
            window.header.button.hide()

    def _project(self) -> None:
        window, files, keys = self._window, self._window.files, QKeySequence.StandardKey
        menu = self._menu("&Project")
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
        menu = self._menu("&Edit")
        self.undo = self._action(menu, "Undo", window.project.undo, QKeySequence.StandardKey.Undo)
        self.redo = self._action(menu, "Redo", window.project.redo, QKeySequence.StandardKey.Redo)
        menu.addSeparator()
        self._action(menu, "Copy image of the page", window.copy_page, "Ctrl+Shift+C")
        self._action(menu, "Copy page as command", lambda: window.scripts.copy_step(), "Ctrl+Shift+K")
        self._action(menu, "Copy page as Python", lambda: window.scripts.copy_step(python=True), "Ctrl+Shift+Y")
        self._action(menu, "Copy history as a script", lambda: window.scripts.copy_history(), "Ctrl+Shift+H")
        self._action(menu, "Save history as a script …", lambda: window.scripts.save_history())

    def _view(self) -> None:
        window = self._window
        menu = self._menu("&View")
        for number, place in enumerate(PLACES, 1):
            self._action(menu, place.title, lambda _=False, key=place.key: window.go_place(key), f"Ctrl+{number}")
        menu.addSeparator()
        for place in PLACES:
            views = window.views(place.key)
            for spec in views if len(views) > 1 else ():
                name = f"{place.title}: {spec.title}"
                self._action(menu, name, lambda _=False, key=spec.key: window.go(key))
        for number in range(VIEW_KEYS):
            self._act(f"View {number + 1}", lambda _=False, number=number: window.go_view(number), f"Alt+{number + 1}")
        menu.addSeparator()
        palette = self._action(menu, "Command palette …", window.show_palette)
        palette.setShortcuts([QKeySequence("Ctrl+K"), QKeySequence("Ctrl+Shift+P")])
        self._action(menu, "Enlarge or restore the image", window.enlarge_picture, "Ctrl+E")
        self._action(menu, "Light or dark theme", window.toggle_theme, "Ctrl+T")
        self._action(menu, "Jobs", lambda: window.job_line.toggle(), "Ctrl+J")
        menu.addAction(window.log_dock.toggleViewAction())
        self._action(menu, "Reset the layout", window.reset_layout)

    def _more(self) -> None:
        """Fill the menu at the bottom of the rail: pages that open in a separate window, and the log."""
        window = self._window
        menu = window.rail.menu
        self.own = {
            spec: self._action(menu, spec.title, lambda _=False, key=spec.key: window.go(key), OWN_KEYS.get(spec.key))
            for spec in window.views("")
        }
        menu.addSeparator()
        menu.addAction(window.log_dock.toggleViewAction())

    def _tools(self) -> None:
        tools = self._window.tools
        menu = self._menu("&Tools")
        self._action(menu, "Verify …", lambda: tools.verify())
        self._action(menu, "Doctor …", lambda: tools.doctor())
        menu.addSeparator()
        self._action(menu, "Preferences …", lambda: tools.preferences(), "Ctrl+,")

    def _help(self) -> None:
        window, title = self._window, "Keyboard shortcuts"
        menu, sheet = self._menu("&Help"), cheat_sheet(window.specs)
        self._action(menu, "Welcome …", lambda: window.tools.welcome())
        self._action(menu, title, lambda: QMessageBox.information(window, title, sheet), "F1")
        self._action(menu, "Fault atlas", lambda: window.show_manual(ATLAS))
        self._action(menu, "Open log folder", lambda: open_folder(log_folder()))
        self._action(menu, "About lfcal", lambda: QMessageBox.about(window, "About lfcal", about_text()))

    def mark(self, states: Mapping[str, PageState]) -> None:
        """Show the state of pages that open in a separate window."""
        for spec, action in self.own.items():
            action.setText(f"{spec.title} ({states[spec.key].value})")

    def _menu(self, title: str) -> QMenu:
        made: QMenu = self._window.menuBar().addMenu(title)
        self.menus.append(made)
        return made

    def _action(self, menu: Any, text: str, slot: Any, key: Any = None) -> QAction:
        action = self._act(text, slot, key)
        menu.addAction(action)
        return action

    def _act(self, text: str, slot: Any, key: Any = None) -> QAction:
        """Return an action whose key works in the main window and in the windows of pages."""
        action = QAction(text, self._window)
        if key is not None:
            action.setShortcut(QKeySequence(key))
        action.triggered.connect(slot)
        self._window.addAction(action)
        return action
