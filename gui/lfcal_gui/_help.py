"""Windows of the menu Help: shortcuts, versions, check of the installation, and manual."""

from __future__ import annotations

import importlib.metadata
import platform
from pathlib import Path
from typing import Any

from PySide6.QtCore import QUrl
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QApplication, QDialog, QHBoxLayout, QPushButton, QTextBrowser, QVBoxLayout, QWidget

from lfcal.base import read_text
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import ATLAS, PageSpec, doctor_html, doctor_text, manual_folder, section_of
from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets import button, line

_KEYS = (
    ("Ctrl+1 … Ctrl+4, Alt+1 … Alt+3", "open Set up, Record, H or Use; switch its view"),
    ("Ctrl+Return", "do the next step, which is shown at the top"),
    ("Ctrl+M", "open Multiplexing"),
    ("Ctrl+Z, Ctrl+Shift+Z", "undo, redo"),
    ("Ctrl+N, Ctrl+O, Ctrl+S", "new, open, save project"),
    ("Ctrl+Shift+C", "copy an image of the page"),
    ("Ctrl+Shift+K, Ctrl+Shift+Y", "copy the page as a command, as Python"),
    ("Ctrl+K, Ctrl+Shift+P", "command palette"),
    ("F or Ctrl+E, Esc", "enlarge the image under the pointer, restore its size"),
    ("A", "automatic contrast"),
    ("Ctrl+I", "hide or show the column to the right of the images"),
    ("Ctrl+J", "show the jobs"),
    ("Tab, Alt+Down", "go to the next control; choose the file of a field"),
    ("Ctrl+T", "switch between the light and the dark theme"),
    ("F1", "show this list of shortcuts"),
)
"""Keyboard shortcuts of the window; the shortcuts of a page are in its `PageSpec`."""

_PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "h5py",
    "opencv-python-headless",
    "rawpy",
    "tifffile",
    "PySide6-Essentials",
    "pyqtgraph",
)


def cheat_sheet(pages: tuple[PageSpec, ...]) -> str:
    """Return the keyboard shortcuts of the window and of its pages as rich text."""
    shared: dict[tuple[str, str], list[str]] = {}
    for spec in pages:
        for pair in spec.keys:
            shared.setdefault(pair, []).append(spec.title)
    own = [(keys, f"{what} ({', '.join(titles)})") for (keys, what), titles in shared.items()]
    rows = "".join(f"<tr><td><b>{keys}</b>&nbsp;&nbsp;</td><td>{what}</td></tr>" for keys, what in (*_KEYS, *own))
    return f"<table>{rows}</table>"


def about_text() -> str:
    """Return name, licence and versions as rich text."""
    from lfcal import __version__

    lines = []
    for name in _PACKAGES:
        try:
            lines.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            lines.append(f"{name}: not installed")
    system = f"Python {platform.python_version()}, {platform.system()}"
    return (
        f"<h3>lfcal {__version__}</h3><p>PSF calibration and acquisition for plenoptic cameras.<br>"
        f"BSD-3-Clause licence.</p><p>{system}<br>{'<br>'.join(lines)}</p>"
    )


SIZE = (640, 560)


class DoctorDialog(QDialog):
    """Dialog with the report of ``lfcal doctor``, which is made in the background.

    The dialog lives as long as its window.
    """

    def __init__(self, jobs: Jobs, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Doctor")
        self.setStyleSheet(style_sheet())
        self.resize(*SIZE)
        self._found: dict[str, Any] = {}
        self.view = QTextBrowser()
        self.view.setAccessibleName("Report on this machine")
        self.view.setPlainText("Checking …")
        self.copy, close = QPushButton("Copy text"), QPushButton("Close")
        self.copy.setToolTip("Copy the report, for example for a bug report")
        close.setToolTip("Close this window. Help > Doctor opens it again")
        self.copy.setEnabled(False)
        self.copy.clicked.connect(lambda: QApplication.clipboard().setText(doctor_text(self._found)))
        close.clicked.connect(self.close)
        column = QVBoxLayout(self)
        column.addWidget(self.view, 1)
        column.addLayout(line(QWidget(), self.copy, close, stretch=0))
        self._jobs = jobs

    def look(self) -> None:
        """Make the report again."""
        from lfcal.cli import examine

        self.setStyleSheet(style_sheet())
        self._jobs.compute("doctor", examine, self._show, self.view.setPlainText)

    def _show(self, found: dict[str, Any]) -> None:
        self._found = found
        self.view.setHtml(doctor_html(found))
        self.copy.setEnabled(True)


MANUAL_SIZE = (760, 560)


class Manual(QDialog):
    """Window that shows a page of the manual or a section of it; links open other pages of the manual."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setStyleSheet(style_sheet())
        self.setWindowTitle("Manual")
        self.resize(*MANUAL_SIZE)
        self._page = ATLAS
        self.browser = QTextBrowser()
        self.browser.setOpenLinks(False)
        self.browser.setAccessibleName("Manual")
        self.browser.setToolTip("Links open other pages of the manual, or web pages")
        self.browser.anchorClicked.connect(self._follow)
        self.whole = button(
            "Full page", "Show the complete page that contains this section", lambda: self.show_page(self._page)
        )
        close = button("Close", "Close the manual. Help > Fault atlas opens it again", self.close)
        buttons = QHBoxLayout()
        buttons.addWidget(self.whole)
        buttons.addStretch()
        buttons.addWidget(close)
        column = QVBoxLayout(self)
        column.addWidget(self.browser, 1)
        column.addLayout(buttons)

    def show_page(self, page: str = ATLAS, name: str = "") -> None:
        """Show a page, or its section about ``name``; raise `LfcalError` if the manual is not installed."""
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
