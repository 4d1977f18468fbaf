"""The list of positions to record again, as the quality report writes it and a session takes it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lfcal.errors import FileFormatError
from lfcal.files import read_text, replace_whole
from lfcal.frames.source import Position
from lfcal.plain import parse_json

__all__ = ["RedoList"]

FORMAT = "lfcal-redo"
VERSION = 1
LARGEST = 1 << 28


@dataclass(frozen=True, slots=True)
class RedoList:
    """Positions (z, y, x) to record again, with a reason each."""

    positions: tuple[Position, ...]
    reasons: tuple[str, ...]

    @classmethod
    def of(cls, positions: Sequence[tuple[int, int, int]], reasons: Sequence[str] = ()) -> RedoList:
        """Return the list of ``positions``; missing reasons are empty."""
        given = tuple(reasons) + ("",) * (len(positions) - len(reasons))
        return cls(tuple(Position(*p) for p in positions), given)

    def write(self, path: Path) -> None:
        """Write the list as JSON, whole or not at all."""
        data = {
            "format": FORMAT,
            "version": VERSION,
            "positions": [list(p) for p in self.positions],
            "reasons": list(self.reasons),
        }
        with replace_whole(path) as part:
            part.write_text(json.dumps(data), encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> RedoList:
        """Return the list in ``path``; raises `FileFormatError` if it is not one."""
        data: Any = parse_json(read_text(path, limit=LARGEST), str(path))
        if not isinstance(data, dict) or data.get("format") != FORMAT or data.get("version") != VERSION:
            raise FileFormatError.expected(
                str(path), f'"format": "{FORMAT}", version {VERSION}', "something else", "check the file"
            )
        positions: Any = data.get("positions")
        reasons: Any = data.get("reasons", [])
        if (
            not isinstance(positions, list)
            or not isinstance(reasons, list)
            or len(reasons) > len(positions)
            # bool is a kind of int: type() and not isinstance() keeps true and false out
            or not all(isinstance(p, list) and len(p) == 3 and all(type(v) is int for v in p) for p in positions)
        ):
            raise FileFormatError.expected(
                f"{path}: positions", "a list of [z, y, x]", "something else", "write it with lfcal inspect"
            )
        return cls.of([tuple(p) for p in positions], [str(r) for r in reasons])
