"""Runs of units on an executor: finished units are skipped, and lost units are tried again."""

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
"""Default of the largest number of times that a unit is started, for `iter_run`."""

JOINING = "joining"
"""Event written when all units are done and the output is being written."""

PAUSE = 1.0
"""Delay before a unit whose file could not be written is tried again (s); it doubles each time."""


def parts_folder(out: str | os.PathLike[str]) -> Path:
    """Return the path of the folder next to ``out`` that contains the files of its units until ``out`` is complete.

    Examples
    --------
    >>> from lfcal.work import parts_folder
    >>> print(parts_folder("H.h5").name)
    H.h5.parts
    """
    path = Path(out)
    return path.with_name(f"{path.name}.parts")


def check_begun(folder: Path, *, resume: bool) -> None:
    """Raise `InputError` if a run was started in ``folder`` and ``resume`` is not set."""
    if resume or "begin" not in read_events(folder):  # a run that was killed before it began left nothing
        return
    state = read_run(folder)
    raise InputError(
        f"{folder}: an earlier run left {state.count('done')} of {len(state.units)} units finished; "
        "continue from them (--resume), or start again (--force)"
    )


def unit_files(folder: Path) -> list[Path]:
    """Return the files of finished units in the folder of a run, from which the next run can continue.

    The folder is listed, because the journal may lack files of an earlier run that the last run did not check.
    """
    return [p for p in folder.iterdir() if p.is_file() and p.name != JOURNAL and not p.name.startswith(".")]


def note_joining(folder: Path) -> None:
    """Record in the folder of a run that the run has begun to write its output."""
    with Journal.open(folder) as journal:
        journal.note(JOINING)


def was_joining(out: str | os.PathLike[str]) -> bool:
    """Return whether an unfinished run had begun to write ``out``; resuming it may then replace an existing file."""
    return any(event == JOINING for event in read_events(parts_folder(out)))


