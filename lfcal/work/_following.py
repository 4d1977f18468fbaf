"""Work that takes the files of units in their order while later units are still under way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from lfcal.base import Progress, Work

__all__ = ["Following"]


class Following:
    """Joins what is there, a step at a time: who waits for workers has little else to do.

    Parameters
    ----------
    join
        Gives the work for the files of all units: its first step needs none of them, the next the first, and so on;
        what it makes is whole, and has its name, only behind its last step.
    """

    def __init__(self, join: Callable[[tuple[Path, ...]], Work[None]]) -> None:
        self._join = join
        self._steps: Work[None] | None = None
        self._taken = -1
        self._last: Progress | None = None

    @property
    def taken(self) -> int:
        """How many files were taken."""
        return max(0, self._taken)

    def advance(self, files: Sequence[Path], there: int) -> None:
        """Take a step where one of the first ``there`` files was not taken yet."""
        if self._steps is None:
            self._steps = self._join(tuple(files))
        if self._taken < there <= len(files):
            # a step more would end it: that is for `rest`
            self._last, self._taken = next(self._steps), self._taken + 1

    def rest(self, files: Sequence[Path]) -> Work[None]:
        """Take all that are left, and end."""
        if self._steps is None:
            self._steps = self._join(tuple(files))
        elif self._last is not None:
            yield self._last
        yield from self._steps

    def close(self) -> None:
        """Leave nothing half-written."""
        if self._steps is not None:
            self._steps.close()
