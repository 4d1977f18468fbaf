"""The log of the window: rotating files that begin with versions and system, and a file for crashes. No Qt."""

from __future__ import annotations

import faulthandler
import logging
import os
import platform
import sys
from logging.handlers import RotatingFileHandler
from pathlib import Path
from typing import IO

from lfcal import __version__
from lfcal.base import processors

NAME, FAULTS = "lfcal-gui.log", "lfcal-gui-faults.log"
MAX_BYTES, KEPT = 1 << 20, 5
FORMAT = "%(asctime)s %(process)d %(levelname)s %(name)s: %(message)s"


def log_folder() -> Path:
    """Return the folder for logs of programs on this system, which may not exist yet."""
    from platformdirs import user_log_path

    return user_log_path("lfcal", appauthor=False)


def system_line() -> str:
    """Return a line with the versions of lfcal, Python, Qt and the system."""
    qt = sys.modules.get("PySide6")
    return (
        f"lfcal {__version__}, Python {platform.python_version()}, PySide6 {getattr(qt, '__version__', 'not loaded')}, "
        f"{platform.platform()}, {processors()} processors"
    )


class _Handler(RotatingFileHandler):
    """Handler that writes `system_line` at the beginning of each file and at each start of the program."""

    def _open(self) -> IO[str]:  # type: ignore[override]
        stream = super()._open()
        stream.write(f"# {system_line()}, process {os.getpid()}\n")
        stream.flush()
        return stream

    def rotate(self, source: str, dest: str) -> None:
        try:
            super().rotate(source, dest)
        except OSError:  # another window has it open; Windows does not rename open files
            return


class Log:
    """Log of the window.

    Parameters
    ----------
    folder
        Folder of the files, which is created if necessary.
    faults
        Whether the threads' tracebacks are written if the process crashes (segmentation fault, abort).

    Attributes
    ----------
    path
        The log file. None if the folder cannot be written to: the window then starts without a log.
    problem
        Why there is no log, or empty.
    """

    def __init__(self, folder: Path, *, faults: bool = True) -> None:
        self.folder = folder
        self.path: Path | None = None
        self.problem = ""
        self._handler: _Handler | None = None
        self._faults: IO[str] | None = None
        self._logger = logging.getLogger("lfcal")
        self._level = self._logger.level
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._handler = _Handler(folder / NAME, maxBytes=MAX_BYTES, backupCount=KEPT, encoding="utf-8")
            if faults:
                self._faults = (folder / FAULTS).open("a", encoding="utf-8")
                faulthandler.enable(self._faults)
        except OSError as error:
            self.problem = f"no log is written: {folder}: {error.strerror or error}"
        if self._handler is not None:
            self.path = folder / NAME
            self._handler.setFormatter(logging.Formatter(FORMAT))
            self._logger.addHandler(self._handler)
            self._logger.setLevel(logging.INFO)
            logging.getLogger("py.warnings").addHandler(self._handler)

    def close(self) -> None:
        """Close the files."""
        if self._handler is not None:
            for logger in (self._logger, logging.getLogger("py.warnings")):
                logger.removeHandler(self._handler)
            self._handler.close()
            self._logger.setLevel(self._level)
        if self._faults is not None:
            faulthandler.disable()
            self._faults.close()