def discard(folder: Path) -> None:
    """Remove the folder of a run, if it exists, with its contents.

    Raises
    ------
    StorageError
        If another run uses the folder, or it cannot be removed.
    """
    if not folder.exists():
        return
    with only_writer(folder):
        # the journal last, so that a run killed meanwhile can still be continued
        for path in folder.iterdir():
            if path.name != JOURNAL and path.is_file():
                path.unlink(missing_ok=True)
        shutil.rmtree(folder, ignore_errors=True)
    if folder.exists():
        raise StorageError(f"{folder}: cannot be removed; remove it manually")


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
    """Process the ``units`` that are not finished yet; yields progress over all units.

    A unit is finished when ``folder`` contains its file, whose name contains the unit's fingerprint. A run that was
    killed can therefore be continued, whereas a run with other inputs or settings starts from the beginning. Files with
    other fingerprints are removed, and units with damaged files are processed again.

    Parameters
    ----------
    units
        The units, with unique names.
    folder
        Folder for the files of the units, created if needed. Only one run at a time may use it.
    executor
        Executor that processes the units; this function starts and stops it.
    title
        Description of the output, for display.
    attempts
        Maximum number of times that a unit is started, if its worker process dies, or reports that a file cannot be
        read or written.
    following
        Object that joins the files of finished units while other units are being processed; the caller closes it. None:
        files are not joined.
    joined
        Whether the caller joins the files into another file on the same disk. The disk must then have space for both.

    Returns
    -------
    tuple of Path
        The file of each unit, in order.

    Raises
    ------
    InputError
        If two units have the same name.
    StorageError
        If another run uses the folder, or its disk is too small for the remaining files.
    LfcalError
        The error of a unit, or `WorkerLost` if its worker processes died repeatedly. The files of other units are kept.

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
            folder.rmdir()  # a run that ended before it began leaves nothing, for example if no scheduler answered
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
    """Process units in a folder that no other run uses."""
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
        sweep_scratch(folder)  # left by workers that were killed
    return tuple(Path(job.out) for job in jobs)


def _note_settled(journal: Journal, units: Sequence[Unit], prints: Sequence[str], earlier: Mapping[str, Any]) -> None:
    """Record the settings of units that are not yet in the journal, in one entry for each set of settings."""
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
    """State of a run in progress."""

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
                # workers that are waiting get their next unit first
                idle = not self.executor.ahead and any(event.kind in FINAL_EVENTS for event in events)
                if self.following is not None and not idle:
                    self.following.advance(self.files, self._available())
                if not events:  # the window can stop the work here
                    yield self._progress(None, began, kept)
        except BaseException:
            self.journal.note("stopped")
            raise
        self.journal.note("end")

    def _available(self) -> int:
        """Return the number of units before the first one that is not done."""
        return next((k for k, share in enumerate(self.shares) if share < 1.0), len(self.shares))

    def _check_room(self) -> None:
        """Raise `StorageError` if the remaining files, each as small as the smallest so far, do not fit on the disk.

        The error then comes as early as possible, and not hours later from a full disk.
        """
        left = sum(share < 1.0 for share in self.shares)
        if self.joined:
            left += len(self.files) - (self.following.taken if self.following is not None else 0)
        require_space(self.files[0].parent, left * (self.least or 0), what="the remaining files")

    def _note_size(self, path: Path) -> None:
        """Note the size of a unit's file."""
        with suppress(OSError):  # a file from another machine may become visible later
            size = path.stat().st_size
            self.least = size if self.least is None else min(self.least, size)

    def _submit_missing(self, seals: Mapping[str, str]) -> Work[None]:
        """Keep complete files, and submit the other units."""
        clock = Clock("checking existing files", len(self.jobs))
        for job in self.jobs:
            path, name = Path(job.out), job.unit.name
            there = path.exists()
            # a file without an entry is complete: its run was killed right after moving it into place
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
        """Submit lost units again after their delay."""
        now = time.monotonic()
        if self.later and len(self.later) == len(self.open) and all(at > now for at, _ in self.later):
            time.sleep(PAUSE / 4)  # no other unit is running
        for due in [due for due in self.later if due[0] <= now]:
            self.later.remove(due)
            self.executor.submit(due[1])

    def _progress(self, event: Event | None, began: float, kept: float) -> Progress:
        done, total = sum(self.shares), len(self.jobs)
        if event is not None:
            self.stage = event.stage or event.job.unit.name
        # in thousandths, so that a few long units show progress; units of an earlier run do not count for the speed
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
            self.shares[number] = min(event.share, 0.999)  # 1 only when its file exists
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
    """Mark a unit's file as intact if its seal is still the one that the worker reported."""
    path = Path(event.job.out)
    if path.suffix == ".h5" and event.seal == seal_of(path):
        trust(path)


def _given_up(event: Event, attempts: int) -> Exception:
    error = event.error
    assert error is not None
    if isinstance(error, StorageError):
        return error
    return type(error)(
        f"{event.job.unit.name}: {error} in each of {attempts} attempts; memory may be insufficient: use fewer workers"
    )


class Following:
    """Object that joins finished files step by step while other units are running.

    Parameters
    ----------
    join
        Function that returns a generator, given the files of all units. The first step of the generator reads no file,
        the second reads the first file, and so on. The output is complete, and gets its name, only after the last step.
    """

    def __init__(self, join: Callable[[tuple[Path, ...]], Work[None]]) -> None:
        self._join = join
        self._steps: Work[None] | None = None
        self._taken = -1
        self._last: Progress | None = None

    @property
    def taken(self) -> int:
        """Number of files that have been joined."""
        return max(0, self._taken)

    def advance(self, files: Sequence[Path], available: int) -> None:
        """Join one more file if one of the first ``available`` files has not been joined yet.

        ``files`` are those of all units. The first call joins no file; it only prepares the output.
        """
        if self._steps is None:
            self._steps = self._join(tuple(files))
        if self._taken < available <= len(files):
            # one more step would finish the output, which is left to `rest`
            self._last, self._taken = next(self._steps), self._taken + 1

    def rest(self, files: Sequence[Path]) -> Work[None]:
        """Join all remaining files and complete the output; yields progress."""
        if self._steps is None:
            self._steps = self._join(tuple(files))
        elif self._last is not None:
            yield self._last
        yield from self._steps

    def close(self) -> None:
        """Stop joining, and remove an incomplete output."""
        if self._steps is not None:
            self._steps.close()
