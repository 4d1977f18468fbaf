"""Long work in units, as several commands offer it: by whom, and after a kill."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from lfcal.base import LfcalError
from lfcal.cli._console import KEPT, report, run_work

if TYPE_CHECKING:
    from lfcal.base import Work
    from lfcal.work import RunChoice

__all__ = ["LONG", "may_replace", "run_choice", "run_kept"]

R = TypeVar("R")

LONG = 60.0
"""Seconds of processor time from which on work is done in units without being asked: a kill loses one of them."""


def run_choice(
    out: Path,
    executor: str,
    scheduler: str,
    workers: int | None,
    *,
    resume: bool,
    force: bool,
    seconds: float = 0.0,
    units: str = "plane by plane",
) -> RunChoice | None:
    """Return how to run work in units, or None where it is short and nobody asked for it.

    Parameters
    ----------
    out
        What the work makes.
    executor, scheduler, workers, resume, force
        As given; an empty ``executor`` was not.
    seconds
        That it takes by forecast (processor time).
    units
        What the units are, for people.

    Raises
    ------
    InputError
        If these do not go together, or an earlier run left something and neither of them says what becomes of it.
    """
    from lfcal.work import RunChoice, check_begun, parts_folder

    folder = parts_folder(out)
    asked = bool(executor or scheduler or resume)
    choice = RunChoice(
        executor or ("dask" if scheduler else "threads"),
        workers,
        scheduler,
        "resume" if resume else "discard" if force else "refuse",
    )
    check_begun(folder, resume=choice.begun != "refuse")
    if not (asked or seconds > LONG or folder.exists()):
        return None
    if not asked and seconds > LONG:
        report(f"kept {units} in {folder.name}: --resume goes on after a stop")
    return choice


def may_replace(out: Path, *, resume: bool, force: bool) -> bool:
    """Return whether what lies at ``out`` may be replaced: by ``--force``, or as an earlier run began to write it."""
    from lfcal.work import was_joining

    return force or (resume and was_joining(out))


def run_kept(work: Work[R], out: Path, *, quiet: bool) -> R:
    """Drain work in units with a progress bar; where it ends early, say what is kept of it, and else keep nothing."""
    try:
        return run_work(work, quiet=quiet)
    except BaseException as error:
        with suppress(LfcalError):  # it may have ended before it began
            _say_kept(error, out)
        raise


def _say_kept(error: BaseException, out: Path) -> None:
    """Say what is kept of work that ``error`` ended; the folder of a run that has done nothing goes."""
    from lfcal.work import PASS, discard, parts_folder, read_events, read_run, unit_files

    folder = parts_folder(out)
    state = read_run(folder)
    if state.running:  # another program's, which is at work in it
        return
    kept = len(unit_files(folder))
    if not kept and PASS not in read_events(folder):  # a pass that is whole lies at ``out``
        discard(folder)
        return
    report(f"kept: {kept} of {len(state.units)} units in {folder}; --resume goes on with them")
    error.add_note(KEPT)
