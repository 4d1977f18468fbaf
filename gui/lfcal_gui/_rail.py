"""The rail: the four places, each with a word on its state, and the menu *More*."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import QPointF, Qt, Signal
from PySide6.QtGui import QColor, QPainter, QPen, QPixmap
from PySide6.QtWidgets import QFrame, QLabel, QMenu, QPushButton, QVBoxLayout, QWidget

from lfcal_gui.models import PLACES
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import set_role

WIDTH, BUTTON, ICON = 89, (83, 84), 22
"""Width of the rail, size of its buttons with words in two lines, and side of an icon (px)."""

BAR = 3
"""Width of the bar to the left of the current place (px)."""

MARKS = {"good": "✓ ", "fair": "▲ ", "bad": "▲ "}
"""Sign before a word, so that its meaning does not depend on colour alone."""


class Rail(QFrame):
    """Buttons of the places, of which one is checked."""

    chosen = Signal(str, arguments=["place"])
    """Key of a place that was clicked."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("rail")
        self.setFixedWidth(WIDTH)
        column = QVBoxLayout(self)
        column.setContentsMargins(3, 8, 3, 8)
        column.setSpacing(4)
        self._buttons: dict[str, RailButton] = {}
        for number, place in enumerate(PLACES, 1):
            button = self._buttons[place.key] = RailButton(place.title, ICONS[place.key])
            button.setToolTip(f"{place.question} (Ctrl+{number})")
            button.clicked.connect(lambda _=False, key=place.key: self.chosen.emit(key))
            column.addWidget(button)
        column.addStretch()
        self.menu = QMenu(self)
        self.more = RailButton("More", _dots)
        self.more.setCheckable(False)
        self.more.setToolTip("Open Multiplexing, Accuracy, Watch H, Sessions or the log")
        self.more.clicked.connect(self._open_menu)
        column.addWidget(self.more)
        self.apply_theme()

    def _open_menu(self) -> None:
        corner = self.more.mapToGlobal(self.more.rect().topRight())
        self.menu.popup(corner)

    def show_place(self, place: str) -> None:
        """Check the button of a place; for an unknown place, check none."""
        for key, button in self._buttons.items():
            button.setChecked(key == place)
        self.apply_theme()

    def say(self, place: str, word: str, mark: str = "") -> None:
        """Show the state of a place as a word with the mark ``"good"``, ``"fair"``, ``"bad"`` or none."""
        self._buttons[place].say(word, mark)

    def word(self, place: str) -> str:
        """Return the word below a place."""
        return self._buttons[place].word.text()

    def apply_theme(self) -> None:
        """Draw the icons in the colours of the current theme."""
        for button in (*self._buttons.values(), self.more):
            button.apply_theme()


class RailButton(QPushButton):
    """Button with an icon, a title, and a word below it."""

    def __init__(self, title: str, draw: Callable[[QPainter], None], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._title, self._draw = title, draw
        self.setProperty("role", "rail")
        self.setCheckable(True)
        self.setAutoExclusive(False)
        self.setFixedSize(*BUTTON)
        self.setAccessibleName(title)
        column = QVBoxLayout(self)
        column.setContentsMargins(BAR, 5, BAR, 3)
        column.setSpacing(1)
        self.icon_label, self.title, self.word = QLabel(), QLabel(title), QLabel()
        self.title.setProperty("role", "heading")
        for label in (self.icon_label, self.title, self.word):
            label.setAlignment(Qt.AlignmentFlag.AlignCenter)
            label.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
            column.addWidget(label)
        self.word.setAlignment(Qt.AlignmentFlag.AlignHCenter | Qt.AlignmentFlag.AlignTop)
        self.word.setWordWrap(True)
        self.word.setProperty("size", "caption")
        column.setStretchFactor(self.word, 1)

    def nextCheckState(self) -> None:
        """Do nothing on a click, because the window sets the checked button."""

    def say(self, word: str, mark: str) -> None:
        """Show ``word``."""
        self.word.setText(MARKS.get(mark, "") + word)
        set_role(self.word, mark or "hint")
        self.setAccessibleName(f"{self._title}: {word}")

    def apply_theme(self) -> None:
        """Draw the icon in the colour of the theme."""
        theme = current_theme()
        pixmap = QPixmap(2 * ICON, 2 * ICON)
        pixmap.setDevicePixelRatio(2)  # sharp on any screen
        pixmap.fill(Qt.GlobalColor.transparent)
        painter = QPainter(pixmap)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        colour = QColor(theme.accent if self.isChecked() else theme.text)
        painter.setPen(QPen(colour, 1.6, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
        self._draw(painter)
        painter.end()
        self.icon_label.setPixmap(pixmap)


def _sliders(painter: QPainter) -> None:
    for x, y in ((13, 5), (7, 11), (16, 17)):
        painter.drawLine(2, y, 20, y)
        _discs(painter, 2.2, (x, y))


def _button(painter: QPainter) -> None:
    painter.drawEllipse(QPointF(11, 11), 8.5, 8.5)
    _discs(painter, 4, (11, 11))


def _pattern(painter: QPainter) -> None:
    _discs(painter, 1.1, (6.5, 4), (15.5, 4), (2, 11), (11, 11), (20, 11), (6.5, 18), (15.5, 18))


def _cube(painter: QPainter) -> None:
    outer = [QPointF(x, y) for x, y in ((11, 2), (19, 6.5), (19, 15.5), (11, 20), (3, 15.5), (3, 6.5), (11, 2))]
    painter.drawPolyline(outer)
    painter.drawPolyline([QPointF(11, 20), QPointF(11, 11), QPointF(19, 6.5)])
    painter.drawLine(11, 11, 3, 6)


def _dots(painter: QPainter) -> None:
    _discs(painter, 1.1, (4, 11), (11, 11), (18, 11))


def _discs(painter: QPainter, radius: float, *centres: tuple[float, float]) -> None:
    painter.setBrush(painter.pen().color())
    for x, y in centres:
        painter.drawEllipse(QPointF(x, y), radius, radius)
    painter.setBrush(Qt.BrushStyle.NoBrush)


ICONS: dict[str, Callable[[QPainter], None]] = {
    "setup": _sliders,
    "record": _button,
    "h": _pattern,
    "use": _cube,
}
