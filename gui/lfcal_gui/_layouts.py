"""Borders that a person moved, kept for each page and each size of screen."""

from __future__ import annotations

from PySide6.QtCore import QByteArray, QSettings
from PySide6.QtWidgets import QSplitter, QWidget

__all__ = ["Layouts"]


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
