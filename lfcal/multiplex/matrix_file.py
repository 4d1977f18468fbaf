"""Read and write modulators as matrices in ``.npy`` or ``.json`` files."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base import (
    FileFormatError,
    InputError,
    any_of,
    map_npy,
    npy_header,
    plain,
    read_text,
    replace_whole,
    storage_errors,
    write_text,
)
from lfcal.multiplex.modulator import MAX_SAMPLES, Modulator, modulator_from_matrix

__all__ = ["MATRIX_SUFFIXES", "load_modulator", "save_modulator"]

MATRIX_SUFFIXES = (".npy", ".json")
MOST = 1e6
KEYS = {"name", "side", "matrix", "views", "colours", "cell", "lenslets", "light"}


def load_modulator(path: str | os.PathLike[str]) -> Modulator:
    """Read a modulator from a ``.npy`` or ``.json`` file.

    A ``.npy`` file contains the transmissions of the N samples in a super-pixel as an array ``(rows, columns, N)``, or
    ``(K, N)`` for a square super-pixel with K pixels. A ``.json`` file contains such an array as nested lists, or an
    object with the entry ``matrix`` and optionally ``side``, ``name``, ``views``, ``colours``, ``cell``, ``lenslets``
    and ``light``, as in `Modulator`.

    Raises
    ------
    FileFormatError
        If the file contains neither such an array nor such an object, or its entries do not fit together.
    StorageError
        If the file does not exist.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import load_modulator
    >>> np.save("measured.npy", [[[0.9, 0.1], [0.2, 0.8]]])  # 1 x 2 pixels that see two samples
    >>> found = load_modulator("measured.npy")
    >>> print(found.name, found.side, found.sample_names, f"condition {found.condition:.2f}")
    measured (1, 2) ('s0', 's1') condition 1.46
    """
    file = Path(path)
    try:
        found = _from_json(file) if file.suffix.lower() == ".json" else {"matrix": map_npy(file)}
        return _made(file.stem, found)
    except FileFormatError:
        raise
    except InputError as error:
        raise FileFormatError(f"{file}: {error}") from error
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        wanted = "transmissions (rows, columns, N) or (K, N)"
        raise FileFormatError.expected(
            str(file), wanted, str(error)[:160], "correct the file as described in the manual (Modulators)"
        ) from error


def save_modulator(modulator: Modulator, path: str | os.PathLike[str]) -> None:
    """Write a modulator to a file that `load_modulator` can read; a failed write leaves no partial file.

    A ``.json`` file contains the matrix and all attributes except the bases, a ``.npy`` file only the transmissions
    ``(rows, columns, N)``.

    Raises
    ------
    InputError
        If the suffix of the file name is neither ``.npy`` nor ``.json``.
    """
    file = Path(path)
    if file.suffix.lower() not in MATRIX_SUFFIXES:
        raise InputError.expected(
            "file of a modulator", any_of(MATRIX_SUFFIXES), file.name, "end the name of the file with one of these"
        )
    if file.suffix.lower() == ".json":
        kept = {key: getattr(modulator, key) for key in sorted(KEYS)}
        text = json.dumps(plain(kept), indent=None, allow_nan=False)
        write_text(file, text + "\n")
        return
    with storage_errors(file), replace_whole(file) as part, part.open("wb") as stream:
        stream.write(npy_header((*modulator.side, modulator.count), np.dtype("<f8")))
        stream.write(np.ascontiguousarray(modulator.matrix, "<f8").tobytes())


def _from_json(file: Path) -> dict[str, Any]:
    found = json.loads(read_text(file, foreign=True))
    if isinstance(found, list):
        return {"matrix": found}
    if not isinstance(found, dict) or "matrix" not in found:
        raise ValueError('neither a list of transmissions nor an object with the entry "matrix"')
    if strange := sorted(set(found) - KEYS):
        raise ValueError(f"unknown entries {', '.join(strange)}; the known ones are {', '.join(sorted(KEYS))}")
    return found


def _made(stem: str, found: dict[str, Any]) -> Modulator:
    array = np.asarray(found["matrix"])
    if array.dtype.kind not in "uif" or array.ndim not in (2, 3) or not array.size:
        raise ValueError(f"an array of {array.dtype} with shape {array.shape}")
    if array.size > MAX_SAMPLES**2 or max(array.size // array.shape[-1], array.shape[-1]) > MAX_SAMPLES:
        raise ValueError(f"an array of shape {array.shape}, with more than {MAX_SAMPLES:,} pixels or samples")
    side = tuple(found.get("side") or _side(array.shape))
    if len(side) != 2 or (array.ndim == 3 and side != array.shape[:2]):
        raise ValueError(f'the entry "side" {side} for an array of shape {array.shape}')
    lenslets = found.get("lenslets", False)
    if not isinstance(lenslets, bool):
        raise ValueError(f'the entry "lenslets" {lenslets!r}, which is neither true nor false')
    made = modulator_from_matrix(
        str(found.get("name", stem)),
        (side[0], side[1]),
        array.reshape(-1, array.shape[-1]).astype(float),
        views=_pair(found, "views"),
        colours=tuple(str(c) for c in found.get("colours", ())) or _numbered(array.shape[-1], "views" in found),
        cell=_pair(found, "cell"),
        lenslets=lenslets,
        light=found.get("light"),
    )
    passed = made.matrix @ made.light
    if np.abs(made.matrix).max() > MOST or passed.min() < -1e-6 or passed.max() > 1 + 1e-6:
        got = (
            f"pixels that record {passed.min():.3g} to {passed.max():.3g} of unmodulated light, where 0 to "
            "1 is possible"
        )
        raise ValueError(f'{got}: divide by the values of a pixel without a mask, or give the entry "light"')
    return made


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
        raise ValueError(f'{shape[0]} pixels, which do not fill a square; give "side", or an array (rows, columns, N)')
    return side, side
