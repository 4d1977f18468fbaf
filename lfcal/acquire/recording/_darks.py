"""The dark frames of a recorded session, averaged by exposure."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording._recorded import RecordedFile
from lfcal.acquire.recording.records import Kind
from lfcal.acquire.schedule import Schedule
from lfcal.acquire.session_file import SessionFile
from lfcal.base import FileFormatError, StorageError
from lfcal.frames import Dark, LeftOut, average_frames
from lfcal.frames.corrections import difference_variance

__all__ = ["RecordedDarks", "read_darks"]


@dataclass(frozen=True)
class RecordedDarks:
    """Mean dark frames by exposure (s), what was left out of them, and exposures (s) of which none is whole."""

    darks: dict[float, Dark] = field(default_factory=dict)
    left_out: tuple[LeftOut, ...] = ()
    lost: tuple[float, ...] = ()


def read_darks(folder: Path, session: SessionFile, schedule: Schedule, *, skip_damaged: bool = False) -> RecordedDarks:
    """Return the dark frames of a session, nothing where none was to be recorded.

    Parameters
    ----------
    folder, session, schedule
        The session and the steps of its first recording.
    skip_damaged
        Average what is whole, and name what is not.

    Raises
    ------
    FileFormatError, StorageError
        Unless ``skip_damaged``: if a dark frame is damaged, or their file is gone.
    """
    if not schedule.count(Kind.DARK):
        return RecordedDarks()
    file = RecordedFile(folder, session, 0, schedule, Kind.DARK)
    darks: dict[float, Dark] = {}
    left_out: list[LeftOut] = []
    lost: list[float] = []
    try:
        if not skip_damaged:
            file.check()
        # nanoseconds: the same exposure read back twice may differ in its last bits
        exposures = np.round(file.records["exposure_s"], 9)
        for seconds in np.unique(exposures[file.there]).tolist():
            slots = np.flatnonzero(file.there & (exposures == seconds)).tolist()
            frames = _whole(file, slots, left_out, skip_damaged)
            if frames:
                first = file.records[next(iter(frames))]
                place = (int(first["row"]), int(first["column"]))
                # each frame in the file is the mean of as many exposures as were asked for
                count = len(frames) * session.options.darks
                shown = list(frames.values())
                pairs = [difference_variance(*pair) for pair in pairwise(shown)]
                variance = session.options.darks * float(np.mean(pairs)) if pairs else None
                darks[float(seconds)] = Dark(average_frames(shown), origin=place, count=count, variance=variance)
            else:
                lost.append(float(seconds))
    finally:
        file.close()
    return RecordedDarks(darks, tuple(left_out), tuple(lost))


def _whole(
    file: RecordedFile, slots: list[int], left_out: list[LeftOut], skip_damaged: bool
) -> dict[int, NDArray[np.float32]]:
    """Return the frames that are whole by slot, and note the others."""
    frames = {}
    for slot in slots:
        try:
            frames[slot] = file.read(slot)
        except (FileFormatError, StorageError) as error:
            if not skip_damaged:
                raise type(error)(f"dark frame: {error}, or leave it out (--skip-damaged)") from error
            left_out.append(LeftOut(file.label(slot), None, str(error)))
    return frames
