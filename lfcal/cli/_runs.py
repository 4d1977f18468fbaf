"""Long work in units, as several commands do it: what is kept of it after a kill."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from lfcal.base import LfcalError
from lfcal.cli._console import KEPT, report, run_work

if TYPE_CHECKING:
    from lfcal.base import Work

__all__ = ["run_kept"]

R = TypeVar("R")


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
