"""Size, docks and splitters of the window, stored for each page and each screen size."""

from __future__ import annotations

from PySide6.QtCore import QByteArray, QSettings, Qt
from PySide6.QtWidgets import QDockWidget, QMainWindow, QPlainTextEdit, QSplitter, QWidget


class Layouts:
    """Stores and restores the splitter positions of pages."""

    def __init__(self, settings: QSettings) -> None:
        self._settings = settings
        self._first: dict[str, tuple[QWidget, list[QByteArray]]] = {}

    def restore(self, key: str, page: QWidget) -> None:
        """Restore the splitter positions of a new page that were stored for this screen size."""
        splitters = page.findChildren(QSplitter)
        self._first[key] = page, [splitter.saveState() for splitter in splitters]
        for k, splitter in enumerate(splitters):
            kept = self._settings.value(f"{_group(page)}/{key}/{k}")
            if isinstance(kept, QByteArray):
                splitter.restoreState(kept)

    def keep(self) -> None:
        """Store the splitter positions of all pages for the next start."""
        for key, (page, _) in self._first.items():
            for k, splitter in enumerate(page.findChildren(QSplitter)):
                self._settings.setValue(f"{_group(page)}/{key}/{k}", splitter.saveState())

    def reset(self) -> None:
        """Reset all splitters to their initial positions, for every screen size."""
        self._settings.remove("layout")
        for page, states in self._first.values():
            for splitter, state in zip(page.findChildren(QSplitter), states, strict=False):
                splitter.restoreState(state)


def _group(page: QWidget) -> str:
    size = page.screen().size()
    return f"layout/{size.width()}x{size.height()}"


LINES = 2000
"""Number of newest lines that are kept."""


class LogView(QPlainTextEdit):
    """Read-only log, from which lines can be copied."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setReadOnly(True)
        self.setAccessibleName("Log")
        self.setToolTip("Messages since lfcal was started. Help > Open log folder shows the log file")
        self.setMaximumBlockCount(LINES)


def add_dock(window: QMainWindow, title: str, content: QWidget) -> QDockWidget:
    """Add a dock with ``content`` at the bottom of a window; its state is stored between starts under its title."""
    dock = QDockWidget(title, window)
    dock.setObjectName(title.lower())
    dock.setWidget(content)
    window.addDockWidget(Qt.DockWidgetArea.BottomDockWidgetArea, dock)
    return dock


SIZE = (1280, 800)

LEAST = 1000
"""Smallest width of the window at which all views fit (px)."""

TITLE = 40
"""Largest height of the system's title bar above the window (px)."""


def size_within(room: tuple[int, int]) -> tuple[int, int]:
    """Return the size of a new window on a screen with the free size ``room`` (width, height).

    It is the usual size if the screen is narrower than `LEAST`, because no smaller window would fit either.
    """
    width, height = room
    return SIZE if width < LEAST else (min(SIZE[0], width), min(SIZE[1], height - TITLE))


def fit_screen(window: QWidget) -> None:
    """Give a window the usual size, or less if it would not fit on its screen together with the title bar."""
    room = window.screen().availableGeometry()
    window.resize(*size_within((room.width(), room.height())))
