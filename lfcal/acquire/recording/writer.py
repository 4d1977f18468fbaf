"""A thread that waits for the disk while the next frame is being taken.

The disk then works in parallel with stage and camera, and a disk that is slower than the camera writes several frames
in one sync. Nothing is acknowledged before it is on the disk. Frames in flight when the program dies are taken again.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, Protocol

from numpy.typing import NDArray

from lfcal.acquire.recording.records import Kind, Note
from lfcal.acquire.schedule import ScheduledFrame
from lfcal.base import LfcalError

__all__ = ["Acknowledged", "Sink", "Writer"]


class Sink(Protocol):
    """Where frames go."""

    def put(self, step: ScheduledFrame, frame: NDArray[Any], note: Note) -> None:
        """Hand a frame with its note to the operating system."""
        ...

    def sync(self, kinds: set[Kind]) -> None:
        """Return when all frames of these kinds that were put are on the disk."""
        ...


class Acknowledged(NamedTuple):
    """A frame that is safe on the disk, with its step and note."""

    step: ScheduledFrame
    note: Note
    frame: NDArray[Any]


class Writer:
    """Put frames into a `Sink` and have a thread make them safe, at most ``depth`` in flight.

    All methods are for one thread. An error of the disk is raised by one of the next ``depth`` calls; nothing is
    acknowledged after it.
    """

    def __init__(self, sink: Sink, *, depth: int = 4) -> None:
        self._sink, self._depth = sink, depth
        self._jobs: SimpleQueue[Acknowledged | None] = SimpleQueue()
        self._answers: SimpleQueue[list[Acknowledged] | BaseException] = SimpleQueue()
        self._in_flight = 0
        self._safe: list[Acknowledged] = []
        self._thread = threading.Thread(target=self._work, name="frame writer", daemon=True)
        self._thread.start()

    def submit(self, step: ScheduledFrame, frame: NDArray[Any], note: Note) -> list[Acknowledged]:
        """Put a frame, waiting while ``depth`` others are in flight; return what became safe meanwhile."""
        while self._in_flight >= self._depth:
            self._take(self._answers.get())
        self._sink.put(step, frame, note)
        self._in_flight += 1
        self._jobs.put(Acknowledged(step, note, frame))
        return self.collect()

    def collect(self) -> list[Acknowledged]:
        """Return what became safe since the last call, without waiting."""
        while self._in_flight:
            try:
                answer = self._answers.get_nowait()
            except Empty:
                break
            self._take(answer)
        return self._handed_out()

    def flush(self) -> list[Acknowledged]:
        """Wait until everything put is safe; return what became so."""
        while self._in_flight:
            self._take(self._answers.get())
        return self._handed_out()

    def salvage(self) -> list[Acknowledged]:
        """Wait for what can still become safe after an error and return it; raises nothing of the disk's."""
        with suppress(LfcalError, OSError):
            while self._in_flight:
                self._take(self._answers.get())
        return self._handed_out()

    def close(self) -> None:
        """End the thread after what is in flight; may be called twice."""
        self._jobs.put(None)
        self._thread.join()

    def _take(self, answer: list[Acknowledged] | BaseException) -> None:
        if isinstance(answer, BaseException):
            self._in_flight = 0  # what was in flight will never be acknowledged
            raise answer
        self._in_flight -= len(answer)
        self._safe += answer

    def _handed_out(self) -> list[Acknowledged]:
        safe, self._safe = self._safe, []
        return safe

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            # one sync for all that waits: a slow disk is called less often
            batch, last = [job], False
            while not self._jobs.empty():
                more = self._jobs.get()
                if more is None:
                    last = True
                    break
                batch.append(more)
            try:
                self._sink.sync({item.step.kind for item in batch})
            except BaseException as error:  # it belongs to the thread that records
                self._answers.put(error)
                return
            self._answers.put(batch)
            if last:
                return
