"""Units through an executor: what is done already is left out, what is lost is tried again."""

from __future__ import annotations

import itertools
import os
import shutil
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from lfcal.base import (
    Clock,
    InputError,
    Progress,
    StorageError,
    Work,
    only_writer,
    require_space,
    storage_errors,
    sweep_scratch,
)
from lfcal.base.h5 import trust
from lfcal.work.executors import FINAL_EVENTS, Event, EventKind, Executor
from lfcal.work.journal import JOURNAL, Journal, read_events, read_run, read_seals, read_settled
from lfcal.work.unit import Job, Unit, file_name, seal_of

__all__ = [
    "Following",
    "check_begun",
    "discard",
    "iter_run",
    "note_joining",
    "parts_folder",
    "unit_files",
    "was_joining",
]

ATTEMPTS = 4
"""Times that a unit is begun before it is given up, where its worker ends before it does."""

JOINING = "joining"
"""What the journal says when a run's units are done and what they make is written."""

PAUSE = 1.0
"""Seconds before a unit is begun again whose file could not be written; twice as long each time."""


def parts_folder(out: str | os.PathLike[str]) -> Path:
    """Return the folder beside ``out`` in which the files of its units lie until it is whole.

    Examples
    --------
    >>> from lfcal.work import parts_folder
    >>> print(parts_folder("H.h5").name)
    H.h5.parts
    """
    path = Path(out)
    return path.with_name(f"{path.name}.parts")


def check_begun(folder: Path, *, resume: bool) -> None:
    """Raise `InputError` where an earlier run left something in ``folder`` and nobody said what becomes of it."""
    if resume or "begin" not in read_events(folder):  # one that was killed before it began left nothing
        return
    state = read_run(folder)
    raise InputError(
        f"{folder}: an earlier run left {state.count('done')} of {len(state.units)} units; "
        "--resume goes on with them, --force begins anew"
    )


def unit_files(folder: Path) -> list[Path]:
    """Return the files of units in a run's folder: each is whole, and all that a run that goes on needs.

    The journal may lack those of an earlier run, where this one ended before it had looked at them.
    """
    return [p for p in folder.iterdir() if p.is_file() and p.name != JOURNAL and not p.name.startswith(".")]


def note_joining(folder: Path) -> None:
    """Note in a run's folder that from now on what it makes is written."""
    with Journal.open(folder) as journal:
        journal.note(JOINING)


def was_joining(out: str | os.PathLike[str]) -> bool:
    """Return whether a run of ``out`` had begun to write it: what is there is its own, and is written again."""
    return any(event == JOINING for event in read_events(parts_folder(out)))


def discard(folder: Path) -> None:
    """Remove a run's folder and all that is in it; raises `StorageError` where another program works in it."""
    if not folder.exists():
        return
    with only_writer(folder):
        # the journal last: a run that is killed meanwhile is known for one that goes on
        for path in folder.iterdir():
            if path.name != JOURNAL and path.is_file():
                path.unlink(missing_ok=True)
        shutil.rmtree(folder, ignore_errors=True)
    if folder.exists():
        raise StorageError(f"{folder}: cannot be removed; remove it by hand")


def iter_run(
    units: Sequence[Unit],
    folder: Path,
    executor: Executor,
    *,
    title: str = "",
    attempts: int = ATTEMPTS,
    following: Following | None = None,
    joined: bool = False,
) -> Work[tuple[Path, ...]]:
    """Do what is not done of ``units``; yields progress over all of them.

    A unit is done when its file is in ``folder`` under a name that holds its fingerprint: a run that was killed goes on
    where it was, and one with other inputs or settings begins anew. Files of other fingerprints are removed, and one
    that is no longer what was written is done again.

    Parameters
    ----------
    units
        What is to be done; no two have the same name.
    folder
        Where their files go, made where it is not there. One run at a time works in it.
    executor
        Who does them; started and stopped here.
    title
        What they make, for people.
    attempts
        How often a unit is begun whose worker ends before it does.
    following
        What takes the files that are there, while others are under way; closed by the caller.
    joined
        Whether what they hold is written once more, to the same disk; it must have room for both.

    Returns
    -------
    tuple of Path
        The file of each unit, in order.

    Raises
    ------
    StorageError
        If another run works in the folder, or its disk is too small for what is yet to come.
    LfcalError
        What a unit raised, or `WorkerLost` where its workers ended again and again. What other units made stays.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.base import drain
    >>> from lfcal.psf import open_psf
    >>> from lfcal.psf import Stored
    >>> from lfcal.psf import units_of
    >>> from lfcal.psf import MatrixPlanes
    >>> from lfcal.work import RunChoice, iter_run
    >>> with open_psf("H.h5") as H:
    ...     units = units_of(MatrixPlanes(H.T, title="transpose to"), Stored(compression="none"))
    >>> for file in drain(iter_run(list(units.values()), Path("HT.h5.parts"), RunChoice("threads", workers=1).make())):
    ...     with open_psf(file) as HT:
    ...         print(file.name.split(".")[0], HT.shape, HT.is_transposed)
    plane-0000 (1, 19, 33, 55, 55) True
    plane-0001 (1, 19, 33, 55, 55) True
    """
    twice = [name for name, count in Counter(unit.name for unit in units).items() if count > 1]
    if twice:
        raise InputError.expected("units", "a name for each", f"{twice[0]} twice", "rename one")
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        with only_writer(folder):
            parts = yield from _run_in(folder, units, executor, title, attempts, following=following, joined=joined)
    finally:
        with suppress(OSError):
            folder.rmdir()  # what ended before it began leaves nothing: there was no scheduler, for one
    return parts


