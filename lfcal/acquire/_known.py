"""What earlier runs of a session recorded around the positions that are still to do."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording import RecordingSource
from lfcal.base import LfcalError
from lfcal.frames import Position

__all__ = ["Known", "known_around"]

ENOUGH = 512


class Known(NamedTuple):
    """A position that was recorded: its frame ``(rows, columns)``, saturated pixels, and exposure (s)."""

    position: Position
    frame: NDArray[Any]
    saturated: int
    exposure_s: float


def known_around(folder: Path, todo: NDArray[np.bool_]) -> list[Known]:
    """Return the trusted frames next to the positions of ``todo`` ``(nz, ny, nx)``, some hundreds at most.

    Frames that cannot be read are left out: there is less to compare with, and nothing else.
    """
    near = todo.copy()
    for axis in (1, 2):
        for step in (-1, 1):
            near |= np.roll(near, step, axis)
    known: list[Known] = []
    with suppress(LfcalError), RecordingSource(folder, skip_damaged=True) as source:
        suspect = {position for position, _ in source.suspects()}
        for k in range(len(source)):
            info = source.info(k)
            if near[info.position] and not todo[info.position] and info.position not in suspect:
                with suppress(LfcalError):
                    record = source.record(k)
                    exposure, saturated = float(record["exposure_s"]), int(record["saturated"])
                    known.append(Known(info.position, source.read(k), saturated, exposure))
            if len(known) == ENOUGH:
                break
    return known
