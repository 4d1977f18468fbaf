"""Stamp of a file when it was read, and the camera that a fit of such a file found. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfcal.fit import Setup


Stamp = tuple[str, int, int]
"""Path, time, size."""


def stamp_of(path: str) -> Stamp | None:
    """Return a file as it is now, None where there is none."""
    try:
        found = Path(path).stat() if path else None
    except (OSError, ValueError):  # no such file, or an invalid name
        found = None
    return None if found is None else (path, found.st_mtime_ns, found.st_size)


@dataclass(frozen=True, eq=False)
class FittedCamera:
    """What a fit found of the camera behind an H.

    Attributes
    ----------
    stamp
        The file of H, as it was when it was fitted.
    setup
        Camera and effects as found, sources where H has them.
    """

    stamp: Stamp
    setup: Setup
