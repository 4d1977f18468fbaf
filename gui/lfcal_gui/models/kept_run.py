"""What is kept of work in units that ended early: the files of finished units, next to the output file. No Qt."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from lfcal.base import InputError, LfcalError
from lfcal.work import PASS, RunChoice, RunState, discard, parts_folder, read_events, read_run, stamp_of


def going_on() -> RunChoice:
    """Return how the window runs units: in its process, resuming an earlier run of the same work."""
    return RunChoice("threads", begun="resume")


def stamp_of_files(*places: str, but: str) -> str:
    """Return a stamp that changes with the files of folders and lists. The output file ``but`` does not count.

    Only the recorded files of a session count: its folder often holds results, too.
    """
    from lfcal.frames import RECORDINGS, files_of

    made, found = Path(but).absolute(), set()
    for place in places:
        files = [path.absolute() for path in files_of(place) if path.is_file()]
        if place and (Path(place) / "session.json").is_file():
            files = [path for path in files if path.name.startswith((*RECORDINGS, "session"))]
        found |= set(files)
    return stamp_of(sorted(str(path) for path in found - {made}))


@dataclass(frozen=True)
class KeptRun:
    """The units of a run; see `lfcal_gui.models.job.Keeping`.

    Attributes
    ----------
    out
        The output file.
    """

    out: str

    def look(self) -> str:
        """Return the number of finished units as text; remove their folder if there is none."""
        try:
            state = read_run(parts_folder(self.out))
        except InputError:  # it ended before the first unit
            return ""
        if state.running:  # run by another window, or by a command
            return ""
        which = state.title.rpartition(", ")[2]  # "simulate H.h5, pass 2 of 4"
        of_which = f" of {which}" if which.startswith(f"{PASS} ") else ""
        if state.count("done") or PASS in read_events(parts_folder(self.out)):
            return f"{state.count('done')} of {len(state.units)} {_kind(state)}{of_which}"
        with suppress(LfcalError):
            self.discard()
        return ""

    def discard(self) -> None:
        """Remove the units' files."""
        discard(parts_folder(self.out))


def _kind(state: RunState) -> str:
    """Return what the units are: units called ``"plane 0003"`` are planes."""
    kinds = {unit.name.rsplit(" ", 1)[0] for unit in state.units} or {"plane"}
    return f"{kinds.pop()}s" if len(kinds) == 1 else "units"
