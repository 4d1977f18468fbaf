"""The positions of a session whose content was suspicious, as a list to record again."""

from __future__ import annotations

from pathlib import Path

from lfcal.acquire.recording import open_session
from lfcal.acquire.redo import RedoList

__all__ = ["read_suspects"]


def read_suspects(folder: Path) -> RedoList:
    """Return what the newest frames of a session are suspected of; empty where all is well.

    Raises
    ------
    StorageError, FileFormatError
        If there is no session, or it is damaged.
    InputError
        If nothing was recorded.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.acquire import read_suspects
    >>> print(len(read_suspects(Path("recorded")).positions), "frames look unlike their neighbours")
    0 frames look unlike their neighbours
    """
    with open_session(folder) as source:
        found = source.suspects()
    return RedoList.of([position for position, _ in found], [what.words for _, what in found])
