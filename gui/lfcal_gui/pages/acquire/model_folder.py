"""State of a session folder. No Qt."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire import EarlierRuns, Options, frame_grid, frame_positions
from lfcal.camera import ScanPlan
from lfcal.frames import Position

if TYPE_CHECKING:
    from lfcal.targets import TargetPlan

ELSEWHERE = (
    "this folder contains a session of {}, which the window cannot continue; choose another "
    "folder, or use lfcal acquire --resume"
)


@dataclass(frozen=True, eq=False)
class FolderState:
    """State of a session folder.

    Attributes
    ----------
    there
        Recorded positions ``(nz, ny, nx)`` (bool); None if the folder contains no session.
    how
        How the last run ended, in words.
    problem
        Why the folder cannot be read; empty if it can.
    plan, options
        Plan and options of the session.
    chosen
        Positions chosen for recording ``(nz, ny, nx)`` (bool). None: all of the plan.
    target
        Plan of the target whose frames are recorded; ``there`` then refers to these frames.
    recordings
        Names of the files with the frames, oldest first.
    free_bytes
        Free space on its disk; None if unknown.
    """

    there: NDArray[np.bool_] | None = None
    how: str = ""
    problem: str = ""
    plan: ScanPlan | None = None
    options: Options | None = None
    chosen: NDArray[np.bool_] | None = None
    target: TargetPlan | None = None
    recordings: tuple[str, ...] = ()
    free_bytes: float | None = None

    @property
    def counts(self) -> tuple[int, int]:
        """Number of recorded positions (or frames of a target), and number of all that are to be recorded."""
        if self.there is None:
            return 0, 0
        if self.chosen is None:
            return int(self.there.sum()), self.there.size
        return int(self.there[self.chosen].sum()), int(self.chosen.sum())

    def known(self, but: Sequence[Position] = ()) -> EarlierRuns | None:
        """Return the recorded positions except those to record again; None if there are none."""
        if self.there is None or self.plan is None:
            return None
        if self.target is None:
            grid = self.plan.shape[:3]
            flat = np.flatnonzero(self.there)
        else:
            grid = frame_grid(self.target)
            flat = np.ravel_multi_index(tuple(frame_positions(self.target)[self.there].T), grid)
        again = np.ravel_multi_index(tuple(np.array(but, np.intp).reshape(-1, 3).T), grid, mode="clip")
        return EarlierRuns(np.setdiff1d(flat, again), grid, self.recordings)

    @property
    def complete(self) -> bool:
        """Whether every chosen position is recorded."""
        if self.there is None:
            return False
        return bool(self.there.all() if self.chosen is None else self.there[self.chosen].all())

    def planes(self) -> tuple[int, ...]:
        """Return the planes in which every position is recorded."""
        if self.there is None or self.target is not None:
            return ()
        return tuple(np.flatnonzero(self.there.reshape(len(self.there), -1).all(axis=1)).tolist())

    def words(self) -> str:
        """Return the state of the folder as one line of text."""
        if self.problem:
            return self.problem
        if self.there is None:
            return "a new session"
        done, total = self.counts
        counted = f"{done} of {total} positions safe on disk"
        if self.target is not None:
            counted = f"{done} of {total} frames of a target safe on disk"
        elif self.chosen is not None:
            counted = f"{done} of {total} chosen positions safe on disk, of {self.there.size} of the plan"
        return counted + (f"; the last run: {self.how}" if self.how else "")


def folder_state(folder: str) -> FolderState:
    """Return the state of ``folder``; a damaged session is reported in ``problem``, not raised."""
    return replace(_state_of(folder), free_bytes=_free_bytes(folder))


def _free_bytes(folder: str) -> float | None:
    """Return the free space on the disk of a folder that may not exist yet."""
    path = Path(folder)
    there = next((one for one in (path, *path.parents) if one.is_dir()), None) if folder else None
    try:
        return None if there is None else float(shutil.disk_usage(there).free)
    except OSError:
        return None


def _state_of(folder: str) -> FolderState:
    from lfcal.acquire import SessionFile
    from lfcal.base import LfcalError

    if folder and (Path(folder) / "regions.json").exists():
        return FolderState(problem=ELSEWHERE.format("several regions of the field"))
    if not folder or not (Path(folder) / "session.json").exists():
        return FolderState()
    try:
        session = SessionFile.read(Path(folder))
        there = session.acknowledged(Path(folder))
    except (LfcalError, OSError) as error:
        return FolderState(problem=str(error))
    how = session.runs[-1].how if session.runs else ""
    if session.target is not None:
        target: TargetPlan = session.target  # type: ignore[assignment]  # a session's frame plan is a target's
        there = there[tuple(frame_positions(target).T)]
        return FolderState(there, how, "", session.plan, session.options, None, target, session.recordings)
    chosen = session.chosen if session.redo[0] else None
    return FolderState(there, how, "", session.plan, session.options, chosen, None, session.recordings)
