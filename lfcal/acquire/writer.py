"""A thread that writes one frame while the next is being taken.

The disk's time and the stage's and camera's time then overlap. Nothing is acknowledged before it is on the
disk; what is in flight when the program dies is simply taken again.
"""

from __future__ import annotations

import threading
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, Protocol

from numpy.typing import NDArray

from lfcal.acquire.records import Note
from lfcal.acquire.schedule import Step

__all__ = ["Acknowledged", "Sink", "Writer"]


class Sink(Protocol):
    """Where frames go; returns only when they are safe."""

    def write(self, step: Step, frame: NDArray[Any], note: Note) -> None:
        """Write a frame with its note and return when both are on the disk."""
        ...


class Acknowledged(NamedTuple):
    """A frame that is safe on the disk, with its step and note."""

    step: Step
    note: Note
    frame: NDArray[Any]


class Writer:
    """Hand frames to a `Sink` in a thread of its own, at most ``depth`` at a time.

    All methods are for one thread. An error of the sink is raised there by the next call; frames after it
    are not written.
    """

    def __init__(self, sink: Sink, *, depth: int = 2) -> None:
        self._sink, self._depth = sink, depth
        self._jobs: SimpleQueue[Acknowledged | None] = SimpleQueue()
        self._answers: SimpleQueue[tuple[Acknowledged, BaseException | None]] = SimpleQueue()
        self._in_flight = 0
        self._thread = threading.Thread(target=self._work, name="frame writer", daemon=True)
        self._thread.start()

    def submit(self, step: Step, frame: NDArray[Any], note: Note) -> list[Acknowledged]:
        """Hand over a frame, waiting while ``depth`` others are in flight; return what became safe meanwhile."""
        done = self.collect()
        while self._in_flight >= self._depth:
            done.append(self._take(self._answers.get()))
        self._in_flight += 1
        self._jobs.put(Acknowledged(step, note, frame))
        return done

    def collect(self) -> list[Acknowledged]:
        """Return what became safe since the last call, without waiting."""
        done = []
        while self._in_flight:
            try:
                answer = self._answers.get_nowait()
            except Empty:
                break
            done.append(self._take(answer))
        return done

    def flush(self) -> list[Acknowledged]:
        """Wait until everything handed over is safe; return what became so."""
        done = []
        while self._in_flight:
            done.append(self._take(self._answers.get()))
        return done

    def close(self) -> None:
        """End the thread after what is in flight; may be called twice."""
        self._jobs.put(None)
        self._thread.join()

    def _take(self, answer: tuple[Acknowledged, BaseException | None]) -> Acknowledged:
        self._in_flight -= 1
        item, error = answer
        if error is not None:
            raise error
        return item

    def _work(self) -> None:
        failed: BaseException | None = None
        while (job := self._jobs.get()) is not None:
            if failed is None:
                try:
                    self._sink.write(*(job.step, job.frame, job.note))
                except BaseException as error:  # it belongs to the thread that records
                    failed = error
            self._answers.put((job, failed))
