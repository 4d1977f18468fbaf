"""The recordings of one session as one place to write to: positions, checks and darks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording.records import FILES, RECORD, Kind, Note, file_name
from lfcal.acquire.recording.slots import Journal
from lfcal.acquire.schedule import Schedule, Step
from lfcal.errors import FileFormatError
from lfcal.files import require_space

__all__ = ["Store"]

CHECKS = (Kind.REFERENCE, Kind.CONTROL)


class Store:
    """Open journals of one recording of a session; the `Sink` of its runner.

    Parameters
    ----------
    journals
        One per kind that the schedule has.
    schedule
        The steps.
    recheck
        How many of the latest frames are read again and checked; see `Journal.scan`.
    """

    def __init__(self, journals: dict[Kind, Journal], schedule: Schedule, *, recheck: int = 256) -> None:
        self._journals = journals
        self._schedule = schedule
        self._taken = {kind: journal.scan(recheck=recheck) for kind, journal in journals.items()}
        self._sequence = 0
        self.elapsed_s = 0.0
        for kind, journal in journals.items():
            good = journal.records()[self._taken[kind]]
            if len(good):
                # a resumed session counts on from its highest number, over all files
                self._sequence = max(self._sequence, int(good["sequence"].max()) + 1)
                self.elapsed_s = max(self.elapsed_s, float(good["elapsed_s"].max()))

    @classmethod
    def create(
        cls, folder: Path, run: int, schedule: Schedule, dtype: np.dtype[Any], attributes: dict[str, Any]
    ) -> Store:
        """Lay out and reserve the files of recording ``run``; ``dtype`` is that of its frames."""
        plans = _files(schedule, dtype)
        need = sum(
            count * (shape[0] * shape[1] * kind.itemsize + RECORD.itemsize) for count, shape, kind in plans.values()
        )
        require_space(folder, need, what="the recording")
        opened: dict[Kind, Journal] = {}
        try:
            for kind, (count, shape, sample) in plans.items():
                about = {**attributes, "holds": FILES[kind]}
                opened[kind] = Journal.create(folder / file_name(kind, run), count, shape, sample, about)
        except BaseException:
            # a half-made set of files would look like a recording to resume
            for kind, journal in opened.items():
                journal.close()
                (folder / file_name(kind, run)).unlink(missing_ok=True)
            raise
        return cls(_shared(opened), schedule)

    @classmethod
    def open(cls, folder: Path, run: int, schedule: Schedule, dtype: np.dtype[Any], identity: str) -> Store:
        """Open the files of recording ``run`` to go on; raises `FileFormatError` if they are another session's."""
        opened: dict[Kind, Journal] = {}
        try:
            for kind, (count, shape, sample) in _files(schedule, dtype).items():
                path = folder / file_name(kind, run)
                journal = opened[kind] = Journal(path)
                layout = journal.layout
                if (layout.count, layout.shape, layout.dtype) != (count, shape, sample):
                    raise FileFormatError.expected(
                        str(path),
                        f"{count} frames of {shape} {sample}",
                        f"{layout.count} of {layout.shape} {layout.dtype}",
                        "restore this session's file",
                    )
                # a file put here from another session would be filled up with this one's frames
                if layout.attributes.get("session") != identity:
                    raise FileFormatError.expected(
                        str(path),
                        f"session {identity}",
                        layout.attributes.get("session"),
                        "restore this session's file",
                    )
            return cls(_shared(opened), schedule)
        except BaseException:
            for journal in opened.values():
                journal.close()
            raise

    def put(self, step: Step, frame: NDArray[Any], note: Note) -> None:
        """Hand a frame with its note to the operating system."""
        journal = self._journals[step.kind]
        journal.put(step.slot, frame.astype(journal.layout.dtype, copy=False), note, self._sequence)
        self._sequence += 1

    def sync(self, kinds: set[Kind]) -> None:
        """Return when all frames of these kinds that were put are on the disk."""
        # by identity, because reference and control frames share one journal
        for journal in {id(self._journals[kind]): self._journals[kind] for kind in kinds}.values():
            journal.sync()

    def todo(self) -> NDArray[np.bool_]:
        """Return for each step of the schedule whether it has no acknowledged frame."""
        todo = np.ones(len(self._schedule), np.bool_)
        for kind, taken in self._taken.items():
            steps = self._schedule.kinds == kind
            todo[steps] = ~taken[self._schedule.slots[steps]]
        return todo

    def latest(self) -> tuple[int, NDArray[Any], NDArray[Any]] | None:
        """Return slot, frame and record of the latest acknowledged position, or None."""
        journal, taken = self._journals[Kind.POSITION], self._taken[Kind.POSITION]
        if not taken.any():
            return None
        records = journal.records()
        slot = int(np.argmax(np.where(taken, records["sequence"].astype(np.int64), -1)))
        return slot, journal.read(slot), records[slot]

    def checksums(self) -> dict[int, int]:
        """Return the CRC-32 of every acknowledged position, with its number in the plan."""
        records = self._journals[Kind.POSITION].records()[self._taken[Kind.POSITION]]
        return dict(zip(records["frame_crc"].tolist(), records["index"].tolist(), strict=True))

    def close(self) -> None:
        """Close all files."""
        for journal in self._journals.values():
            journal.close()


def _files(schedule: Schedule, dtype: np.dtype[Any]) -> dict[Kind, tuple[int, tuple[int, int], np.dtype[Any]]]:
    """Return count, shape and dtype of the file of each kind; references stand for all checks."""
    plans: dict[Kind, tuple[int, tuple[int, int], np.dtype[Any]]] = {}
    for kind, count, shape, sample in (
        (Kind.POSITION, schedule.count(Kind.POSITION), schedule.window, dtype),
        (Kind.REFERENCE, schedule.count(*CHECKS), schedule.window, dtype),
        (Kind.DARK, schedule.count(Kind.DARK), schedule.roi.shape, np.dtype(np.float32)),
    ):
        if count:
            plans[kind] = (count, shape, sample)
    return plans


def _shared(opened: dict[Kind, Journal]) -> dict[Kind, Journal]:
    """Let control frames use the file of the references."""
    if Kind.REFERENCE in opened:
        return {**opened, Kind.CONTROL: opened[Kind.REFERENCE]}
    return opened
