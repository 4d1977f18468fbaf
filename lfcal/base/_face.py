"""The public names of `lfcal.base`, each loaded on first use."""

from __future__ import annotations

from lfcal.base.errors import FileFormatError, InputError
from lfcal.base.files import storage_errors
from lfcal.base.progress import Clock, Progress, Work, drain, drained

__all__ = [
    "Clock",
    "FileFormatError",
    "InputError",
    "Progress",
    "Work",
    "drain",
    "drained",
    "storage_errors",
]