def _run_in(
    folder: Path,
    units: Sequence[Unit],
    executor: Executor,
    title: str,
    attempts: int,
    *,
    following: Following | None,
    joined: bool,
) -> Work[tuple[Path, ...]]:
    """Do units in a folder in which nobody else works."""
    prints = [unit.fingerprint() for unit in units]
    earlier = read_settled(folder)
    units = [replace(u, settled=earlier.get(p, u.settled)) for u, p in zip(units, prints, strict=True)]
    names = [file_name(unit, p) for unit, p in zip(units, prints, strict=True)]
    jobs = [Job(k, unit, str(folder.absolute() / names[k])) for k, unit in enumerate(units)]
    _sweep(folder, {Path(job.out).name for job in jobs})
    seals = read_seals(folder)
    try:
        with executor, Journal.open(folder) as journal:
            _note_settled(journal, units, prints, earlier)
            journal.begin(title, [u.name for u in units], executor.name, executor.workers, executor.place)
            yield from _Run(jobs, executor, journal, attempts, following, joined).steps(seals)
    finally:
        sweep_scratch(folder)  # what workers that were killed have left
    return tuple(Path(job.out) for job in jobs)


def _note_settled(journal: Journal, units: Sequence[Unit], prints: Sequence[str], earlier: Mapping[str, Any]) -> None:
    """Note how units are computed of which the journal does not know it, in a line for each way."""
    new = [(u.settled, p) for u, p in zip(units, prints, strict=True) if u.settled and p not in earlier]
    for values, group in itertools.groupby(new, lambda one: one[0]):
        journal.settle(values, [fingerprint for _, fingerprint in group])


def _sweep(folder: Path, wanted: set[str]) -> None:
    """Remove the files of other inputs and settings."""
    for path in unit_files(folder):
        if path.name not in wanted:
            with suppress(OSError):
                path.unlink()


