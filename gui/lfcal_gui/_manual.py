"""The manual in a window of its own, which stays beside the one that is worked in."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QUrl
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QDialog, QHBoxLayout, QPushButton, QTextBrowser, QVBoxLayout, QWidget

from lfcal.base import read_text
from lfcal_gui.models import ATLAS, manual_folder, section_of
from lfcal_gui.theme import style_sheet

__all__ = ["Manual"]

SIZE = (760, 620)


class Manual(QDialog):
    """Shows a page, or one section of it; links lead on within the manual."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setStyleSheet(style_sheet())
        self.setWindowTitle("Manual")
        self.resize(*SIZE)
        self._page = ATLAS
        self.browser = QTextBrowser()
        self.browser.setOpenLinks(False)
        self.browser.setAccessibleName("manual")
        self.browser.setToolTip("Links lead on, to other pages of the manual and to the web")
        self.browser.anchorClicked.connect(self._follow)
        self.whole = QPushButton("Whole page")
        self.whole.setToolTip("All of the page that this section is part of")
        self.whole.clicked.connect(lambda: self.show_page(self._page))
        close = QPushButton("Close")
        close.setToolTip("Close the manual; the names of faults in the checks of H open it again")
        close.clicked.connect(self.close)
        buttons = QHBoxLayout()
        buttons.addWidget(self.whole)
        buttons.addStretch()
        buttons.addWidget(close)
        column = QVBoxLayout(self)
        column.addWidget(self.browser, 1)
        column.addLayout(buttons)

    def show_page(self, page: str = ATLAS, name: str = "") -> None:
        """Show a page, or its section about ``name``; raises `LfcalError` where the manual is not installed."""
        path = manual_folder() / page
        text, folder = read_text(path), path.parent
        shown = section_of(text, name) if name else text
        self._page = page
        self.browser.setSearchPaths([str(folder)])
        self.browser.document().setBaseUrl(QUrl.fromLocalFile(f"{folder}/"))
        self.browser.setMarkdown(shown)
        self.whole.setEnabled(shown != text)
        self.setWindowTitle(f"Manual: {shown.splitlines()[0].lstrip('# ')}")
        self.show()
        self.raise_()

    def _follow(self, link: QUrl) -> None:
        if link.scheme() in ("http", "https"):
            QDesktopServices.openUrl(link)
            return
        folder = manual_folder()
        path = Path(link.path()) if link.isLocalFile() else (folder / self._page).parent / link.path()
        path = path.resolve()
        if path.suffix == ".md" and path.is_file() and path.is_relative_to(folder):
            self.show_page(path.relative_to(folder).as_posix())
