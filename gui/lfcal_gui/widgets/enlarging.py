"""Enlarge a picture or plot to the size of its page."""

from __future__ import annotations

from collections.abc import Iterator

from PySide6.QtCore import QEvent, QObject, QSize, Qt
from PySide6.QtGui import QCursor, QKeyEvent
from PySide6.QtWidgets import QApplication, QFrame, QHBoxLayout, QSplitter, QVBoxLayout, QWidget

from lfcal_gui.widgets.cards import button

PICTURE, PAGE = "picture", "page"
"""Properties of widgets that can be enlarged, and of widgets that an enlarged picture fills."""

UNLIMITED = 16_777_215


def can_be_enlarged(widget: QWidget) -> None:
    """Mark ``widget`` as a picture or plot that can be enlarged."""
    widget.setProperty(PICTURE, True)


def whole_page(widget: QWidget) -> None:
    """Mark ``widget`` as the area that an enlarged picture fills; dialogs need no mark."""
    widget.setProperty(PAGE, True)


class _Kept(QWidget):
    """Placeholder of an enlarged part, with its current size as preferred size and its minimum size."""

    def __init__(self, part: QWidget) -> None:
        super().__init__()
        self._size = part.size()
        self.setSizePolicy(part.sizePolicy())
        self.setMinimumSize(part.minimumSizeHint().expandedTo(part.minimumSize()))

    def sizeHint(self) -> QSize:
        """Return the original size of the part."""
        return self._size


class Enlarged(QFrame):
    """Cover a page with one enlarged part of it, which stays active. Esc or a button restores it.

    Parameters
    ----------
    part
        The part to enlarge. An empty widget keeps its place meanwhile.
    page
        The page to cover.
    """

    def __init__(self, part: QWidget, page: QWidget) -> None:
        super().__init__(page)
        self.part, self._page = part, page
        self.setAutoFillBackground(True)
        self.setProperty("role", "card")
        self.setProperty("overlay", True)
        self._limits: tuple[QSize, QSize] = (part.minimumSize(), part.maximumSize())
        self._kept = _Kept(part)
        _exchange(part, self._kept)
        part.setMinimumSize(0, 0)
        part.setMaximumSize(UNLIMITED, UNLIMITED)
        self.back = button("Back (Esc)", "Return the image to its position on the page", self.put_back)
        row = QHBoxLayout()
        row.addStretch()
        row.addWidget(self.back)
        column = QVBoxLayout(self)
        column.setContentsMargins(10, 7, 10, 9)
        column.addLayout(row)
        column.addWidget(part, 1)
        page.installEventFilter(self)
        self.setGeometry(page.rect())
        self.show()
        part.show()
        self.raise_()
        self.setFocus(Qt.FocusReason.OtherFocusReason)

    def put_back(self) -> None:
        """Return the picture to its place."""
        self._page.removeEventFilter(self)
        layout = self.layout()
        if layout is not None:
            layout.removeWidget(self.part)
        self.part.setMinimumSize(self._limits[0])
        self.part.setMaximumSize(self._limits[1])
        _exchange(self._kept, self.part)
        self.part.show()
        self._kept.deleteLater()
        self.hide()
        self.setParent(None)
        self.deleteLater()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Follow the size of the page."""
        if watched is self._page and event.type() == QEvent.Type.Resize:
            self.setGeometry(self._page.rect())
        return False

    def event(self, event: QEvent) -> bool:
        """Handle Esc before the shortcuts of the page."""
        if event.type() == QEvent.Type.ShortcutOverride and isinstance(event, QKeyEvent):
            if event.key() == Qt.Key.Key_Escape:
                event.accept()
                return True
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Return the picture to its place when Escape is pressed; the page handles all other keys."""
        if event.key() == Qt.Key.Key_Escape:
            self.put_back()
        else:
            super().keyPressEvent(event)


def _exchange(old: QWidget, new: QWidget) -> None:
    """Replace ``old`` in its layout by ``new``."""
    parent = old.parentWidget()
    if isinstance(parent, QSplitter):
        parent.replaceWidget(parent.indexOf(old), new)
        return
    layout = None if parent is None else parent.layout()
    if layout is not None:
        layout.replaceWidget(old, new)  # also finds it in nested layouts
    old.setParent(None)


def _above(widget: QWidget) -> Iterator[QWidget]:
    parent = widget.parentWidget()
    while parent is not None:
        yield parent
        parent = parent.parentWidget()


def enlarged_of(picture: QWidget) -> Enlarged | None:
    """Return the `Enlarged` that contains ``picture``; None if it is not enlarged."""
    return next((one for one in _above(picture) if isinstance(one, Enlarged)), None)


def enlarge(picture: QWidget) -> Enlarged | None:
    """Enlarge ``picture`` to its whole page or dialog, or restore it; return its `Enlarged`, if any.

    A card without other pictures is enlarged together with its title and texts.
    """
    holder = enlarged_of(picture)
    if holder is not None:
        holder.put_back()
        return None
    above = list(_above(picture))
    page = next((one for one in above if one.property(PAGE) or one.isWindow()), None)
    frame = next((one for one in above if one.property("role") == "card"), picture)
    alone = frame is picture or len(pictures_in(frame)) == 1
    return None if page is None else Enlarged(frame if alone else picture, page)


def pictures_in(widget: QWidget) -> list[QWidget]:
    """Return all pictures and plots of ``widget``."""
    return [one for one in widget.findChildren(QWidget) if one.property(PICTURE)]


def toggle_in(page: QWidget) -> bool:
    """Enlarge the picture of ``page`` under the pointer or else the largest one, or restore an enlarged one.

    Returns
    -------
    bool
        Whether there was a picture.
    """
    for holder in page.findChildren(Enlarged):
        if holder.isVisible():
            holder.put_back()
            return True
    pictures = [one for one in pictures_in(page) if one.isVisible()]
    under = QApplication.widgetAt(QCursor.pos())
    chosen = next((w for w in pictures if under is not None and (w is under or w.isAncestorOf(under))), None)
    if chosen is None and pictures:
        most = max(one.width() * one.height() for one in pictures)
        chosen = next(one for one in pictures if one.width() * one.height() > 0.9 * most)
    if chosen is not None:
        enlarge(chosen)
    return chosen is not None
