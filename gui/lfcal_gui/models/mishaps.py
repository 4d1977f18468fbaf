"""Unexpected errors: which are reported, how often, and which data are safe. No Qt."""

from __future__ import annotations

import traceback
from collections.abc import Sequence
from dataclasses import dataclass, replace

from lfcal_gui.workers import words_of

MAX_TRACE = 20_000


@dataclass(frozen=True)
class Mishap:
    """An unexpected error.

    Attributes
    ----------
    words
        The error as one line of text.
    trace
        Traceback, for bug reports.
    thread
        Name of the thread in which it occurred.
    key
        Identifies errors of the same kind at the same line of code.
    count
        Number of occurrences so far.
    """

    words: str
    trace: str
    thread: str
    key: tuple[str, ...]
    count: int = 1

    @classmethod
    def of(cls, error: BaseException, thread: str = "MainThread") -> Mishap:
        """Return the record of an exception."""
        trace = "".join(traceback.format_exception(error))[-MAX_TRACE:]
        places = traceback.extract_tb(error.__traceback__)[-3:]
        key = (type(error).__name__, *(f"{place.filename}:{place.lineno}" for place in places))
        return cls(words_of(error), trace, thread, key)

    def title(self) -> str:
        """Return the words with the number of occurrences."""
        return self.words if self.count == 1 else f"{self.words}  ({self.count} times)"


class Mishaps:
    """All unexpected errors since the start; each kind is reported once."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, ...], Mishap] = {}

    def add(self, mishap: Mishap) -> tuple[Mishap, bool]:
        """Add an error; return it with the number of occurrences of its kind, and whether it is the first."""
        known = self._found.get(mishap.key)
        now = mishap if known is None else replace(mishap, count=known.count + 1)
        self._found[mishap.key] = now
        return now, known is None

    def all(self) -> tuple[Mishap, ...]:
        """Return one error of each kind, in the order of their first occurrence."""
        return tuple(self._found.values())


def safe_words(*, unsaved: bool, project: str, copy: str, jobs: Sequence[str], recording: bool) -> tuple[str, ...]:
    """Return which data are safe after an unexpected error, as sentences.

    Parameters
    ----------
    unsaved
        Whether the project has unsaved changes.
    project
        File of the project; empty if it has none.
    copy
        File of the copy that was just saved; empty if saving failed.
    jobs
        Titles of the running jobs.
    recording
        Whether one of them is a recording.
    """
    if not unsaved:
        words = [f"The project is saved in {project}." if project else "The project has no unsaved changes."]
    elif copy:
        words = [f"The project has unsaved changes; a copy of them was just saved in {copy}."]
    else:
        words = ["The project has unsaved changes, and they could not be copied: save it under a new name now."]
    if recording:
        words.append("The recording continues; every position counted as done is on the disk.")
    if jobs:
        words.append(f"Still running: {', '.join(jobs)}.")
    words.append("A file is replaced only after its new version is complete.")
    words.append("You can continue to use the window. If it behaves oddly, save the project and restart lfcal.")
    return tuple(words)
