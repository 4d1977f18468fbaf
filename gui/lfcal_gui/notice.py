"""Notice of a page in the status bar: what the page waits for, or why something was refused, until it is dismissed."""

from __future__ import annotations

import re
from collections.abc import Callable

from PySide6.QtCore import QPoint, Qt, QTimer
from PySide6.QtWidgets import QFrame, QHBoxLayout, QPushButton, QWidget

from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets import ElidedLabel, WrappedLabel, button, column_of, set_role

WAIT_MS = 300
"""Time after which waiting is announced (ms)."""

HEIGHT = 20
"""Height of the buttons, at which the status bar is not higher than without them (px)."""

LONG = re.compile(r"\S{2,}(\S{23})")
"""Pattern of a long word, such as a path, with its end as a group. If the line is too short, only the end is shown,
because the reason matters more."""

WIDEST = 560
"""Width of a message that is shown in full (px)."""

DISMISS = "Hide this message. The log keeps it"
UNCHANGED = "Hide this message without any change"


class Notice(QFrame):
    """A line of text with one or two buttons; hidden if there is no notice.

    If the message is too long for the line, a button shows all of it.
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
        """Show what the page waits for if it takes long, with a button to cancel."""
        self._say(text, "Cancel", "hint", "Stop waiting. The page keeps its content")
        self._cancel = cancel
        self.hide()
        self._timer.start()

    def refuse(self, text: str) -> None:
        """Show why something was refused."""
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
        """Show a notice with a button that does something about it, and one (``stay``) that dismisses it.

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
        """Show the whole message above the line until the user clicks elsewhere; return its label."""
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
        """Hide the notice."""
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
