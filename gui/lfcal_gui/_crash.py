"""Unexpected errors of every thread: into the log, and to the user in one dialog."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from PySide6.QtCore import QMessageLogContext, QObject, QTimer, QtMsgType, qInstallMessageHandler
from PySide6.QtWidgets import QApplication, QWidget

from lfcal_gui.crash_dialog import CrashDialog
from lfcal_gui.models import Mishap, Mishaps
from lfcal_gui.workers import LOG

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

    Parameters
    ----------
    window
        Parent of the dialog.
    log
        The log file, None if there is none.
    safe
        Saves what it can and returns what is safe, a sentence each. Called when an error of a new kind is reported.
    """

    def __init__(self, window: QWidget, log: Path | None, safe: Callable[[], Sequence[str]]) -> None:
        super().__init__(window)
        self._window, self._log, self._safe = window, log, safe
        self._mishaps = Mishaps()
        self._lock, self._more, self._new = threading.Lock(), threading.Event(), threading.Event()
        self.dialog: CrashDialog | None = None
        self._hooks: tuple[Any, Any, Any] | None = None
        self._timer = QTimer(self)
        self._timer.setInterval(POLL_MS)
        self._timer.timeout.connect(self.tell)

    def install(self) -> None:
        """Take the hooks of Python and Qt."""
        before = qInstallMessageHandler(_from_qt)
        self._hooks = (sys.excepthook, threading.excepthook, before)
        sys.excepthook, threading.excepthook = self._raised, self._raised_in_thread
        self._timer.start()

    def close(self) -> None:
        """Give the hooks back."""
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
    def tell(self) -> None:
        """Show what was raised: a kind not seen yet opens the dialog, others are counted where it is open."""
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
