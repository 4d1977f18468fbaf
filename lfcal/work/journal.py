"""Journal of a run: one line of JSON for each event, read by `lfcal status`, the window and later runs.

A unit is done if its file exists. From the journal, a later run takes the seals of the files, by which it recognises
damaged ones, and the settings of the units. The last line of a journal may be incomplete.
"""

from __future__ import annotations

import json
import math
import os
import socket
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TextIO

from lfcal.base import (
    InputError,
    LfcalError,
    check_number,
    format_seconds,
    is_alive,
    parse_json,
    read_text,
    storage_errors,
)

__all__ = [
    "HEADER",
    "JOURNAL",
    "PASS",
    "SETTLED",
    "Journal",
    "RunState",
    "RunTable",
    "UnitState",
    "read_events",
    "read_notes",
    "read_run",
    "read_seals",
    "read_settled",
    "run_table",
]

JOURNAL = "run.jsonl"

SETTLED = "settled"
"""Event that records how units are computed, with the fingerprints of the units that were begun in this way."""

MAX_UNIT_S = 1e10
"""Largest duration of a unit that is accepted (s): 300 years."""

PASS = "pass"
"""Event written when a run of several passes has completed one of them."""


class Journal:
    """Writer of the journal of a run, to which events are appended."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    @classmethod
    @contextmanager
    def open(cls, folder: Path) -> Iterator[Journal]:
        """Return a context with the journal in ``folder``; its file is created if it does not exist."""
        path = folder / JOURNAL
        with storage_errors(path), path.open("a", encoding="utf-8") as file:
            if file.tell() and not path.read_bytes().endswith(b"\n"):
                file.write("\n")  # the last writer was killed within a line
            yield cls(file)

    def note(self, event: str, **values: Any) -> None:
        """Append a line with an event, its time and further values."""
        self._file.write(json.dumps({"at": round(time.time(), 3), "event": event, **values}) + "\n")
        self._file.flush()

    def settle(self, values: Mapping[str, Any], fingerprints: Iterable[str]) -> None:
        """Record the settings ``values`` of the units with these fingerprints, so that a later run uses them again."""
        self.note(SETTLED, values=dict(values), units=list(fingerprints))

    def begin(self, title: str, units: Iterable[str], executor: str, workers: int, place: str) -> None:
        """Record the start of a run: its title, the names of its units, and its executor.

        ``workers`` is the number of workers, and ``place`` the address of a dashboard that shows them (empty: none).
        """
        here = {"process": os.getpid(), "host": socket.gethostname()}
        self.note("begin", title=title, units=list(units), executor=executor, workers=workers, place=place, **here)


def read_settled(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the settings with which runs in ``folder`` started their units, by fingerprint."""
    return {name: dict(note["values"]) for note in read_notes(folder, SETTLED) for name in note["units"]}


@dataclass(frozen=True)
class UnitState:
    """State of one unit of a run.

    Attributes
    ----------
    name
        Name of the unit.
    state
        ``"waiting"``, ``"under way"``, ``"done"`` or ``"failed"``.
    attempts
        Number of times that the unit was started in this run.
    seconds
        Time that the unit took, or has taken so far (s). NaN if it has not been started, if its run ended before it was
        finished, or if it was finished by an earlier run.
    worker
        Name of the worker that processes or processed the unit.
    reason
        Reason why the unit failed or was started again; otherwise empty.
    """

    name: str
    state: str = "waiting"
    attempts: int = 0
    seconds: float = float("nan")
    worker: str = ""
    reason: str = ""


