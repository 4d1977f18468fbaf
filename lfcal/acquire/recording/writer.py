"""Writing in a separate thread, which waits for the disk while the next frame is taken.

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
    """Protocol for a receiver of frames."""

    def put(self, step: ScheduledFrame, frame: NDArray[Any], note: Note) -> None:
        """Write a frame with its note, without waiting for the disk."""
        ...

    def sync(self, kinds: set[Kind]) -> None:
        """Wait until all frames of these kinds that were passed to `put` are on disk."""
        ...


class Acknowledged(NamedTuple):
    """A frame that is safe on the disk, with its step and note."""

    step: ScheduledFrame
    note: Note
    frame: NDArray[Any]


class Writer:
    """Writer that puts frames into a `Sink` and synchronises it in a thread, with at most ``depth`` frames in flight.

    Call all methods from one thread. An error of `Sink.sync` is raised by the next call of `flush`, by one of the next
    ``depth`` calls of `submit`, or by `collect`. No frame is acknowledged after it.
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
        """Write a frame, waiting while ``depth`` others are in flight; return the newly acknowledged frames."""
        while self._in_flight >= self._depth:
            self._take(self._answers.get())
        self._sink.put(step, frame, note)
        self._in_flight += 1
        self._jobs.put(Acknowledged(step, note, frame))
        return self.collect()

    def collect(self) -> list[Acknowledged]:
        """Return the frames acknowledged since the last call, without waiting."""
        while self._in_flight:
            try:
                answer = self._answers.get_nowait()
            except Empty:
                break
            self._take(answer)
        return self._handed_out()

    def flush(self) -> list[Acknowledged]:
        """Wait until all submitted frames are on disk; return the newly acknowledged ones."""
        while self._in_flight:
            self._take(self._answers.get())
        return self._handed_out()

    def salvage(self) -> list[Acknowledged]:
        """Wait for frames that can still be saved after an error, and return them; suppress errors of the sink."""
        with suppress(LfcalError, OSError):
            while self._in_flight:
                self._take(self._answers.get())
        return self._handed_out()

    def close(self) -> None:
        """Wait for the frames in flight and end the thread; may be called twice."""
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
            # one sync for all waiting frames, so that a slow disk is called less often
            batch, last = [job], False
            while not self._jobs.empty():
                more = self._jobs.get()
                if more is None:
                    last = True
                    break
                batch.append(more)
            try:
                self._sink.sync({item.step.kind for item in batch})
            except BaseException as error:  # raise it in the recording thread
                self._answers.put(error)
                return
            self._answers.put(batch)
            if last:
                return
