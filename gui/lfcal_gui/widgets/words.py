"""Labels for texts that may not fit: shortened or wrapped.

File names in texts may be long. They never make a window wider, and are never cut without an ellipsis.
"""

from __future__ import annotations

import re

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QContextMenuEvent, QFontMetrics, QFontMetricsF, QKeyEvent, QKeySequence, QResizeEvent
from PySide6.QtWidgets import QApplication, QLabel, QMenu, QPlainTextEdit, QWidget

from lfcal_gui.models import SPACE, minus, unbroken

BREAK = "\u200b"
"""Invisible character at which a line may be broken."""

JOINTS = re.compile(r"(?<=[/\\_.,:=-])(?=[^\s/\\_.,:=-])")
RUNS = re.compile(r"(\S{24})(?=\S)")
LONGEST = 24
"""Number of letters of the longest word that is not broken."""


def breakable(text: str) -> str:
    """Return ``text`` with invisible line-break positions in long words: at separators, or else anywhere."""

    def broken(word: str) -> str:
        if len(word) <= LONGEST:
            return word
        return BREAK.join(RUNS.sub(rf"\1{BREAK}", part) for part in JOINTS.split(word))

    return "".join(part if part.isspace() else broken(part) for part in re.split(r"(\s+)", text))


def set_role(widget: QWidget, role: str) -> None:
    """Give a widget the style of a role in the theme: ``"error"``, ``"hint"``, or ``""`` for none."""
    set_look(widget, "role", role)


def set_look(widget: QWidget, name: str, value: object) -> None:
    """Set a property that the style sheet uses, and apply the style again, because Qt does not."""
    if (widget.property(name) or None) != (value or None):
        widget.setProperty(name, value)
        if widget.testAttribute(Qt.WidgetAttribute.WA_WState_Polished):  # else Qt does so when it is first shown
            widget.style().unpolish(widget)
            widget.style().polish(widget)


def shortened(name: str, metrics: QFontMetricsF | QFontMetrics, room: float) -> str:
    """Return the name of a quantity shortened to a width (px); its unit in brackets is kept."""
    words, bracket, unit = name.rpartition(" (")
    if not bracket or metrics.horizontalAdvance(name) <= room:
        return metrics.elidedText(name, Qt.TextElideMode.ElideRight, int(room))
    left = room - metrics.horizontalAdvance(bracket + unit)
    cut = metrics.elidedText(words, Qt.TextElideMode.ElideRight, int(left)) if left > 0 else ""
    return cut + bracket + unit if cut else metrics.elidedText(f"({unit}", Qt.TextElideMode.ElideRight, int(room))


class WrappedLabel(QLabel):
    """A wrapped text. Long names are broken at the end of a line, but copied unchanged.

    Parameters
    ----------
    text
        What is shown.
    rich
        Whether the text may be rich text (HTML).
    role
        Role that determines its style.
    """

    def __init__(
        self, text: str = "", parent: QWidget | None = None, *, rich: bool = False, role: str | None = None
    ) -> None:
        super().__init__(parent)
        self.setProperty("role", role)
        self._whole = ""
        self.setTextFormat(Qt.TextFormat.AutoText if rich else Qt.TextFormat.PlainText)
        self.setWordWrap(True)
        self.setText(text)

    def setText(self, text: str) -> None:
        """Show ``text``."""
        self._whole = text
        html = self.textFormat() != Qt.TextFormat.PlainText and "<" in text
        super().setText(minus(text if html else breakable(unbroken(text))))

    def text(self) -> str:
        """Return the text as it was given."""
        return self._whole

    def copy(self) -> None:
        """Copy the selected text, or all, to the clipboard."""
        chosen = self.selectedText().replace(BREAK, "").replace(SPACE, " ").replace("−", "-") or self._whole
        QApplication.clipboard().setText(chosen)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Copy names without the invisible line breaks."""
        if event.matches(QKeySequence.StandardKey.Copy):
            self.copy()
            return
        super().keyPressEvent(event)

    def contextMenuEvent(self, event: QContextMenuEvent) -> None:
        """Offer to copy if text can be selected."""
        if not self.textInteractionFlags() & Qt.TextInteractionFlag.TextSelectableByMouse:
            super().contextMenuEvent(event)
            return
        menu = QMenu(self)
        menu.addAction("Copy").triggered.connect(lambda _=False: self.copy())
        menu.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        menu.popup(event.globalPos())


class ElidedLabel(QLabel):
    """A text of one or two lines. If it does not fit, it is shortened, and the tooltip shows all of it.

    Parameters
    ----------
    text
        A name, or a sentence.
    sentence
        Whether the end is omitted, as for a sentence; otherwise the middle, as for a name.
    lines
        Largest number of lines.
    role
        Role that determines its style.
    """

    elided = Signal(bool, arguments=["part"])
    """Whether the text is shortened."""

    def __init__(
        self,
        text: str = "",
        parent: QWidget | None = None,
        *,
        sentence: bool = False,
        lines: int = 1,
        role: str | None = None,
    ) -> None:
        super().__init__(parent)
        self.setProperty("role", role)
        self._whole, self._brief, self._lines = "", "", lines
        self._mode = Qt.TextElideMode.ElideRight if sentence else Qt.TextElideMode.ElideMiddle
        self.setTextFormat(Qt.TextFormat.PlainText)
        self.setText(text)

    def setText(self, text: str, brief: str = "") -> None:
        """Show ``text``, shortened if necessary; if ``brief`` is given, show this instead of a shortened text."""
        self._whole, self._brief = text, brief
        self.updateGeometry()
        self._fit()

    def text(self) -> str:
        """Return the text as it was given."""
        return self._whole

    def sizeHint(self) -> QSize:
        """Return the size of all words without a line break."""
        margins = self.contentsMargins()
        across = self.fontMetrics().horizontalAdvance(self._whole) + margins.left() + margins.right() + 2
        return QSize(across, super().sizeHint().height())

    def minimumSizeHint(self) -> QSize:
        """Return a minimal width, so that the text never makes the window wider."""
        return QSize(0, super().minimumSizeHint().height())

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Shorten the text for the new size."""
        super().resizeEvent(event)
        self._fit()

    def _fit(self) -> None:
        room = self.contentsRect().width()
        whole, metrics = minus(unbroken(self._whole) if self._lines > 1 else self._whole), self.fontMetrics()
        brief = bool(self._brief) and metrics.horizontalAdvance(whole) > self._lines * room
        rest, shown = minus(self._brief) if brief else whole, []
        while len(shown) < self._lines - 1 and metrics.horizontalAdvance(rest) > room:
            ends = [k for k, letter in enumerate(rest) if letter == " " and metrics.horizontalAdvance(rest[:k]) <= room]
            if not ends:
                break
            shown.append(rest[: ends[-1]])
            rest = rest[ends[-1] + 1 :]
        last = metrics.elidedText(rest, self._mode, room)
        super().setText("\n".join((*shown, last)))
        short = brief or last != rest
        self.setToolTip(self._whole if short else "")
        self.elided.emit(short)


BESIDE = 42
"""Width of margins, frame and a vertical scroll bar next to text (px)."""

WIDEST = 1180
"""Width of text in the smallest window of the program (px)."""


def lines_px(view: QPlainTextEdit) -> int:
    """Return the width that ``view`` needs for its longest line (px), at most that of a small window."""
    view.ensurePolished()
    metrics = view.fontMetrics()
    longest = max((metrics.horizontalAdvance(line) for line in view.toPlainText().splitlines()), default=0)
    return min(WIDEST, longest + BESIDE)
