"""``.npy`` files: safe, memory-mapped reading of files of unknown origin, and headers of new files."""

from __future__ import annotations

import io
import math
import os
import re
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError, UnsafeFileError
from lfcal.base.files import check_regular, storage_errors
from lfcal.base.units import format_bytes

__all__ = ["map_npy", "npy_header"]

KINDS = "iufcb"
"""Kinds of dtype that are numbers; others are text, records, or objects whose reading runs code."""

MAX_HEADER = 10_000
"""Largest number of characters of a header; that of an array of numbers has about a hundred."""

MAX_AXES = 32

_DESCR = r"['\"]descr['\"]:\s*['\"]([<>|=]?[A-Za-z]\d{0,9})['\"]"
_ORDER = r"['\"]fortran_order['\"]:\s*(True|False)"
_SHAPE = r"['\"]shape['\"]:\s*\(((?:\s*\d{1,19}L?\s*,)*\s*(?:\d{1,19}L?\s*)?)\)"
_HEADER = re.compile(rf"\{{\s*(?:(?:{_DESCR}|{_ORDER}|{_SHAPE})\s*(?:,\s*)?){{3}}\}}")
"""Patterns of a header, which is Python text: it is matched, because evaluating it could raise, warn and recurse."""


def map_npy(path: str | os.PathLike[str]) -> NDArray[Any]:
    """Return the array in an ``.npy`` file, memory-mapped and read-only; a new array if it has no entries.

    Raises
    ------
    StorageError
        If the file does not exist or cannot be read.
    FileFormatError
        If its header is damaged, or the file is shorter than declared.
    UnsafeFileError
        If the file contains anything but numbers.
    """
    source = Path(path)
    check_regular(source)
    with storage_errors(source), source.open("rb") as file:
        shape, fortran, dtype = _header(file, source)
        start, stored = file.tell(), source.stat().st_size
        if dtype.kind not in KINDS or dtype.subdtype is not None or dtype.names is not None:
            got = "pickled Python objects" if dtype.hasobject else f"dtype {dtype}"
            raise UnsafeFileError.expected(str(source), "plain numbers", got, "save the array itself again")
        # Python integers: a forged shape would overflow those of NumPy
        need = start + math.prod(shape) * dtype.itemsize
        if need > stored:
            raise _damaged(source, f"{format_bytes(stored)} where the header says {format_bytes(need)}")
        if not math.prod(shape):
            return np.empty(shape, dtype)
        return np.memmap(file, dtype, "r", start, shape, "F" if fortran else "C")


def npy_header(shape: tuple[int, ...], dtype: np.dtype[Any]) -> bytes:
    """Return the header of an ``.npy`` file; the bytes of a C-contiguous array must follow it.

    `numpy.save` is not used, because on a full disk it can lose the last kilobytes without an error.
    """
    head = io.BytesIO()
    fields = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(head, fields)
    return head.getvalue()


def _header(file: BinaryIO, source: Path) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, Fortran order and dtype; the file position is then at the first sample."""
    head = file.read(8)
    if head[:6] != b"\x93NUMPY" or head[6:7] not in (b"\1", b"\2", b"\3"):
        raise _damaged(source, "no NPY header")
    width = 2 if head[6:7] == b"\1" else 4
    length = int.from_bytes(file.read(width), "little")
    raw = file.read(min(length, MAX_HEADER))
    text = raw.decode("latin-1").strip()
    if len(raw) < length or not _HEADER.fullmatch(text):
        raise _other(source, text)
    shape, order, descr = (re.search(pattern, text) for pattern in (_SHAPE, _ORDER, _DESCR))
    if shape is None or order is None or descr is None:
        raise _damaged(source, "an incomplete header")
    try:
        dtype = np.dtype(descr[1])
    except TypeError:
        raise _damaged(source, f"dtype {descr[1]}") from None
    sides = tuple(int(n) for n in re.findall(r"\d+", shape[1]))
    if len(sides) > MAX_AXES:
        raise _damaged(source, f"{len(sides)} axes")
    return sides, order[1] == "True", dtype


def _other(source: Path, text: str) -> FileFormatError:
    """Return the error for a header that does not describe an array of numbers."""
    if re.match(r"\{\s*'descr':\s*\[", text):
        return UnsafeFileError.expected(str(source), "plain numbers", "records", "save the array itself again")
    return _damaged(source, f"the header {text[:60]!r}")


def _damaged(source: Path, reason: str) -> FileFormatError:
    return FileFormatError.expected(
        str(source), "an intact NPY file", f"damaged data ({reason})", "save the array itself again"
    )
