"""Exceptions of the library: every message is one line that says what to do."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Self

__all__ = [
    "MAX_MESSAGE",
    "Cancelled",
    "FileFormatError",
    "InputError",
    "LfcalError",
    "StorageError",
    "UnsafeFileError",
    "choose",
    "one_line",
]

MAX_MESSAGE = 480
"""Characters of a message; what files hold may be of any length, and is shown in part."""


def one_line(text: str, longest: int = MAX_MESSAGE) -> str:
    """Return ``text`` as one printable line: control characters as escapes, its middle left out where it is longer."""
    # far more than is shown need not be looked at
    if len(text) > 4 * longest:
        text = f"{text[: 2 * longest]}…{text[-longest:]}"
    line = " ".join(text.split())
    if not line.isprintable():
        line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in line)
    if len(line) <= longest:
        return line
    tail = longest // 3  # the remedy stands at the end
    return f"{line[: longest - tail - 1]}…{line[-tail:]}"


def choose(name: object, choices: Iterable[str]) -> str:
    """Return the remedy for a name that is none of ``choices``: the one that was meant, where one is like it."""
    by_lower = {choice.lower(): choice for choice in choices}
    close = get_close_matches(str(name)[:MAX_MESSAGE].lower(), by_lower, 1)
    return f"did you mean {by_lower[close[0]]}?" if close else "choose one of these"


class LfcalError(Exception):
    """Base of all errors a user is meant to read."""

    @classmethod
    def expected(cls, what: str, wanted: object, got: object, remedy: str) -> Self:
        """Return the error with the one-line message ``what: expected wanted, got …; remedy``."""
        return cls(f"{one_line(what, 240)}: expected {wanted}, got {one_line(str(got), 160)}; {remedy}")

    def __str__(self) -> str:
        """Return the message as one line of at most `MAX_MESSAGE` characters."""
        return one_line(super().__str__())


class InputError(LfcalError, ValueError):
    """What the user gave cannot be used as it is."""


class FileFormatError(InputError):
    """A file is not what its name or its header says, or is damaged."""


class UnsafeFileError(FileFormatError):
    """A file asks for something unsafe: code to run, a file outside its folder, a size that its bytes cannot hold."""


class StorageError(LfcalError, OSError):
    """The disk cannot take or give what was asked: full, read-only, missing."""


class Cancelled(LfcalError):
    """The user stopped the work; nothing half-written stays behind."""
