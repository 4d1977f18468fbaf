"""A page in a separate window: multiplexing, accuracy, sessions."""

from __future__ import annotations

from PySide6.QtCore import QByteArray, QEvent, QSettings, Signal
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QMainWindow

from lfcal_gui._layouts import fit_screen
from lfcal_gui.base_page import BasePage
from lfcal_gui.theme import style_sheet


class PageWindow(QMainWindow):
    """Window of one page, with the actions of the main window. Closing it only hides it."""

    activated = Signal()
    """The window came to the front."""

    def __init__(self, page: BasePage, main: QMainWindow, settings: QSettings) -> None:
        super().__init__(main)
        self.page, self._settings = page, settings
        self.setWindowTitle(f"{page.spec.title} – lfcal")
        self.setCentralWidget(page)
        self.statusBar().addWidget(page.notice, 1)
        self.addActions(main.actions())
        fit_screen(self)
        kept = settings.value(self._key)
        if isinstance(kept, QByteArray):
            self.restoreGeometry(kept)
        self.apply_theme()

    @property
    def _key(self) -> str:
        return f"window/{self.page.spec.key}"

    def apply_theme(self) -> None:
        """Apply the colours of the current theme to the window; the page does this itself."""
        self.statusBar().setStyleSheet(style_sheet())

    def event(self, event: QEvent) -> bool:
        """Report when the window comes to the front."""
        if event.type() == QEvent.Type.WindowActivate:
            self.activated.emit()
        return super().event(event)

    def keep(self) -> None:
        """Store size and position on the screen for the next start."""
        self._settings.setValue(self._key, self.saveGeometry())

    def closeEvent(self, event: QCloseEvent) -> None:
        """Hide the window; the page and its jobs stay."""
        self.keep()
        super().closeEvent(event)