@dataclass(frozen=True)
class RunState:
    """State of a run, as recorded in its journal.

    Attributes
    ----------
    title
        Description of the output.
    units
        States of the units of the run, in order.
    executor, workers, place
        Name of the executor, number of its workers, and address of a dashboard that shows them (empty: none).
    running
        Whether the process of the run is still running, as far as this computer can determine.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.base import drain
    >>> from lfcal.work import RunChoice, RunState, iter_run, read_run
    >>> _ = drain(iter_run([], Path("HT.h5.parts"), RunChoice("threads", workers=1).make(), title="HT of no plane"))
    >>> state: RunState = read_run(Path("HT.h5.parts"))
    >>> print(f"{state.title}: {state.count('done')} of {len(state.units)} done by {state.executor}")
    HT of no plane: 0 of 0 done by threads
    """

    title: str
    units: tuple[UnitState, ...]
    executor: str
    workers: int
    place: str
    running: bool

    def to_dict(self) -> dict[str, Any]:
        """Return the state as plain JSON types; unknown times are None."""
        units = [asdict(unit) | {"seconds": None if math.isnan(unit.seconds) else unit.seconds} for unit in self.units]
        return {
            **{key: value for key, value in vars(self).items() if key != "units"},
            "done": self.count("done"),
            "total": len(self.units),
            "units_per_hour": self.per_hour,
            "eta_seconds": self.eta_seconds,
            "units": units,
        }

    def count(self, state: str) -> int:
        """Return the number of units in the state ``state``."""
        return sum(unit.state == state for unit in self.units)

    @property
    def eta_seconds(self) -> float | None:
        """Estimated remaining time (s), from the durations of finished units; None if no duration is known."""
        left = sum(u.state in ("waiting", "under way") for u in self.units)
        pace = self.per_hour
        return None if pace is None else 3600 * left / pace

    @property
    def per_hour(self) -> float | None:
        """Estimated number of units per hour, from the durations of finished units; None if no duration is known."""
        took = [u.seconds for u in self.units if u.state == "done" and u.seconds == u.seconds]
        if not took:
            return None
        at_a_time = self.workers
        if self.executor == "threads":  # each concurrent thread has a name
            at_a_time = min(self.workers, len({u.worker for u in self.units if u.state == "done" and u.worker})) or 1
        return 3600 * at_a_time * len(took) / max(sum(took), 1e-6)


def read_seals(folder: Path) -> dict[str, str]:
    """Return the seals of the files that runs in ``folder`` wrote, by file name; see `lfcal.work.unit.seal_of`."""
    path = folder / JOURNAL
    if not path.exists():
        return {}
    records = _records(read_text(path).splitlines())
    return {str(r["file"]): str(r["seal"]) for r in records if "file" in r and "seal" in r}


def read_events(folder: Path) -> list[str]:
    """Return the names of the events in the journal of ``folder``, in order; empty if there is no journal."""
    path = folder / JOURNAL
    return [str(r["event"]) for r in _records(read_text(path).splitlines())] if path.exists() else []


def read_notes(folder: Path, event: str) -> list[dict[str, Any]]:
    """Return all entries for ``event`` in the journal of ``folder``, in order; empty if there is no journal."""
    path = folder / JOURNAL
    return [r for r in _records(read_text(path).splitlines()) if r["event"] == event] if path.exists() else []


def read_run(folder: Path, now: float | None = None) -> RunState:
    """Return the state of the last run that was started in ``folder``, from its journal.

    ``now`` is the current time (s since 1970), from which the durations of unfinished units are computed. None: that of
    the computer.

    Raises
    ------
    InputError
        If no run was started in ``folder``.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.base import drain
    >>> from lfcal.psf import open_psf
    >>> from lfcal.psf import Stored
    >>> from lfcal.psf import units_of
    >>> from lfcal.psf import MatrixPlanes
    >>> from lfcal.work import RunChoice, iter_run, read_run
    >>> with open_psf("H.h5") as H:
    ...     units = units_of(MatrixPlanes(H.T, title="transpose to"), Stored(compression="none"))
    >>> _ = drain(iter_run([units[0]], Path("HT.parts"), RunChoice("threads", workers=1).make(), title="HT of plane 0"))
    >>> state = read_run(Path("HT.parts"))
    >>> print(f"{state.title}: {state.count('done')} of {len(state.units)} done; running: {state.running}")
    HT of plane 0: 1 of 1 done; running: False
    """
    now = time.time() if now is None else now
    try:
        lines = read_text(folder / JOURNAL).splitlines()
    except LfcalError as error:
        raise InputError.expected(
            str(folder), "the folder of a run", "none", "give the output file of the run"
        ) from error
    begun: dict[str, Any] | None = None
    states: dict[str, UnitState] = {}
    starts: dict[str, float] = {}
    ended = False
    for record in _records(lines):
        if record["event"] == "begin":
            begun, ended, starts = record, False, {}
            states = {name: UnitState(name) for name in record["units"] if isinstance(name, str)}
        elif record["event"] in ("end", "stopped"):
            ended = True
        elif isinstance(name := record.get("unit"), str) and name in states:
            states[name] = _after(states[name], record, starts)
    if begun is None:
        raise InputError.expected(
            str(folder), "the folder of a run", "one without a start entry", "start the run again"
        )
    running = not ended and begun["host"] == socket.gethostname() and is_alive(begun["process"])
    for name, state in states.items():
        if state.state == "under way":
            # no worker is active after the run has ended
            # a clock that was set back must not give negative times
            took = max(0.0, now - starts[name])
            states[name] = replace(state, seconds=took) if running else replace(state, state="waiting")
    fields = (begun["executor"], begun["workers"], begun["place"])
    return RunState(begun["title"], tuple(states.values()), *fields, running)


