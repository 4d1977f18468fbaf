"""The manual beside the window: a section of the atlas, links, the whole page."""

from __future__ import annotations

import pytest
from PySide6.QtCore import QUrl
from PySide6.QtGui import QTextDocument

import lfcal_gui._help
from lfcal.base.errors import StorageError
from lfcal_gui.window import MainWindow


def test_a_fault_is_shown_in_the_atlas_with_its_picture(window: MainWindow) -> None:
    window.context.help_asked.emit("faults.md", "ghost")
    manual = window._manual
    assert manual is not None and manual.isVisible() and manual.windowTitle() == "Manual: Ghost image"
    text = manual.browser.toPlainText()
    assert "Ghost image" in text and "What to do" in text and "Hot line" not in text
    picture = manual.browser.loadResource(
        QTextDocument.ResourceType.ImageResource.value, QUrl("images/faults/ghost.png")
    )
    assert picture
    manual.whole.click()
    assert "Hot line" in manual.browser.toPlainText() and not manual.whole.isEnabled()
    manual._follow(QUrl("quality.md"))
    assert "Hot line of the sensor" not in manual.windowTitle() and manual._page == "quality.md"
    # links lead into folders and back
    manual._follow(QUrl("tutorials/bad_psf.md"))
    assert manual._page == "tutorials/bad_psf.md" and "PSF" in manual.windowTitle()
    manual._follow(QUrl("../faults.md#ghost"))
    assert manual._page == "faults.md"
    manual._follow(QUrl("../README.md"))
    manual._follow(QUrl("nosuch.md"))
    assert manual._page == "faults.md", "only pages of the manual are shown"
    manual.close()


def test_without_the_manual_the_log_says_so(window: MainWindow, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone() -> None:
        raise StorageError("the manual: not part of this installation")

    monkeypatch.setattr(lfcal_gui._help, "manual_folder", gone)
    window.show_manual("faults.md")
    assert "not part of this installation" in window.log_view.toPlainText()
