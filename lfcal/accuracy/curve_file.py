"""Curves of accuracy as a JSON file."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path

from lfcal.accuracy.base import Curve
from lfcal.base import FileFormatError, parse_json, read_text, replace_whole

__all__ = ["read_curves", "write_curves"]

FORMAT, VERSION = "lfcal-accuracy", 1


def write_curves(curves: Iterable[Curve], path: str | os.PathLike[str]) -> None:
    """Write curves as JSON, whole or not at all.

    Raises
    ------
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> from lfcal.accuracy import Curve, Rung, read_curves, write_curves
    >>> curve = Curve("storage", "Storage of H", "error of H", "size of the file", "bytes")
    >>> write_curves([curve.with_rung(Rung("uint16", {}, 0.001, 4e6, "bytes"))], "accuracy.json")
    >>> print(read_curves("accuracy.json")[0].answer(0.01))
    1 % costs 4.0 MB: uint16 (0.1 %)
    """
    data = {"format": FORMAT, "version": VERSION, "curves": [curve.to_dict() for curve in curves]}
    with replace_whole(path) as part:
        part.write_text(json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def read_curves(path: str | os.PathLike[str]) -> tuple[Curve, ...]:
    """Return the curves in a file of `write_curves`.

    Raises
    ------
    FileFormatError
        If it is none.
    StorageError
        If it cannot be read.

    Examples
    --------
    >>> from lfcal.accuracy import Curve, read_curves, write_curves
    >>> write_curves([Curve("storage", "Storage of H", "error of H", "size of the file", "bytes")], "accuracy.json")
    >>> print([curve.title for curve in read_curves("accuracy.json")])
    ['Storage of H']
    """
    name = Path(path).name
    data = parse_json(read_text(Path(path)), name)
    known = isinstance(data, dict) and (data.get("format"), data.get("version")) == (FORMAT, VERSION)
    if not known or not isinstance(data.get("curves"), list):
        raise FileFormatError.expected(name, f"format {FORMAT} version {VERSION}", "something else", "check the file")
    return tuple(Curve.from_dict(curve) for curve in data["curves"])
