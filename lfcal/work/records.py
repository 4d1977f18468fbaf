"""What a unit found, beside planes and volumes: records of numbers and arrays, in a file that runs nothing when read.

The file is a pickle that may name dataclasses, enumerations and named tuples of lfcal, and numpy's arrays: reading it
makes these, and calls no function of theirs.
"""

from __future__ import annotations

import dataclasses
import io
import pickle
from collections.abc import Callable, Mapping
from enum import Enum
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lfcal.base import FileFormatError, UnsafeFileError, replace_whole, storage_errors

__all__ = ["load_record", "save_record"]

NUMPY_MODULES = frozenset(
    {"numpy", "numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric", "numpy._core.numeric"}
)

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


class _Reader(pickle._Unpickler):  # the one in Python, whose steps can be restricted
    """Reads values into records; calls numpy's makers of arrays and enumerations, and nothing else.

    A dataclass or named tuple is made of its values alone: its constructor and its checks are not run. A class is never
    changed, for a pickle may ask for that, too.
    """

    stack: list[Any]
    append: Callable[[Any], None]
    dispatch: ClassVar[dict[int, Any]] = dict(pickle._Unpickler.dispatch)

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
        if module in NUMPY_MODULES and name in NUMPY:
            return super().find_class(module, name)
        found = super().find_class(module, name) if module.split(".")[0] == "lfcal" and "." not in name else None
        if isinstance(found, type) and (dataclasses.is_dataclass(found) or issubclass(found, tuple | Enum)):
            return found
        raise _Refused(f"{module}.{name}")

    def load_reduce(self) -> None:
        """Make an array or a member of an enumeration."""
        arguments, maker = self.stack.pop(), self.stack[-1]
        if isinstance(maker, type) and not issubclass(maker, Enum | np.ndarray | np.dtype):
            raise _Refused(f"a call of {maker.__name__}")
        self.stack[-1] = maker(*arguments)

    def load_newobj(self) -> None:
        """Make an empty dataclass, or a named tuple of its values."""
        arguments, kind = self.stack.pop(), self.stack.pop()
        if not isinstance(kind, type) or issubclass(kind, Enum):
            raise _Refused("an object of no class")
        made = tuple.__new__(kind, arguments) if issubclass(kind, tuple) else object.__new__(kind)
        self.append(made)

    def load_build(self) -> None:
        """Give a dataclass its values, and an array its content."""
        state, made = self.stack.pop(), self.stack[-1]
        if isinstance(made, np.ndarray | np.dtype):
            made.__setstate__(state)  # type: ignore[union-attr]
            return
        if isinstance(made, type) or not dataclasses.is_dataclass(made):
            raise _Refused(f"values for {(made if isinstance(made, type) else type(made)).__name__}")
        names = [field.name for field in dataclasses.fields(made)]
        # with slots it is the values in their order; without fields in slots a pair, of which one part is empty
        values = dict(zip(names, state, strict=True)) if isinstance(state, list) else _named(state)
        if not values.keys() <= set(names):
            raise _Refused(f"other values of {type(made).__name__} than it has")
        for name, value in values.items():
            object.__setattr__(made, name, value)

    def refuse(self) -> None:
        """Refuse the steps that older pickles take to make objects."""
        raise _Refused("an object made in another way")

    dispatch[pickle.REDUCE[0]] = load_reduce
    dispatch[pickle.NEWOBJ[0]] = load_newobj
    dispatch[pickle.BUILD[0]] = load_build
    for _code in (pickle.INST, pickle.OBJ, pickle.NEWOBJ_EX, pickle.EXT1, pickle.EXT2, pickle.EXT4):
        dispatch[_code[0]] = refuse


def _named(state: Any) -> dict[str, Any]:
    parts = [part for part in (state if isinstance(state, tuple) else (state,)) if part]
    if len(parts) > 1 or not all(isinstance(part, dict) for part in parts):
        raise _Refused("values without names")
    return parts[0] if parts else {}
