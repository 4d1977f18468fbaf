"""Long work in units, as several commands offer it: by whom, and after a kill."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from lfcal import tasks
from lfcal.base import LfcalError
from lfcal.cli._console import KEPT, report, run_work
from lfcal.tasks import RunSettings

if TYPE_CHECKING:
    from lfcal.base import Work
    from lfcal.work import RunChoice

__all__ = ["may_replace", "run_choice", "run_kept"]

R = TypeVar("R")


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
    run = RunSettings(executor=executor, scheduler=scheduler, workers=workers, resume=resume, force=force)
    return run.choice(out, seconds, units)


def may_replace(out: Path, *, resume: bool, force: bool) -> bool:
    """Return whether what lies at ``out`` may be replaced: by ``--force``, or as an earlier run began to write it."""
    return tasks.may_replace(out, RunSettings(resume=resume, force=force))


def run_kept(work: Work[R], *outs: Path, quiet: bool) -> R:
    """Drain work in units with a progress bar; where it ends early, say what is kept of it, and else keep nothing."""
    try:
        return run_work(work, quiet=quiet)
    except BaseException as error:
        with suppress(LfcalError):  # it may have ended before it began
            for out in outs:
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
