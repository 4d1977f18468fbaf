"""Exceptions of the library; every message is one line that states the remedy."""

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
    "any_of",
    "choose",
    "one_line",
]

MAX_MESSAGE = 480
"""Largest number of characters in a message; longer values from files are shown in part."""


def one_line(text: str, longest: int = MAX_MESSAGE) -> str:
    """Return ``text`` as one printable line of at most ``longest`` characters.

    Control characters are escaped. The middle of a longer text is replaced by an ellipsis.
    """
    # avoid processing far more than is shown
    if len(text) > 4 * longest:
        text = f"{text[: 2 * longest]}…{text[-longest:]}"
    line = " ".join(text.split())
    if not line.isprintable():
        line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in line)
    if len(line) <= longest:
        return line
    tail = longest // 3  # the remedy is at the end
    return f"{line[: longest - tail - 1]}…{line[-tail:]}"


def any_of(choices: Iterable[str]) -> str:
    """Return the choices as a list in words: ``"direct, sparse or auto"``."""
    *first, last = list(choices) or [""]
    return f"{', '.join(first)} or {last}" if first else last


def choose(name: object, choices: Iterable[str]) -> str:
    """Return the remedy for a name that is not among ``choices``; it names the most similar choice, if there is one."""
    by_lower = {choice.lower(): choice for choice in choices}
    close = get_close_matches(str(name)[:MAX_MESSAGE].lower(), by_lower, 1)
    return f"did you mean {by_lower[close[0]]}?" if close else "choose one of these"


class LfcalError(Exception):
    """Base class of all errors whose messages are meant for users."""

    @classmethod
    def expected(cls, what: str, wanted: object, got: object, remedy: str) -> Self:
        """Return the error with the one-line message ``{what}: expected {wanted}, got {got}; {remedy}``."""
        return cls(f"{one_line(what, 240)}: expected {wanted}, got {one_line(str(got), 160)}; {remedy}")

    def __str__(self) -> str:
        """Return the message as one line of at most `MAX_MESSAGE` characters."""
        return one_line(super().__str__())


class InputError(LfcalError, ValueError):
    """A value from the user cannot be used."""


class FileFormatError(InputError):
    """The content of a file does not match its name or header, or the file is damaged."""


class UnsafeFileError(FileFormatError):
    """A file requests something unsafe: code to run, a file outside its folder, or more data than it contains."""


class StorageError(LfcalError, OSError):
    """A file cannot be read or written, for example because the disk is full or the file is missing."""


class Cancelled(LfcalError):
    """The user stopped the work; no incomplete file remains."""
