"""Settings of a run (its executor, and what happens to an earlier run), and runs that write one output file."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lfcal.base import InputError, Work, any_of, check_choice
from lfcal.work.executors import EXECUTORS, Executor
from lfcal.work.runs import Following, check_begun, discard, iter_run, note_joining, parts_folder
from lfcal.work.unit import Unit

__all__ = ["BEGUN", "RunChoice", "iter_begun", "iter_made"]

BEGUN = ("refuse", "resume", "discard")


@dataclass(frozen=True)
class RunChoice:
    """Executor of a run, and what to do with finished units left by an earlier run.

    Attributes
    ----------
    executor
        Name of an executor in `EXECUTORS`.
    workers
        Number of threads or processes. None: the environment variable ``LFCAL_WORKERS``, or else one per processor.
    address
        Address of a running scheduler, such as ``tcp://host:8786``; empty: a local scheduler is started if required.
    begun
        What to do with finished units left by an earlier run: ``"refuse"`` (raise an error), ``"resume"`` (use them) or
        ``"discard"``.

    Raises
    ------
    InputError
        If the executor does not exist, or an address is given to an executor that does not use one.

    Examples
    --------
    >>> from lfcal.work import RunChoice
    >>> executor = RunChoice("threads", workers=1, begun="resume").make()
    >>> print(executor.name, executor.workers)
    threads 1
    """

    executor: str = "threads"
    workers: int | None = None
    address: str = ""
    begun: str = "refuse"

    def __post_init__(self) -> None:
        """Check that the settings go together."""
        check_choice("an earlier run", self.begun, BEGUN)
        if not EXECUTORS.get(self.executor).addressed and self.address:
            able = any_of(kind.name for kind in EXECUTORS if kind.addressed)
            raise InputError.expected(
                "scheduler", f"an executor with a scheduler ({able})", self.executor, "leave the scheduler out"
            )

    def make(self) -> Executor:
        """Return a new executor that has not been started."""
        return EXECUTORS.get(self.executor).make(self.workers, self.address)


def iter_begun(
    units: Sequence[Unit],
    out: str | os.PathLike[str],
    run: RunChoice,
    *,
    title: str,
    following: Following | None = None,
    joined: bool = False,
) -> Work[tuple[Path, ...]]:
    """Process the units of the file ``out``, and return the files of the units, in order; yields progress.

    The files stay in the folder ``parts_folder(out)`` until the caller discards it.

    ``units``, ``out``, ``run`` and the errors are those of `iter_made`; ``title``, ``following`` and ``joined`` are
    those of `iter_run`.

    Examples
    --------
    >>> from lfcal.base import drain
    >>> from lfcal.psf import open_psf
    >>> from lfcal.psf import Stored
    >>> from lfcal.psf import units_of
    >>> from lfcal.psf import MatrixPlanes
    >>> from lfcal.work import RunChoice, iter_begun, parts_folder
    >>> with open_psf("H.h5") as H:
    ...     units = units_of(MatrixPlanes(H.T, title="transpose to"), Stored(compression="none"))
    >>> files = drain(iter_begun([units[1]], "HT.h5", RunChoice("threads", workers=1), title="HT of plane 1"))
    >>> print(len(files), "file in", files[0].parent.name)
    1 file in HT.h5.parts
    """
    folder = parts_folder(out)
    check_begun(folder, resume=run.begun != "refuse")
    if run.begun == "discard":
        discard(folder)
    return (yield from iter_run(units, folder, run.make(), title=title, following=following, joined=joined))


def iter_made(
    units: Sequence[Unit],
    out: str | os.PathLike[str],
    run: RunChoice,
    join: Callable[[tuple[Path, ...]], Work[None]],
    *,
    title: str,
    keep: bool = False,
    in_order: bool = False,
    joined: bool = True,
) -> Work[None]:
    """Process units, and join their files into the file ``out``; yields progress over both steps.

    Until ``out`` is complete, the files of the units are in the folder ``parts_folder(out)``. After a run is stopped or
    killed, another run can continue from them.

    Parameters
    ----------
    units, title
        As in `iter_run`.
    out
        The file to write.
    run
        Executor, and what to do with units left by an earlier run.
    join
        Function that takes the files of the units, in order, and writes ``out`` atomically.
    keep
        Whether to keep the files of the units after ``out`` is complete. The caller must then delete them.
    in_order
        Whether ``join`` reads one file in each step after a first step that reads none. Joining then begins while units
        are still being processed.
    joined
        As in `iter_run`: whether to check the disk for space for the files and ``out``. Set it to False if ``out`` may
        be much smaller than the files.

    Raises
    ------
    InputError
        If an earlier run was not completed and ``run.begun`` is ``"refuse"``.
    LfcalError
        The errors of `iter_run` and of ``join``.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.base import Progress
    >>> from lfcal.psf import open_psf
    >>> from lfcal.psf import Stored
    >>> from lfcal.psf import units_of
    >>> from lfcal.psf import MatrixPlanes
    >>> from lfcal.work import RunChoice, iter_made
    >>> with open_psf("H.h5") as H:
    ...     units = units_of(MatrixPlanes(H.T, title="transpose to"), Stored(compression="none"))
    >>> def join(files):
    ...     yield Progress(0, 1, "name the file")
    ...     files[0].replace("plane.h5")
    >>> for step in iter_made([units[1]], "plane.h5", RunChoice("threads", workers=1), join, title="HT of plane 1"):
    ...     print(f"{step.stage}: {step.fraction:.0%}")
    plane 0001: 0%
    transpose plane 2: 0%
    transpose plane 2: 100%
    plane 0001: 100%
    name the file: 0%
    >>> print(Path("plane.h5").is_file())
    True
    """
    following = Following(join)
    try:
        early = following if in_order else None
        parts = yield from iter_begun(units, out, run, title=title, following=early, joined=joined)
        # not earlier: until now, no file of this run has the name of ``out``
        note_joining(parts_folder(out))
        yield from following.rest(parts)
    finally:
        following.close()
    if not keep:
        discard(parts_folder(out))
