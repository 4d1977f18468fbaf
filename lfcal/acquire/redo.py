"""Lists of positions to record, or to record again (from the quality report or a session)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lfcal.acquire.recording import open_session
from lfcal.base import FileFormatError, parse_json, read_text, stated_format, write_text
from lfcal.frames import Position

__all__ = ["RedoList", "read_suspects"]

FORMAT = "lfcal-redo"
VERSION = 1
LARGEST = 1 << 28


@dataclass(frozen=True, slots=True)
class RedoList:
    """List of positions to record.

    ``positions`` are (z, y, x), and ``reasons`` contains a text for each of them. ``kept_aside`` contains the positions
    among them whose patterns are held out from a fit to measure its quality.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.acquire import RedoList
    >>> RedoList.of([(0, 2, 5)], ["stage off by 3 px"]).write(Path("redo.json"))  # for lfcal acquire --redo
    >>> found = RedoList.read(Path("redo.json"))
    >>> print(tuple(found.positions[0]), found.reasons)
    (0, 2, 5) ('stage off by 3 px',)
    """

    positions: tuple[Position, ...]
    reasons: tuple[str, ...]
    kept_aside: tuple[Position, ...] = ()

    @classmethod
    def of(
        cls,
        positions: Sequence[tuple[int, int, int]],
        reasons: Sequence[str] = (),
        *,
        kept_aside: Sequence[tuple[int, int, int]] = (),
    ) -> RedoList:
        """Return the list of ``positions`` and ``kept_aside`` (z, y, x).

        If there are fewer ``reasons`` than positions, the reasons of the last positions are empty.
        """
        given = tuple(reasons) + ("",) * (len(positions) - len(reasons))
        return cls(tuple(Position(*p) for p in positions), given, tuple(Position(*p) for p in kept_aside))

    def to_json(self) -> str:
        """Return the list as JSON text."""
        data = {
            "format": FORMAT,
            "version": VERSION,
            "positions": [list(p) for p in self.positions],
            "reasons": list(self.reasons),
        }
        if self.kept_aside:
            data["kept_aside"] = [list(p) for p in self.kept_aside]
        return json.dumps(data)

    def write(self, path: Path) -> None:
        """Write the list to the file ``path`` as JSON; a failed write leaves no partial file."""
        write_text(path, self.to_json())

    @classmethod
    def read(cls, path: Path) -> RedoList:
        """Read the list from the file ``path``; raise `FileFormatError` if the file does not contain such a list."""
        data: Any = parse_json(read_text(path, limit=LARGEST), str(path))
        if not isinstance(data, dict) or data.get("format") != FORMAT or data.get("version") != VERSION:
            raise FileFormatError.expected(
                str(path),
                f'"format": "{FORMAT}", version {VERSION}',
                stated_format(data),
                "choose a list written by lfcal inspect",
            )
        positions: Any = data.get("positions")
        reasons: Any = data.get("reasons", [])
        aside: Any = data.get("kept_aside", [])
        if (
            not _are_positions(positions)
            or not _are_positions(aside)
            or not all(p in positions for p in aside)
            or not isinstance(reasons, list)
            or len(reasons) > len(positions)
        ):
            raise FileFormatError.expected(
                f"{path}: positions",
                "a list of [z, y, x]",
                "other values",
                "write it with lfcal inspect",
            )
        apart = [tuple(p) for p in aside]
        return cls.of([tuple(p) for p in positions], [str(r) for r in reasons], kept_aside=apart)


def _are_positions(value: Any) -> bool:
    # bool is a subclass of int, so test type() instead of isinstance()
    return isinstance(value, list) and all(
        isinstance(p, list) and len(p) == 3 and all(type(v) is int for v in p) for p in value
    )


def read_suspects(folder: Path) -> RedoList:
    """Return the positions of a session whose newest frames are suspect, with the suspected faults as reasons.

    Raises
    ------
    StorageError, FileFormatError
        If there is no session in the folder, or it is damaged.
    InputError
        If no frame was recorded.

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
