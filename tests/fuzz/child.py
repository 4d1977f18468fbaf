"""The process that runs commands for `tests.fuzz.guard`: one JSON line in, one JSON line out.

It has limits of processor time and memory of its own, and both streams go to files at the level of the system, where
libraries in C write, too.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path

CPU_S = 30
"""Processor time of one command; good files take well below one second."""

MEMORY = 6 << 30


def _limit() -> None:
    import resource

    # the limit counts from the start of the process
    resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time()) + CPU_S, resource.RLIM_INFINITY))


def _call(arguments: list[str]) -> tuple[int | None, str]:
    """Run one command; return its exit code, None for an exception that no user should see, and where that arose."""
    try:
        if arguments[0] in READERS:
            _read(READERS[arguments[0]], Path(arguments[1]))
        else:
            from lfcal.cli import main

            sys.argv = ["lfcal", *arguments]
            main()
    except SystemExit as end:
        return (int(end.code or 0), "") if isinstance(end.code, int | None) else (None, f"exit code {end.code!r}")
    except BaseException as error:
        own = [f for f in traceback.extract_tb(error.__traceback__) if "lfcal" in f.filename or "gui" in f.filename]
        place = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "?"
        return None, f"{type(error).__name__} at {place}: {str(error)[:200]}"
    return 0, ""


def _read(reader: Callable[[Path], object], path: Path) -> None:
    """Read a file as the program does that says what `LfcalError` says."""
    from lfcal.base.errors import LfcalError
    from lfcal.cli._console import report

    try:
        reader(path)
    except LfcalError as error:
        report(str(error))
        sys.exit(2)


def _open_project(path: Path) -> None:
    from lfcal_gui.models.project import Project

    Project().open(path)


def _open_record(path: Path) -> None:
    from lfcal.work.records import load_record

    load_record(path)


READERS = {"project": _open_project, "record": _open_record}
"""Files that no command reads, or only one that works for long."""


def main() -> None:
    """Serve until the input ends."""
    import resource

    from lfcal.base.h5 import probe

    probe.CPU_S = 1  # the files are small
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # what users see by default, each time and not only the first
    warnings.simplefilter("always")
    for kind in (DeprecationWarning, PendingDeprecationWarning, ResourceWarning, ImportWarning):
        warnings.simplefilter("ignore", kind)
    answers = os.fdopen(os.dup(1), "w")
    said = os.open(sys.argv[1], os.O_RDWR | os.O_CREAT | os.O_TRUNC)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(said, 2)
    for line in sys.stdin:
        folder, arguments = json.loads(line)
        os.chdir(folder)
        os.ftruncate(said, 0)
        os.lseek(said, 0, os.SEEK_SET)
        _limit()
        began = time.process_time()
        code, where = _call(arguments)
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        text = os.pread(said, 1 << 16, 0).decode("utf-8", "replace")
        print(json.dumps([code, where, text, time.process_time() - began]), file=answers, flush=True)


if __name__ == "__main__":
    main()
