"""Report unexpected errors of all threads in the log, and in one dialog that states which data are safe."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from PySide6.QtCore import QMessageLogContext, QObject, Qt, QTimer, QtMsgType, QUrl, qInstallMessageHandler
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import (
    QApplication,
    QDialog,
    QHBoxLayout,
    QLabel,
    QPlainTextEdit,
    QVBoxLayout,
    QWidget,
)

from lfcal_gui.log import system_line
from lfcal_gui.models import Mishap, Mishaps
from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets import button, lines_px
from lfcal_gui.workers import LOG

WIDTH = 560


def open_folder(folder: Path) -> None:
    """Show a folder in the system's file manager."""
    QDesktopServices.openUrl(QUrl.fromLocalFile(str(folder)))


class CrashDialog(QDialog):
    """Dialog for all unexpected errors; it does not block the window."""

    def __init__(self, log: Path | None, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setStyleSheet(style_sheet())
        self.setWindowTitle("Unexpected error")
        self._log = log
        self._mishaps: list[Mishap] = []
        column = QVBoxLayout(self)
        column.setContentsMargins(18, 16, 18, 14)
        column.setSpacing(10)
        heading = QLabel("An unexpected error occurred")
        heading.setProperty("role", "title")
        self.words = _wrapped("error")
        self.safe = _wrapped("")
        where = f"Log: {log}" if log is not None else "There is no log file, because its folder is not writable."
        self.where = _wrapped("hint")
        self.where.setText(where)
        for widget in (heading, self.words, self.safe, self.where):
            column.addWidget(widget)
        self.details = QPlainTextEdit(readOnly=True)
        self.details.setAccessibleName("Details")
        self.details.setToolTip("Traceback; include it in a bug report")
        self.details.setLineWrapMode(QPlainTextEdit.LineWrapMode.NoWrap)
        self.details.setMinimumHeight(180)
        self.details.hide()
        column.addWidget(self.details, 1)
        column.addLayout(self._buttons())
        self.setMinimumWidth(WIDTH)

    def _buttons(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self.more = button("Details", "Show the traceback, for a bug report")
        self.more.setCheckable(True)
        self.more.toggled.connect(self._show_details)
        self.copy = button("Copy text", "Copy the message and the traceback, for a bug report", self.copy_text)
        self.folder = button(
            "Open log folder", "Open the folder of the log, which shows what happened before the error"
        )
        self.folder.setEnabled(self._log is not None)
        self.folder.clicked.connect(lambda _=False: self._log is not None and open_folder(self._log.parent))
        close = button(
            "Close",
            "Close this message and continue working. The text above states which data are safe",
            role="primary",
        )
        close.setDefault(True)
        close.clicked.connect(self.close)
        for one in (self.more, self.copy, self.folder):
            row.addWidget(one)
        row.addStretch()
        row.addWidget(close)
        return row

    def show_mishaps(self, mishaps: Sequence[Mishap], safe: Sequence[str] | None) -> None:
        """Show these errors, the newest last, and which data are safe (None: unchanged)."""
        self._mishaps = list(mishaps)
        self.words.setText("\n".join(mishap.title() for mishap in self._mishaps[-3:]))
        if safe is not None:
            self.safe.setText("\n".join(safe))
        self.details.setPlainText(self.text())
        if not self.isVisible():
            self.adjustSize()
            self.show()

    def text(self) -> str:
        """Return the text of an error report."""
        parts = [system_line(), *(f"{m.title()}\nin {m.thread}\n{m.trace}" for m in self._mishaps)]
        return "\n\n".join(parts)

    def copy_text(self) -> None:
        """Copy the report to the clipboard."""
        QApplication.clipboard().setText(self.text())
        self.copy.setText("Copied")

    def _show_details(self, on: bool) -> None:
        self.details.setVisible(on)
        margins = self.layout().contentsMargins()
        needs = lines_px(self.details) + margins.left() + margins.right() if on else 0
        self.setMinimumWidth(max(WIDTH, needs))
        self.adjustSize()
        # Qt stops at two thirds of the screen, and the buttons would cover the text
        self.resize(self.width(), max(self.height(), self.layout().totalHeightForWidth(self.width())))


def _wrapped(role: str) -> QLabel:
    label = QLabel()
    label.setWordWrap(True)
    label.setTextFormat(Qt.TextFormat.PlainText)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    label.setProperty("role", role)
    return label


POLL_MS = 200
_LEVELS = {
    QtMsgType.QtDebugMsg: 10,
    QtMsgType.QtInfoMsg: 20,
    QtMsgType.QtWarningMsg: 30,
    QtMsgType.QtCriticalMsg: 40,
    QtMsgType.QtFatalMsg: 50,
}


class CrashGuard(QObject):
    """Report unexpected errors between `install` and `close`, and keep the window open.

    ``log`` is the log file; None if there is none. At an error of a new kind, ``safe`` is called: it stores a copy of
    unsaved work, and returns sentences that state which data are safe.
    """

    def __init__(self, window: QWidget, log: Path | None, safe: Callable[[], Sequence[str]]) -> None:
        super().__init__(window)
        self._window, self._log, self._safe = window, log, safe
        self._mishaps = Mishaps()
        self._lock, self._more, self._new = threading.Lock(), threading.Event(), threading.Event()
        self.dialog: CrashDialog | None = None
        self._hooks: tuple[Any, Any, Any] | None = None
        self._timer = QTimer(self, interval=POLL_MS)
        self._timer.timeout.connect(self.show_raised)

    def install(self) -> None:
        """Install the exception hooks of Python and the message handler of Qt."""
        before = qInstallMessageHandler(_from_qt)
        self._hooks = (sys.excepthook, threading.excepthook, before)
        sys.excepthook, threading.excepthook = self._raised, self._raised_in_thread
        self._timer.start()

    def close(self) -> None:
        """Restore the previous hooks."""
        self._timer.stop()
        if self._hooks is not None:
            sys.excepthook, threading.excepthook, before = self._hooks
            qInstallMessageHandler(before)
            self._hooks = None

    # -- hooks: any thread -----------------------------------------------------------------------------
    def _raised(self, kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if isinstance(error, (KeyboardInterrupt, SystemExit)):
            QApplication.quit()
            return
        self._take(error.with_traceback(trace), threading.current_thread().name)

    def _raised_in_thread(self, args: threading.ExceptHookArgs) -> None:
        if args.exc_value is not None and not isinstance(args.exc_value, SystemExit):
            self._take(args.exc_value, args.thread.name if args.thread is not None else "a thread")

    def _take(self, error: BaseException, thread: str) -> None:
        with self._lock:
            mishap, first = self._mishaps.add(Mishap.of(error, thread))
        if first:
            LOG.error("unexpected in %s: %s\n%s", thread, mishap.words, mishap.trace)
            self._new.set()
        elif not mishap.count & (mishap.count - 1):  # 2, 4, 8 …: one that repeats does not fill the log
            LOG.error("again, %d times by now: %s", mishap.count, mishap.words)
        self._more.set()

    # -- the window's thread ---------------------------------------------------------------------------
    def show_raised(self) -> None:
        """Show an error: a new kind opens the dialog; others are only counted."""
        if not self._more.is_set():
            return
        self._more.clear()
        new = self._new.is_set()
        self._new.clear()
        if self.dialog is None and new:
            self.dialog = CrashDialog(self._log, self._window)
        if self.dialog is not None and (new or self.dialog.isVisible()):
            with self._lock:
                found = self._mishaps.all()
            self.dialog.show_mishaps(found, self._safe() if new else None)


def _from_qt(kind: QtMsgType, context: QMessageLogContext, text: str | None) -> None:
    LOG.log(_LEVELS.get(kind, 30), "Qt: %s", text)
