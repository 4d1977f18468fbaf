"""Size, docks and borders of the window, kept for each page and each size of screen."""

from __future__ import annotations

from PySide6.QtCore import QByteArray, QSettings, Qt
from PySide6.QtWidgets import QDockWidget, QMainWindow, QPlainTextEdit, QSplitter, QWidget


class Layouts:
    """Keeps and restores the splitters of pages."""

    def __init__(self, settings: QSettings) -> None:
        self._settings = settings
        self._first: dict[str, tuple[QWidget, list[QByteArray]]] = {}

    def restore(self, key: str, page: QWidget) -> None:
        """Give the splitters of a new page the sizes that were kept for this screen."""
        splitters = page.findChildren(QSplitter)
        self._first[key] = page, [splitter.saveState() for splitter in splitters]
        for k, splitter in enumerate(splitters):
            kept = self._settings.value(f"{_group(page)}/{key}/{k}")
            if isinstance(kept, QByteArray):
                splitter.restoreState(kept)

    def keep(self) -> None:
        """Keep the sizes of all pages for the next start."""
        for key, (page, _) in self._first.items():
            for k, splitter in enumerate(page.findChildren(QSplitter)):
                self._settings.setValue(f"{_group(page)}/{key}/{k}", splitter.saveState())

    def reset(self) -> None:
        """Give all splitters the sizes of the first start, on every screen."""
        self._settings.remove("layout")
        for page, states in self._first.values():
            for splitter, state in zip(page.findChildren(QSplitter), states, strict=False):
                splitter.restoreState(state)


def _group(page: QWidget) -> str:
    size = page.screen().size()
    return f"layout/{size.width()}x{size.height()}"


LINES = 2000
"""The last lines that are kept."""


class LogView(QPlainTextEdit):
    """Lines that are read, and copied, but not changed."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setReadOnly(True)
        self.setAccessibleName("Log")
        self.setToolTip("Messages since lfcal was started. Help > Open log folder shows the log file")
        self.setMaximumBlockCount(LINES)


def add_dock(window: QMainWindow, title: str, content: QWidget) -> QDockWidget:
    """Add a dock with ``content`` at the bottom of a window; it is kept between starts by its title."""
    dock = QDockWidget(title, window)
    dock.setObjectName(title.lower())
    dock.setWidget(content)
    window.addDockWidget(Qt.DockWidgetArea.BottomDockWidgetArea, dock)
    return dock


SIZE = (1280, 800)

LEAST = 1000
"""Width that all views fit into (px)."""

TITLE = 40
"""Height of the title bar that the system puts over the window, at the most (px)."""


def size_within(room: tuple[int, int]) -> tuple[int, int]:
    """Return the size of a new window on a screen with ``room`` for it; one narrower than `LEAST` holds none."""
    width, height = room
    return SIZE if width < LEAST else (min(SIZE[0], width), min(SIZE[1], height - TITLE))


def fit_screen(window: QWidget) -> None:
    """Give a window the usual size, less where its screen has no room for it under a title bar."""
    room = window.screen().availableGeometry()
    window.resize(*size_within((room.width(), room.height())))
