"""Modulators of one's own from files: matrices as ``.npy`` or ``.json``."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.errors import FileFormatError, InputError
from lfcal.multiplex.modulator import MAX_SAMPLES, Modulator, modulator_from_matrix

__all__ = ["MATRIX_SUFFIXES", "load_modulator"]

MATRIX_SUFFIXES = (".npy", ".json")
LARGEST_FILE = 8 * MAX_SAMPLES * MAX_SAMPLES + 4096
KEYS = {"name", "side", "matrix", "views", "colours", "cell", "lenslets", "light"}


def load_modulator(path: str | os.PathLike[str]) -> Modulator:
    """Return the modulator of a file.

    ``.npy``: transmissions ``(rows, columns, N)`` of a super-pixel, or ``(K, N)`` of a square one. ``.json``: an object
    with ``matrix`` (the same, as nested lists) and, where wanted, ``side``, ``name``, ``views``, ``colours``, ``cell``,
    ``lenslets``, ``light`` as in `lfcal.multiplex.Modulator`.

    Raises
    ------
    FileFormatError
        If it holds no such matrix.
    """
    file = Path(path)
    try:
        if file.stat().st_size > LARGEST_FILE:
            raise ValueError(f"{file.stat().st_size} bytes")
        found = _from_json(file) if file.suffix.lower() == ".json" else {"matrix": np.load(file, allow_pickle=False)}
        return _made(file.stem, found)
    except (OSError, ValueError, TypeError, RecursionError, EOFError, InputError) as error:
        wanted = "transmissions (rows, columns, N) or (K, N)"
        raise FileFormatError.expected(str(file), wanted, str(error)[:160], "see docs/multiplexing.md") from error


def _from_json(file: Path) -> dict[str, Any]:
    found = json.loads(file.read_text(encoding="utf-8"))
    if not isinstance(found, dict) or "matrix" not in found:
        raise ValueError('an object without "matrix"')
    if strange := sorted(set(found) - KEYS):
        raise ValueError(f"unknown {', '.join(strange)}; known are {', '.join(sorted(KEYS))}")
    return found


def _made(stem: str, found: dict[str, Any]) -> Modulator:
    array = np.asarray(found["matrix"])
    if array.dtype.kind not in "uif" or array.ndim not in (2, 3) or not array.size:
        raise ValueError(f"{array.dtype} {array.shape}")
    side = tuple(found.get("side") or _side(array.shape))
    if len(side) != 2 or (array.ndim == 3 and side != array.shape[:2]):
        raise ValueError(f"side {side} for {array.shape}")
    return modulator_from_matrix(
        str(found.get("name", stem)),
        (side[0], side[1]),
        array.reshape(-1, array.shape[-1]).astype(float),
        views=_pair(found, "views"),
        colours=tuple(str(c) for c in found.get("colours", ())) or _numbered(array.shape[-1], "views" in found),
        cell=_pair(found, "cell"),
        lenslets=bool(found.get("lenslets", False)),
        light=found.get("light"),
    )


def _pair(found: dict[str, Any], key: str) -> tuple[int, int]:
    one, two = found.get(key, (1, 1))
    return one, two


def _numbered(count: int, views: bool) -> tuple[str, ...]:
    return () if views or count == 1 else tuple(f"s{k}" for k in range(count))


def _side(shape: tuple[int, ...]) -> tuple[int, int]:
    if len(shape) == 3:
        return shape[0], shape[1]
    side = math.isqrt(shape[0])
    if side * side != shape[0]:
        raise ValueError(f"{shape[0]} pixels are no square: give side, or an array (rows, columns, N)")
    return side, side
