"""The queue of jobs: heavy ones one after the other, in an order that can be changed. No Qt."""

from __future__ import annotations


class Line:
    """Numbers of the waiting jobs, and of the running one.

    Attributes
    ----------
    at_work
        The job whose turn it is, None if there is none.
    """

    def __init__(self) -> None:
        self._waiting: list[int] = []
        self.at_work: int | None = None

    @property
    def waiting(self) -> tuple[int, ...]:
        """Jobs that wait, the next one first."""
        return tuple(self._waiting)

    def add(self, number: int) -> None:
        """Let a job wait at the end."""
        self._waiting.append(number)

    def next(self) -> int | None:
        """Return the next job, None if one is running or none waits."""
        if self.at_work is not None or not self._waiting:
            return None
        self.at_work = self._waiting.pop(0)
        return self.at_work

    def leave(self, number: int) -> None:
        """Forget a job that has ended, or waits no longer."""
        if number == self.at_work:
            self.at_work = None
        elif number in self._waiting:
            self._waiting.remove(number)

    def move(self, number: int, by: int) -> bool:
        """Move a job that waits by so many places, later where positive; return whether that changed the order."""
        if number not in self._waiting:
            return False
        at = self._waiting.index(number)
        to = min(max(at + by, 0), len(self._waiting) - 1)
        self._waiting.insert(to, self._waiting.pop(at))
        return to != at