def _after(state: UnitState, record: dict[str, Any], starts: dict[str, float]) -> UnitState:
    """Return the state of a unit after an event."""
    event, at = record["event"], float(record["at"])
    worker = str(record.get("worker") or state.worker)
    if event == "started":
        starts[state.name] = at
        return replace(state, state="under way", attempts=state.attempts + 1, worker=worker)
    if event == "kept":  # done by an earlier run
        return replace(state, state="done")
    said = record.get("seconds")
    took = float(said) if isinstance(said, int | float) else at - starts.get(state.name, at)
    # the journal may be damaged: keep sums of its values finite
    seconds = min(max(0.0, took), MAX_UNIT_S)
    if event == "done":
        return replace(state, state="done", seconds=seconds, worker=worker)
    reason = str(record.get("reason", ""))
    return replace(state, state="failed" if event == "failed" else "waiting", seconds=seconds, reason=reason)


def _records(lines: list[str]) -> Iterator[dict[str, Any]]:
    """Yield the entries of a journal, without incomplete or damaged lines."""
    for line in lines:
        try:
            record = parse_json(line, JOURNAL, finite=False)
            check_number("time", record["at"])
        except (KeyError, TypeError, LfcalError):
            continue
        if isinstance(record.get("event"), str) and (record["event"] != "begin" or _whole(record)):
            yield record


def _whole(begun: dict[str, Any]) -> bool:
    kinds = {"title": str, "units": list, "executor": str, "workers": int, "place": str, "process": int, "host": str}
    return all(isinstance(begun.get(key), kind) for key, kind in kinds.items())


HEADER = ("unit", "state", "attempts", "time", "by", "why")

MAX_ROWS = 40
"""Largest number of units in a table; further units that are done or waiting are only counted."""


@dataclass(frozen=True)
class RunTable:
    """Texts for displaying the state of a run.

    Attributes
    ----------
    headline
        A line with the output, the progress and the executor.
    place
        Address of a dashboard that shows the workers; empty if there is none.
    rows
        Cells for the columns of `HEADER`, one row for each unit. Of more than `MAX_ROWS` units, only those that are
        under way, have failed or were started again have a row.
    pace
        Number of units under way and, if known, units per hour and estimated time left; empty if the run is not active.
    """

    headline: str
    place: str
    rows: tuple[tuple[str, ...], ...]
    pace: str


def run_table(state: RunState) -> RunTable:
    """Return the texts for displaying a run in the given state."""
    who = f"{state.executor}, {state.workers} at work" if state.running else "not running"
    headline = f"{state.title}: {state.count('done')} of {len(state.units)} units done; {who}"
    shown = [u for u in state.units if len(state.units) <= MAX_ROWS or u.state in ("under way", "failed") or u.reason]
    rows = tuple(
        (
            unit.name,
            unit.state,
            str(unit.attempts or ""),
            "" if math.isnan(unit.seconds) else format_seconds(unit.seconds),
            unit.worker,
            unit.reason,
        )
        for unit in shown
    )
    known = []
    if state.running:
        known.append(f"{state.count('under way')} under way")
        if state.per_hour is not None and state.eta_seconds is not None:
            known += [f"{state.per_hour:.3g} units an hour", f"about {format_seconds(state.eta_seconds)} left"]
    return RunTable(headline, state.place if state.running else "", rows, ", ".join(known))
