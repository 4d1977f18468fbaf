"""Tasks of units for the tests of `lfcal.work`."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lfcal.base.errors import InputError, StorageError
from lfcal.base.files import replace_whole
from lfcal.base.progress import Clock, Work
from lfcal.work import Unit
from lfcal.work.unit import worker_number


def unit(name: str, task: str = "write", inputs: tuple[str, ...] = (), **arguments: Any) -> Unit:
    """Return a unit of a task of this module."""
    return Unit(name, f"{__name__}:{task}", arguments, inputs, ".txt")


def write(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Write the text that is given; note in the file ``seen`` that it was done, and by which process."""
    clock = Clock("writing", 2)
    yield clock.at(1)
    with replace_whole(out) as part:
        part.write_text(str(arguments.get("text", "x")))
    if seen := arguments.get("seen"):
        with Path(seen).open("a") as file:
            file.write(f"{os.getpid()} {workers} {os.environ.get('LFCAL_WORKERS')}\n")
    yield clock.at(2)


def count(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Write the number of the worker."""
    yield Clock("counting", 1).at(0)
    with replace_whole(out) as part:
        part.write_text(str(worker_number()))


def meet(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Write the number of the worker, once ``count`` units have begun: none is done before all are under way."""
    clock, marks = Clock("meeting", 0), Path(arguments["marks"])
    with marks.open("a") as file:
        file.write("x")
    for _ in range(3000):
        if len(marks.read_text()) >= arguments["count"]:
            break
        yield clock.at(0)
        time.sleep(0.01)
    else:
        raise InputError.expected("units under way", arguments["count"], marks.read_text(), "begin them")
    with replace_whole(out) as part:
        part.write_text(str(worker_number()))


def refuse(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Raise a message for people."""
    yield Clock("refusing", 1).at(0)
    raise InputError.expected("light", "some", "none", "open the shutter")


def stumble(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Raise what is no message for people."""
    yield Clock("stumbling", 1).at(0)
    raise ZeroDivisionError("one by nothing")


def forget(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Write nothing."""
    yield Clock("forgetting", 1).at(0)


def die(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """End the process as a kill does, the first ``times``, in the middle of writing; then write."""
    marks = Path(arguments["marks"])
    yield Clock("dying", 1).at(0)
    with marks.open("a") as file:
        file.write("x")
    if len(marks.read_text()) <= arguments["times"]:
        with replace_whole(out) as part:
            part.write_text("half")
            os.kill(os.getpid(), signal.SIGKILL)
    yield from write(arguments, out, workers)


def busy_file(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Find the file held by another program, the first time; then write."""
    marks = Path(arguments["marks"])
    yield Clock("waiting", 1).at(0)
    if not marks.exists():
        marks.touch()
        raise StorageError(f"{out}: another program is writing it")
    yield from write(arguments, out, workers)


def endless(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Go on until it is stopped; the file ``begun`` is there when it has begun."""
    Path(arguments["begun"]).write_text(str(os.getpid()))
    clock = Clock("on and on", 0)
    with replace_whole(out) as part:
        part.write_text("half")
        while True:
            yield clock.at(0)
            time.sleep(0.01)


def told(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Write how it was told to do it."""
    yield Clock("writing", 1).at(0)
    with replace_whole(out) as part:
        part.write_text(str(arguments["how"]))
