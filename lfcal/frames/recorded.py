"""Times at which frames were recorded, from the files of a folder."""

from __future__ import annotations

from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from lfcal.frames.sources import FolderSource

__all__ = ["recorded_times"]

STAMP = 306
"""Tag of a TIFF page with its date and time."""


def recorded_times(source: FolderSource) -> list[datetime | None]:
    """Return the time of each frame, as stated in the TIFF pages or else from the file system; None if unknown.

    If any page states no time, the modification times of the files are used for all frames, because the two clocks may
    differ. If a file contains several frames, the times of all frames are then unknown.
    """
    entries = source.manifest.entries
    paths = [source.root / entry.file for entry in entries]
    stamps: dict[Path, list[datetime | None]] = {path: _stamps(path) for path in dict.fromkeys(paths)}
    stated = [_at(stamps[path], entry.page) for path, entry in zip(paths, entries, strict=True)]
    if all(one is not None for one in stated):
        return stated
    single = len(set(paths)) == len(paths)
    return [datetime.fromtimestamp(path.stat().st_mtime, UTC) if single else None for path in paths]


def _stamps(path: Path) -> list[datetime | None]:
    """Return the times that the pages of a TIFF file state; empty for other files."""
    import tifffile

    if path.suffix.lower() not in (".tif", ".tiff"):
        return []
    # a file that is damaged there is refused when its frame is read
    with suppress(tifffile.TiffFileError, OSError, ValueError), tifffile.TiffFile(path) as file:
        return [_parsed(page.tags.get(STAMP)) for page in file.pages if isinstance(page, tifffile.TiffPage)]
    return []


def _parsed(tag: Any) -> datetime | None:
    with suppress(ValueError):
        return None if tag is None else datetime.strptime(str(tag.value), "%Y:%m:%d %H:%M:%S").astimezone()
    return None


def _at(stamps: list[datetime | None], page: int) -> datetime | None:
    return stamps[page] if page < len(stamps) else None
