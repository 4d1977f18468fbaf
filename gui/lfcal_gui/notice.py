"""The line of a page in the status bar: what it is waiting for, or why something was refused, until it is dismissed."""

from __future__ import annotations

import re
from collections.abc import Callable

from PySide6.QtCore import QPoint, Qt, QTimer
from PySide6.QtWidgets import QFrame, QHBoxLayout, QPushButton, QWidget

from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets import ElidedLabel, WrappedLabel, button, column_of, set_role

WAIT_MS = 300
"""Work that is done sooner is not announced."""

HEIGHT = 20
"""Of the buttons: a status bar is as low as without them (px)."""

LONG = re.compile(r"\S{2,}(\S{23})")
"""A path, and its end: where the line has no room for the message, the reason matters more than the whole path."""

WIDEST = 560
"""Width of a message that is shown whole (px)."""

DISMISS = "Hide this message. The log keeps it"
UNCHANGED = "Hide this message without any change"


class Notice(QFrame):
    """One line with one button, or two where it offers something; hidden where there is nothing to say.

    A button opens the whole message where the line has no room for it.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        row = QHBoxLayout(self)
        row.setContentsMargins(6, 0, 0, 0)
        self.label = ElidedLabel(sentence=True)
        self.more = button("Show all", "Open the full message, to read or copy it", self.show_whole)
        self.more.hide()
        self.label.elided.connect(self.more.setVisible)
        self.button = QPushButton()
        self.button.setAccessibleName("Reply to the notice")
        self.button.setToolTip(DISMISS)
        self.button.clicked.connect(self._pressed)
        self.leave = button("Leave as it is", UNCHANGED, self._leave)
        row.addWidget(self.label)
        for one in (self.more, self.leave, self.button):
            one.setProperty("role", "tight")
            one.setFixedHeight(HEIGHT)
            row.addWidget(one)
        row.addStretch(1)
        self._cancel: Callable[[], None] | None = None
        self._left: Callable[[], None] | None = None
        self._refused = False
        self._timer = QTimer(self, singleShot=True, interval=WAIT_MS)
        self._timer.timeout.connect(self.show)
        self.hide()

    def wait(self, text: str, cancel: Callable[[], None]) -> None:
        """Say what is being waited for, when it takes a while, with a button to wait no longer."""
        self._say(text, "Cancel", "hint", "Stop waiting. The page keeps its content")
        self._cancel = cancel
        self.hide()
        self._timer.start()

    def refuse(self, text: str) -> None:
        """Say why something was refused."""
        self._say(text, "Dismiss", "error")
        self._cancel = None
        self._refused = True
        self.show()

    def offer(
        self,
        text: str,
        button: str,
        action: Callable[[], None],
        leave: Callable[[], None] | None = None,
        *,
        tip: str,
        stay: str = "Leave as it is",
        stay_tip: str = UNCHANGED,
    ) -> None:
        """Say what was noticed, with a button that does something about it and one (``stay``) that leaves it.

        ``tip`` and ``stay_tip`` state what each button does.
        """
        self._say(text, button, "error", tip)
        self._cancel, self._left = action, leave
        self.leave.setText(stay)
        self.leave.setToolTip(stay_tip)
        self.leave.show()
        self.show()

    def show_note(self, text: str) -> None:
        """Show a note on something that was accepted."""
        self._say(text, "Dismiss", "hint")
        self._cancel = None
        self.show()

    def show_whole(self) -> WrappedLabel:
        """Show the whole message above the line, until a click elsewhere; return the label."""
        sheet, words = QFrame(self, Qt.WindowType.Popup), WrappedLabel(self.label.text())
        sheet.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        sheet.setProperty("role", "card")
        sheet.setStyleSheet(style_sheet())
        words.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        column_of(words, of=sheet).setContentsMargins(12, 10, 12, 10)
        width = min(WIDEST, self.window().width())
        sheet.setFixedSize(width, words.heightForWidth(width - 26) + 22)
        sheet.move(self.mapToGlobal(QPoint(0, -sheet.height() - 4)))
        sheet.show()
        return words

    def clear(self) -> None:
        """Say nothing."""
        self._refused = False
        self._timer.stop()
        self._cancel = self._left = None
        self.hide()

    def drop_refusal(self) -> None:
        """Clear the refusal: its context has changed."""
        if self._refused:
            self.clear()

    def _say(self, text: str, button: str, role: str, tip: str = DISMISS) -> None:
        self._refused = False
        self._timer.stop()
        self.leave.hide()
        self.label.setText(text, LONG.sub(r"…\1", text))
        self.button.setText(button)
        self.button.setAccessibleName(button)
        self.button.setToolTip(tip)
        set_role(self.label, role)

    def _pressed(self) -> None:
        cancel = self._cancel
        self.clear()
        if cancel is not None:
            cancel()

    def _leave(self) -> None:
        left = self._left
        self.clear()
        if left is not None:
            left()
