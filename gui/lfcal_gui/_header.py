"""The header: menus, name of the project, and the next step as a sentence with a button."""

from __future__ import annotations

import time

from PySide6.QtCore import QPoint, Qt, QTimer, Signal
from PySide6.QtGui import QAction, QCursor, QKeySequence, QShortcut
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QMenu, QPushButton, QToolButton, QVBoxLayout, QWidget

from lfcal_gui.models import Step
from lfcal_gui.widgets import ElidedLabel, row_of

NEAR_PX, NEAR_S, HELD_S, POLL_MS = 24, 2.0, 0.4, 100
"""Distance between pointer and buttons below which a change is delayed (px), longest delay (s), shortest time between
two changes (s), and period of the check (ms)."""


class NextLine(QWidget):
    """Display of a `Step`, with a second button for an optional step.

    While the user is about to press a button, a step with other buttons is not shown yet.
    """

    pressed = Signal(str, arguments=["action"])
    """The button, or Stop next to it, was pressed."""
    declined = Signal(str, str, arguments=["action", "place"])
    """The user declined an optional step."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.step: Step | None = None
        self._wanted: Step | None = None
        self._changed = self._due = 0.0
        self.lead, self.words = QLabel(), ElidedLabel(sentence=True, lines=3)
        self.lead.setProperty("role", "lead")
        self.words.setProperty("role", "next")
        self.stop, self.other, self.button = QPushButton("Stop"), QPushButton(), QPushButton()
        self.stop.setToolTip("Finish the current position, then stop the recording")
        self.button.setProperty("role", "primary")
        row = row_of(self.lead, self.words, of=self, spacing=8, stretch=1)
        for button in (self.stop, self.other, self.button):
            row.addWidget(button)
        self.stop.clicked.connect(lambda: self.step and self.pressed.emit(self.step.stop))
        self.button.clicked.connect(self.press)
        self.other.clicked.connect(lambda: self.step and self.step.other and self.pressed.emit(self.step.other.action))
        self.stop.hide()
        self.other.hide()
        self.not_now = QAction("Not now", self)
        self.not_now.setShortcut(QKeySequence.StandardKey.Delete)
        self.not_now.setShortcutContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
        self.not_now.triggered.connect(self._decline)
        self.addAction(self.not_now)
        self.setContextMenuPolicy(Qt.ContextMenuPolicy.ActionsContextMenu)
        self._key = QShortcut(QKeySequence("Ctrl+Return"), self)
        self._key.setContext(Qt.ShortcutContext.WindowShortcut)
        self._key.activated.connect(self.button.click)
        self._later = QTimer(self, interval=POLL_MS)
        self._later.timeout.connect(self._settle)

    def show_step(self, step: Step) -> None:
        """Show a step."""
        self._wanted = step
        self._settle()

    def press(self) -> None:
        """Emit the action of the button."""
        if self.step is not None:
            self.pressed.emit(self.step.action)

    def _decline(self) -> None:
        optional = _optional(self.step)
        if optional is not None:
            self.declined.emit(optional.action, optional.place)

    def _settle(self) -> None:
        """Update sentence and buttons, unless the user is about to press one."""
        step, shown = self._wanted, self.step
        if step is None:
            return
        same = shown is not None and _button(step) == _button(shown)
        now = time.monotonic()
        if not self._later.isActive():
            self._due = now + NEAR_S
        if not same and shown is not None and (now - self._changed < HELD_S or (now < self._due and self._near())):
            self._later.start()
            return
        self._later.stop()
        self.step = step
        self.lead.setText(f"{step.lead}:")
        self.words.setText(step.words)
        self.setAccessibleName(step.line)
        self.not_now.setEnabled(_optional(step) is not None)
        if same:
            return
        self._changed = now
        self._show_buttons(step)

    def _show_buttons(self, step: Step) -> None:
        self.button.setText(step.button)
        tip = f"{step.button} (Ctrl+Return)"
        self.button.setToolTip(f"{tip}. Del: skip this step for now" if step.optional else tip)
        self.stop.setVisible(bool(step.stop))
        self.other.setVisible(step.other is not None)
        if step.other is not None:
            self.other.setText(step.other.button)
            self.other.setToolTip(f"Optional: {step.other.words} Del: skip this step for now")

    def _near(self) -> bool:
        """Return whether the pointer is near the buttons."""
        if not self.isVisible():
            return False
        at = self.pointer()
        return any(
            one.isVisible()
            and one.rect().adjusted(-NEAR_PX, -NEAR_PX, NEAR_PX, NEAR_PX).contains(one.mapFromGlobal(at))
            for one in (self.button, self.other, self.stop)
        )

    @staticmethod
    def pointer() -> QPoint:
        """Return the position of the pointer on the screen."""
        return QCursor.pos()


def _button(step: Step) -> tuple[object, ...]:
    return step.button, step.action, step.stop, step.optional, step.other


def _optional(step: Step | None) -> Step | None:
    """Return the optional step; None if there is none."""
    return step if step is None or step.optional else step.other


HEIGHT, NAME = 54, 190
"""Height of the header, and largest width of the project's name (px)."""


class HeaderBar(QFrame):
    """Menu button, name of the project, and space (``lead``) for the next step."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("header")
        self.setFixedHeight(HEIGHT)
        self.menu = QMenu(self)
        self.button = QToolButton()
        self.button.setText("☰")
        self.button.setProperty("role", "bare")
        self.button.setAccessibleName("Menus")
        self.button.setToolTip("Open the menu (F10)")
        self.button.setPopupMode(QToolButton.ToolButtonPopupMode.InstantPopup)
        self.button.setMenu(self.menu)
        self.name, self.saved = ElidedLabel(), ElidedLabel()
        self.name.setProperty("role", "heading")
        self.name.setMaximumWidth(NAME)
        self.saved.setProperty("role", "hint")
        self.saved.setProperty("size", "caption")
        names = QVBoxLayout()
        names.setSpacing(0)
        names.addStretch()
        for label in (self.name, self.saved):
            names.addWidget(label)
        names.addStretch()
        self.lead = QHBoxLayout()
        row = QHBoxLayout(self)
        row.setContentsMargins(14, 0, 16, 0)
        row.setSpacing(14)
        row.addWidget(self.button)
        row.addLayout(names)
        row.addSpacing(14)
        row.addLayout(self.lead, 1)

    def say(self, name: str, *, unsaved: bool) -> None:
        """Show the project's name, and whether it has unsaved changes."""
        self.name.setText(name)
        self.saved.setText("not saved" if unsaved else "saved")
