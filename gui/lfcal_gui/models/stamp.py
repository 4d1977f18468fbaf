"""Stamp of a file at the time it was read, and the camera found by a fit of such a file. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfcal.fit import Setup


Stamp = tuple[str, int, int]
"""Path, modification time and size of a file."""


def stamp_of(path: str) -> Stamp | None:
    """Return the current stamp of a file; None if there is no file."""
    try:
        found = Path(path).stat() if path else None
    except (OSError, ValueError):  # no such file, or an invalid name
        found = None
    return None if found is None else (path, found.st_mtime_ns, found.st_size)


@dataclass(frozen=True, eq=False)
class FittedCamera:
    """Camera of an H as found by a fit.

    Attributes
    ----------
    stamp
        Stamp of the file of H at the time of the fit.
    setup
        Fitted camera and effects, with the source positions of H.
    """

    stamp: Stamp
    setup: Setup
