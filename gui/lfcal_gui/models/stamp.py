"""Stamp of a file when it was read, to detect results of an older version. No Qt."""

from __future__ import annotations

from pathlib import Path

Stamp = tuple[str, int, int]
"""Path, time, size."""


def stamp_of(path: str) -> Stamp | None:
    """Return a file as it is now, None where there is none."""
    try:
        found = Path(path).stat() if path else None
    except (OSError, ValueError):  # no such file, or an invalid name
        found = None
    return None if found is None else (path, found.st_mtime_ns, found.st_size)
