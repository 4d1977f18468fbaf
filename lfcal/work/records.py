"""What a unit found, beside planes and volumes: records of numbers and arrays, in a file that runs nothing when read.

The file is a pickle that may name dataclasses, enumerations and named tuples of lfcal, and numpy's arrays: reading it
makes these, and calls no function of theirs.
"""

from __future__ import annotations

import dataclasses
import io
import pickle
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

from lfcal.errors import FileFormatError, UnsafeFileError
from lfcal.files import replace_whole, storage_errors

__all__ = ["load_record", "save_record"]

NUMPY = frozenset({"_reconstruct", "_frombuffer", "scalar", "ndarray", "dtype"})
"""What numpy's arrays and numbers are made by."""


def save_record(path: Path, value: Any, shared: Mapping[str, object] | None = None) -> None:
    """Write a record, whole or not at all; objects ``shared`` by name with its reader are not in the file.

    Raises
    ------
    StorageError
        If it cannot be written.
    """
    data = io.BytesIO()
    names = {id(one): name for name, one in (shared or {}).items()}
    _Writer(data, names).dump(value)
    with replace_whole(path) as part:
        part.write_bytes(data.getvalue())


def load_record(path: Path, shared: Mapping[str, object] | None = None) -> Any:
    """Return the record of a file, with the reader's own ``shared`` objects in their places.

    Raises
    ------
    UnsafeFileError
        If it names anything else than records and arrays.
    FileFormatError
        If it is damaged.
    StorageError
        If it cannot be read.
    """
    with storage_errors(path):
        data = path.read_bytes()
    try:
        return _Reader(data, shared or {}).load()
    except _Refused as error:
        raise UnsafeFileError.expected(
            str(path), "records of lfcal", f"a pickle that asks for {error}", "remove it and begin again"
        ) from error
    except Exception as error:  # a damaged pickle raises whatever the step does that it broke
        raise FileFormatError.expected(
            str(path), "an intact record", type(error).__name__, "remove it and begin again"
        ) from error


class _Refused(Exception):
    """A file asks for something else."""


class _Writer(pickle.Pickler):
    def __init__(self, data: io.BytesIO, names: Mapping[int, str]) -> None:
        super().__init__(data, pickle.HIGHEST_PROTOCOL)
        self._names = names

    def persistent_id(self, obj: Any) -> str | None:
        """Return the name of an object that the reader has, too."""
        return self._names.get(id(obj))


class _Reader(pickle.Unpickler):
    def __init__(self, data: bytes, shared: Mapping[str, object]) -> None:
        super().__init__(io.BytesIO(data))
        self._shared = shared

    def persistent_load(self, pid: Any) -> Any:
        """Return the reader's own object of that name."""
        if pid not in self._shared:
            raise _Refused(f"the object {pid!r}")
        return self._shared[pid]

    def find_class(self, module: str, name: str) -> Any:
        """Return a kind of record, or what makes an array."""
        root = module.partition(".")[0]
        if root == "numpy" and name in NUMPY:
            return super().find_class(module, name)
        found = super().find_class(module, name) if root == "lfcal" and "." not in name else None
        # a dataclass is restored by its values: its own checks are not run
        if isinstance(found, type) and (dataclasses.is_dataclass(found) or issubclass(found, tuple | Enum)):
            return found
        raise _Refused(f"{module}.{name}")
