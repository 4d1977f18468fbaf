"""What belongs into the files of a session: which frame into which slot, and how each file was laid out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording._recovery import Made
from lfcal.acquire.recording.records import RECORD, Kind, file_name
from lfcal.acquire.recording.store import files_of
from lfcal.acquire.schedule import Schedule
from lfcal.acquire.session_file import SessionFile, frame_dtype

__all__ = ["Slots", "files_made", "slots_of"]


class Slots(NamedTuple):
    """What belongs into each of the ``N`` slots of one file.

    ``kinds`` ``(N,)``, ``flat`` ``(N,)`` positions of the plan, ``origins`` ``(N, 2)`` sensor (row, column) of the
    first pixel, as in `Schedule`.
    """

    kinds: NDArray[np.uint8]
    flat: NDArray[np.int64]
    origins: NDArray[np.int64]

    def records(self, exposures_s: NDArray[np.float64]) -> NDArray[np.void]:
        """Return stand-ins ``(N,)`` for records that are lost, with the exposure (s) of each slot's plane."""
        records = np.zeros(len(self.flat), RECORD)
        records["index"], records["kind"], records["exposure_s"] = self.flat, self.kinds, exposures_s
        records["row"], records["column"] = self.origins.T
        return records


def slots_of(schedule: Schedule, kind: Kind) -> Slots:
    """Return what belongs into the slots of the file for ``kind``."""
    here = np.isin(schedule.kinds, [k for k in Kind if file_name(k, 0) == file_name(kind, 0)])
    order = np.argsort(schedule.slots[here])
    kinds, flat, origins = (values[here][order] for values in (schedule.kinds, schedule.flat, schedule.origins))
    return Slots(kinds.astype(np.uint8), flat.astype(np.int64), origins.astype(np.int64))


def files_made(session: SessionFile, run: int, schedule: Schedule) -> dict[Kind, Made]:
    """Return how the files of recording ``run`` are laid out, by the kind they are for."""
    plans = files_of(schedule, frame_dtype(session.plan, session.options, session.devices))
    about = session.attributes(run, schedule)
    return {kind: Made(kind, *plan, about) for kind, plan in plans.items()}
