"""Labels for texts that may not fit: cut to a single line, or wrapped.

Texts about files contain names, which may be long. No name makes a window wider, or is cut without notice.
"""

from __future__ import annotations

import re

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QContextMenuEvent, QFontMetrics, QFontMetricsF, QKeyEvent, QKeySequence, QResizeEvent
from PySide6.QtWidgets import QApplication, QLabel, QMenu, QPlainTextEdit, QWidget

from lfcal_gui.models import SPACE, minus, unbroken

BREAK = "\u200b"
"""Is not seen, and a line may end there."""

JOINTS = re.compile(r"(?<=[/\\_.,:=-])(?=[^\s/\\_.,:=-])")
RUNS = re.compile(r"(\S{24})(?=\S)")
LONGEST = 24
"""Letters of a word that is left whole."""


def breakable(text: str) -> str:
    """Return ``text`` with places in its long words where a line may end: at their joints, or else anywhere."""

    def broken(word: str) -> str:
        if len(word) <= LONGEST:
            return word
        return BREAK.join(RUNS.sub(rf"\1{BREAK}", part) for part in JOINTS.split(word))

    return "".join(part if part.isspace() else broken(part) for part in re.split(r"(\s+)", text))


def set_role(widget: QWidget, role: str) -> None:
    """Give a widget the look of a role, which follows the theme: of ``"error"``, ``"hint"``, or ``""`` of none."""
    set_look(widget, "role", role)


def set_look(widget: QWidget, name: str, value: object) -> None:
    """Set a property that the style sheet uses, and apply the style again, since Qt does not."""
    if (widget.property(name) or None) != (value or None):
        widget.setProperty(name, value)
        widget.style().unpolish(widget)
        widget.style().polish(widget)


def shortened(name: str, metrics: QFontMetricsF | QFontMetrics, room: float) -> str:
    """Return as much of the name of a quantity as there is room for (px); its unit in brackets stays."""
    words, bracket, unit = name.rpartition(" (")
    if not bracket or metrics.horizontalAdvance(name) <= room:
        return metrics.elidedText(name, Qt.TextElideMode.ElideRight, int(room))
    left = room - metrics.horizontalAdvance(bracket + unit)
    cut = metrics.elidedText(words, Qt.TextElideMode.ElideRight, int(left)) if left > 0 else ""
    return cut + bracket + unit if cut else metrics.elidedText(f"({unit}", Qt.TextElideMode.ElideRight, int(room))


class WrappedLabel(QLabel):
    """Text, wrapped. A long name is broken at the end of a line, but copied unchanged.

    Parameters
    ----------
    text
        What is shown.
    rich
        Whether a text may be HTML, which is shown as it is.
    role
        Its look.
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
        """Put what is selected on the clipboard, or all."""
        chosen = self.selectedText().replace(BREAK, "").replace(SPACE, " ").replace("−", "-") or self._whole
        QApplication.clipboard().setText(chosen)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Copy a name whole."""
        if event.matches(QKeySequence.StandardKey.Copy):
            self.copy()
            return
        super().keyPressEvent(event)

    def contextMenuEvent(self, event: QContextMenuEvent) -> None:
        """Offer to copy where text can be selected."""
        if not self.textInteractionFlags() & Qt.TextInteractionFlag.TextSelectableByMouse:
            super().contextMenuEvent(event)
            return
        menu = QMenu(self)
        menu.addAction("Copy").triggered.connect(lambda _=False: self.copy())
        menu.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        menu.popup(event.globalPos())


class ElidedLabel(QLabel):
    """Text of one or two lines. If it does not fit, a part is left out, and the tooltip shows all of it.

    Parameters
    ----------
    text
        A name, or a sentence.
    sentence
        Whether the end is left out, as of a sentence, and not the middle, as of a name.
    lines
        Most lines.
    role
        Its look.
    """

    elided = Signal(bool, arguments=["part"])
    """Whether a part is left out now."""

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
        """Show ``text``, as much as there is room for; ``brief`` in its place where not all of it fits."""
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
        """Return that no word needs room."""
        return QSize(0, super().minimumSizeHint().height())

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Leave out more, or less."""
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
"""Width of text in a window that is no wider than the smallest one of the program (px)."""


def lines_px(view: QPlainTextEdit) -> int:
    """Return the width that ``view`` needs for its longest line, up to that of a small window (px)."""
    view.ensurePolished()
    metrics = view.fontMetrics()
    longest = max((metrics.horizontalAdvance(line) for line in view.toPlainText().splitlines()), default=0)
    return min(WIDEST, longest + BESIDE)
