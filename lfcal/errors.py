"""Exceptions of the library: every message is one line that says what to do."""

from __future__ import annotations

from typing import Self

__all__ = [
    "Cancelled",
    "FileFormatError",
    "InputError",
    "LfcalError",
    "StorageError",
    "UnsafeFileError",
]


class LfcalError(Exception):
    """Base of all errors a user is meant to read."""

    @classmethod
    def expected(cls, what: str, wanted: object, got: object, remedy: str) -> Self:
        """Return the error with the one-line message ``what: expected wanted, got …; remedy``."""
        return cls(f"{what}: expected {wanted}, got {got}; {remedy}")


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
