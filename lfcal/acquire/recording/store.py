"""Common writing of the files of a recording: positions, check frames and dark frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording.recording_file import RecordingFile, RecordingJournal
from lfcal.acquire.recording.records import FILES, RECORD, Kind, Note, file_name
from lfcal.acquire.schedule import Schedule, ScheduledFrame
from lfcal.base import FileFormatError, format_pixels, require_space

__all__ = ["Store", "files_of", "recording_bytes"]

T = TypeVar("T")
CHECKS = (Kind.REFERENCE, Kind.CONTROL)


class Store:
    """Files of one recording of a session, open for writing; the `Sink` of its runner.

    Parameters
    ----------
    journals
        Files open for writing, by kind of frame. Packed files are complete, and are therefore absent.
    schedule
        Steps of the recording.
    taken
        For each kind, whether each slot contains an intact acknowledged frame. None: none does.
    earlier
        Records ``(n,)`` of the acknowledged frames in each file of the recording, including packed files.
    """

    def __init__(
        self,
        journals: dict[Kind, RecordingJournal],
        schedule: Schedule,
        taken: dict[Kind, NDArray[np.bool_]] | None = None,
        earlier: tuple[NDArray[Any], ...] = (),
    ) -> None:
        self._journals = journals
        self._schedule = schedule
        self._taken = taken or {kind: np.zeros(j.layout.count, np.bool_) for kind, j in journals.items()}
        # a resumed session continues from its highest number in all files
        self._sequence = max((int(found["sequence"].max()) + 1 for found in earlier if len(found)), default=0)
        self.elapsed_s = max((float(found["elapsed_s"].max()) for found in earlier if len(found)), default=0.0)

    @classmethod
    def create(
        cls,
        folder: Path,
        run: int,
        schedule: Schedule,
        dtype: np.dtype[Any],
        attributes: dict[str, Any],
        *,
        reserve: int = 0,
    ) -> Store:
        """Create the files of recording ``run`` for frames of ``dtype``, with the HDF5 ``attributes``.

        Raises `StorageError` unless ``reserve`` bytes stay free on the disk; no files are left then.
        """
        plans = files_of(schedule, dtype)
        require_space(folder, recording_bytes(schedule, dtype) + reserve, what="the recording and its reserve")
        opened: dict[Kind, RecordingJournal] = {}
        try:
            for kind, (count, shape, sample) in plans.items():
                about = {**attributes, "holds": FILES[kind]}
                opened[kind] = RecordingJournal.create(folder / file_name(kind, run), count, shape, sample, about)
        except BaseException:
            # an incomplete set of files would look like a recording to resume
            for kind, journal in opened.items():
                journal.close()
                (folder / file_name(kind, run)).unlink(missing_ok=True)
            raise
        return cls(_shared(opened), schedule)

    @classmethod
    def open(
        cls,
        folder: Path,
        run: int,
        schedule: Schedule,
        dtype: np.dtype[Any],
        identity: str,
        damaged: Callable[[str], NDArray[np.int64]],
    ) -> Store:
        """Open the files of recording ``run`` to continue it.

        ``damaged`` is called with the name of each file, and returns the slots to be recorded again. Raises
        `FileFormatError` if the files belong to a session other than ``identity``, or have frames of another layout.
        """
        opened: dict[Kind, RecordingJournal] = {}
        taken: dict[Kind, NDArray[np.bool_]] = {}
        earlier = []
        try:
            for kind, wanted in files_of(schedule, dtype).items():
                path = folder / file_name(kind, run)
                with RecordingFile(path) as file:
                    _check_session(file, wanted, identity)
                    good, records, in_place = file.taken, file.records, file.layout.in_place
                good[damaged(path.name)] = False
                earlier.append(records[good])
                if in_place:
                    opened[kind], taken[kind] = RecordingJournal(path), good
            return cls(_shared(opened), schedule, _shared(taken), tuple(earlier))
        except BaseException:
            for journal in opened.values():
                journal.close()
            raise

    @property
    def writable(self) -> bool:
        """Whether any of the files can still be written."""
        return bool(self._journals)

    def put(self, step: ScheduledFrame, frame: NDArray[Any], note: Note) -> None:
        """Write a frame with its note, without waiting for the disk."""
        journal = self._journals[step.kind]
        journal.put(step.slot, frame.astype(journal.layout.dtype, copy=False), note, self._sequence)
        self._sequence += 1

    def sync(self, kinds: set[Kind]) -> None:
        """Wait until all frames of these kinds that were passed to `put` are on disk."""
        # by identity, because reference and control frames share one journal
        for journal in {id(self._journals[kind]): self._journals[kind] for kind in kinds}.values():
            journal.sync()

    def todo(self) -> NDArray[np.bool_]:
        """Return a mask ``(steps,)`` of the steps of the schedule that had no acknowledged frame on opening."""
        todo = np.zeros(len(self._schedule), np.bool_)
        for kind, taken in self._taken.items():
            steps = self._schedule.kinds == kind
            todo[steps] = ~taken[self._schedule.slots[steps]]
        return todo

    def checksums(self) -> dict[int, int]:
        """Return the flat positions of the `Kind.POSITION` frames that were acknowledged on opening, by CRC-32.

        The result is empty if their file is packed.
        """
        journal = self._journals.get(Kind.POSITION)
        if journal is None:
            return {}
        records = journal.records()[self._taken[Kind.POSITION]]
        return dict(zip(records["frame_crc"].tolist(), records["index"].tolist(), strict=True))

    def close(self) -> None:
        """Close all files."""
        for journal in self._journals.values():
            journal.close()


def recording_bytes(schedule: Schedule, dtype: np.dtype[Any]) -> int:
    """Return the size of all frames and records of a recording (bytes).

    ``dtype`` is the sample type of all frames except dark frames, which are float32.
    """
    return sum(
        count * (shape[0] * shape[1] * kind.itemsize + RECORD.itemsize)
        for count, shape, kind in files_of(schedule, dtype).values()
    )


def files_of(schedule: Schedule, dtype: np.dtype[Any]) -> dict[Kind, tuple[int, tuple[int, int], np.dtype[Any]]]:
    """Return the number, shape and dtype of the frames in each kind's file; control frames count as references.

    ``dtype`` is the sample type of all frames except dark frames, which are float32. Kinds without frames are absent.
    """
    plans: dict[Kind, tuple[int, tuple[int, int], np.dtype[Any]]] = {}
    for kind, count, shape, sample in (
        (Kind.POSITION, schedule.count(Kind.POSITION), schedule.window, dtype),
        (Kind.REFERENCE, schedule.count(*CHECKS), schedule.window, dtype),
        (Kind.DARK, schedule.count(Kind.DARK), schedule.roi.shape, np.dtype(np.float32)),
    ):
        if count:
            plans[kind] = (count, shape, sample)
    return plans


def _check_session(file: RecordingFile, wanted: tuple[int, tuple[int, int], np.dtype[Any]], identity: str) -> None:
    """Raise `FileFormatError` unless ``file`` belongs to session ``identity`` and has frames of the expected layout."""
    layout, (count, shape, sample) = file.layout, wanted
    found = layout.attributes.get("session")
    for what, want, got in (
        (
            "frames",
            f"{count} of {format_pixels(shape)} of {sample}",
            f"{layout.count} of {format_pixels(layout.shape)} of {layout.dtype}",
        ),
        # otherwise a file copied from another session would be filled with frames of this one
        ("session", identity, found),
    ):
        if want != got:
            raise FileFormatError.expected(f"{file.path}, {what}", want, got, "restore it from a copy")


def _shared(opened: dict[Kind, T]) -> dict[Kind, T]:
    """Let control frames use the file of the references."""
    if Kind.REFERENCE in opened:
        return {**opened, Kind.CONTROL: opened[Kind.REFERENCE]}
    return opened
