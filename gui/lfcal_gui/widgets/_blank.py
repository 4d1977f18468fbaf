"""Message of an empty picture or plot, whose axes then have no tick labels."""

from __future__ import annotations

import pyqtgraph as pg
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QPalette
from PySide6.QtWidgets import QLabel

from lfcal_gui.theme import current_theme
from lfcal_gui.widgets._axes import Plot

NOTHING = "Nothing to show yet."


class Blank(QLabel):
    """A line of text in the middle of ``box`` on ``graphics``; ``words`` can be changed.

    If the box belongs to a ``plot``, the axes have no numbers while the text is shown. If ``dark``, the text has the
    colour for the dark background of a picture. `wait` shows what is being read or made instead of the text.
    """

    def __init__(
        self, graphics: pg.GraphicsView, box: pg.ViewBox, plot: Plot | None = None, *, dark: bool = False
    ) -> None:
        super().__init__(graphics)
        self._graphics, self._box, self._plot, self._dark = graphics, box, plot, dark
        self._words, self._waits, self._shown = NOTHING, "", False
        self.setWordWrap(True)
        self.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.hide()
        box.sigResized.connect(self._fill)

    @property
    def words(self) -> str:
        """The message shown if no picture is being read or made."""
        return self._words

    @words.setter
    def words(self, words: str) -> None:
        self._words, self._waits = words, ""
        self.setText(words)

    def wait(self, words: str) -> None:
        """Show what is being read or made, until there is a picture or `words` is set; empty: show `words` again."""
        self._waits = words
        self.setText(words or self._words)

    @property
    def shown(self) -> bool:
        """Whether the message is shown."""
        return self._shown

    def show_blank(self, blank: bool) -> None:
        """Show the message and hide the tick labels, or the reverse."""
        if blank == self._shown:
            return
        self._shown = blank
        if not blank:
            self._waits = ""
        for side in ("bottom", "left") if self._plot is not None else ():
            self._plot.getAxis(side).setTicks([] if blank else None)
        if blank:
            self.setText(self._waits or self._words)
            self.apply_theme()
        self.setVisible(blank)
        self._fill()

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        theme = current_theme()
        colours = self.palette()
        colours.setColor(QPalette.ColorRole.WindowText, QColor(theme.canvas_text if self._dark else theme.muted))
        self.setPalette(colours)

    def _fill(self) -> None:
        """Cover the inside of the plot, unless the plot is hidden."""
        if not self._shown:
            return
        inside = self._graphics.mapFromScene(self._box.sceneBoundingRect()).boundingRect()
        self.setGeometry(inside.adjusted(4, 4, -4, -4))