class _Run:
    """The state of a run while it lasts."""

    def __init__(
        self,
        jobs: list[Job],
        executor: Executor,
        journal: Journal,
        attempts: int,
        following: Following | None,
        joined: bool,
    ) -> None:
        self.jobs, self.executor, self.journal, self.attempts = jobs, executor, journal, attempts
        self.following, self.joined, self.files = following, joined, [Path(job.out) for job in jobs]
        self.shares = [0.0] * len(jobs)
        self.tries: Counter[int] = Counter()
        self.open: set[int] = set()
        self.later: list[tuple[float, Job]] = []
        self.stage = ""
        self.least: int | None = None

    def steps(self, seals: Mapping[str, str]) -> Work[None]:
        try:
            yield from self._submit_missing(seals)
            began, kept = time.perf_counter(), sum(self.shares)
            while self.open:
                self._submit_due()
                events = self.executor.events()
                for event in events:
                    self._handle(event)
                    yield self._progress(event, began, kept)
                if any(event.kind is EventKind.DONE for event in events):
                    self._check_room()
                # where workers wait for their next unit they are given it before
                idle = not self.executor.ahead and any(event.kind in FINAL_EVENTS for event in events)
                if self.following is not None and not idle:
                    self.following.advance(self.files, self._available())
                if not events:  # a window that stops the work is heard here
                    yield self._progress(None, began, kept)
        except BaseException:
            self.journal.note("stopped")
            raise
        self.journal.note("end")

    def _available(self) -> int:
        """Return how many units are done before the first that is not."""
        return next((k for k, share in enumerate(self.shares) if share < 1.0), len(self.shares))

    def _check_room(self) -> None:
        """Raise where the disk cannot hold what is yet to come, were every unit as small as the least there is.

        It is said as soon as it can be known, and not hours later by a full disk.
        """
        left = sum(share < 1.0 for share in self.shares)
        if self.joined:
            left += len(self.files) - (self.following.taken if self.following is not None else 0)
        require_space(self.files[0].parent, left * (self.least or 0), what="what is yet to come")

    def _note_size(self, path: Path) -> None:
        """Note the size of a unit's file."""
        with suppress(OSError):  # another machine's file may be seen here a while later
            size = path.stat().st_size
            self.least = size if self.least is None else min(self.least, size)

    def _submit_missing(self, seals: Mapping[str, str]) -> Work[None]:
        """Keep what is there and whole, and submit the rest."""
        clock = Clock("looking at what is there", len(self.jobs))
        for job in self.jobs:
            path, name = Path(job.out), job.unit.name
            there = path.exists()
            # a file that was not noted was moved into place whole, and its run killed right after
            if there and seals.get(path.name) in (None, seal_of(path)):
                self.shares[job.number] = 1.0
                self._note_size(path)
                self.journal.note("kept", unit=name)
                yield clock.at(job.number + 1)
                continue
            if there:
                self.journal.note("damaged", unit=name, reason="its file was damaged")
                path.unlink()
            self.open.add(job.number)
            self.executor.submit(job)

    def _submit_due(self) -> None:
        """Give back to the executor what was lost a while ago."""
        now = time.monotonic()
        if self.later and len(self.later) == len(self.open) and all(at > now for at, _ in self.later):
            time.sleep(PAUSE / 4)  # nothing else is under way
        for due in [due for due in self.later if due[0] <= now]:
            self.later.remove(due)
            self.executor.submit(due[1])

    def _progress(self, event: Event | None, began: float, kept: float) -> Progress:
        done, total = sum(self.shares), len(self.jobs)
        if event is not None:
            self.stage = event.stage or event.job.unit.name
        # in thousandths: a run of few long units moves, too; seconds of what an earlier run did are not this one's
        lasted = time.perf_counter() - began
        whole = sum(share == 1.0 for share in self.shares)
        fair = lasted * done / (done - kept) if done > kept else lasted
        note = f"{whole} of {total} done" + (f"; {kept:.0f} by an earlier run" if kept else "")
        return Progress(round(1000 * done), 1000 * total, self.stage, fair, note, per=1000)

    def _handle(self, event: Event) -> None:
        job, number = event.job, event.job.number
        if event.kind is EventKind.STARTED:
            self.tries[number] += 1
        elif event.kind is EventKind.ADVANCED:
            self.shares[number] = min(event.share, 0.999)  # whole when its file is there
            return
        record: dict[str, Any] = {} if event.seconds is None else {"seconds": event.seconds}
        if event.kind is EventKind.DONE:
            record |= {"file": Path(job.out).name, "seal": event.seal}
        reason = {} if event.error is None else {"reason": str(event.error)}
        self.journal.note(event.kind.value, unit=job.unit.name, worker=event.worker, **record, **reason)
        if event.kind in FINAL_EVENTS:
            self.shares[number] = float(event.kind is EventKind.DONE)
        if event.kind is EventKind.DONE:
            self.open.remove(number)
            self._note_size(Path(job.out))
            _trust(event)
        elif event.kind is EventKind.FAILED:
            assert event.error is not None
            raise event.error
        elif event.kind is EventKind.LOST:
            if self.tries[number] >= self.attempts:
                self.journal.note("failed", unit=job.unit.name, **reason)
                raise _given_up(event, self.attempts)
            pause = PAUSE * 2 ** (self.tries[number] - 1) if isinstance(event.error, StorageError) else 0.0
            self.later.append((time.monotonic() + pause, job))


def _trust(event: Event) -> None:
    """Take a unit's file for one of our own where it is what its worker wrote: nobody has to look through it first."""
    path = Path(event.job.out)
    if path.suffix == ".h5" and event.seal == seal_of(path):
        trust(path)


def _given_up(event: Event, attempts: int) -> Exception:
    error = event.error
    assert error is not None
    if isinstance(error, StorageError):
        return error
    return type(error)(
        f"{event.job.unit.name}: {error} in each of {attempts} attempts; memory may be short: use fewer workers"
    )


class Following:
    """Joins what is there, a step at a time: who waits for workers has little else to do.

    Parameters
    ----------
    join
        Gives the work for the files of all units: its first step needs none of them, the next the first, and so on;
        what it makes is whole, and has its name, only behind its last step.
    """

    def __init__(self, join: Callable[[tuple[Path, ...]], Work[None]]) -> None:
        self._join = join
        self._steps: Work[None] | None = None
        self._taken = -1
        self._last: Progress | None = None

    @property
    def taken(self) -> int:
        """How many files were taken."""
        return max(0, self._taken)

    def advance(self, files: Sequence[Path], available: int) -> None:
        """Take a step where one of the first ``available`` files was not taken yet."""
        if self._steps is None:
            self._steps = self._join(tuple(files))
        if self._taken < available <= len(files):
            # a step more would end it: that is for `rest`
            self._last, self._taken = next(self._steps), self._taken + 1

    def rest(self, files: Sequence[Path]) -> Work[None]:
        """Take all that are left, and end."""
        if self._steps is None:
            self._steps = self._join(tuple(files))
        elif self._last is not None:
            yield self._last
        yield from self._steps

    def close(self) -> None:
        """Leave nothing half-written."""
        if self._steps is not None:
            self._steps.close()
