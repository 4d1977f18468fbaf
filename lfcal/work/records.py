"""Results of units other than planes and volumes: records of numbers and arrays, in files that are safe to read.

The file is a pickle that may contain only dataclasses, enumerations and named tuples of lfcal, and numpy arrays.
Reading it calls no functions except those that construct arrays and members of enumerations.
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
"""Functions that construct numpy arrays and numbers."""


def save_record(path: Path, value: Any, shared: Mapping[str, object] | None = None) -> None:
    """Write the record ``value`` atomically.

    Objects in ``shared``, by name, are stored as their names; the reader must have them too.

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    data = io.BytesIO()
    names = {id(one): name for name, one in (shared or {}).items()}
    _Writer(data, names).dump(value)
    with replace_whole(path) as part:
        part.write_bytes(data.getvalue())


def load_record(path: Path, shared: Mapping[str, object] | None = None) -> Any:
    """Return the record in a file, in which stored names become the objects in ``shared``.

    Raises
    ------
    UnsafeFileError
        If the file contains anything but records and arrays.
    FileFormatError
        If the file is damaged.
    StorageError
        If the file cannot be read.
    """
    with storage_errors(path):
        data = path.read_bytes()
    try:
        return _Reader(data, shared or {}).load()
    except _Refused as error:
        raise UnsafeFileError.expected(
            str(path), "records of lfcal", f"a pickle that requests {error}", "remove it and start again"
        ) from error
    except Exception as error:  # a damaged pickle can raise any error
        raise FileFormatError.expected(
            str(path), "an intact record", type(error).__name__, "remove it and start again"
        ) from error


class _Refused(Exception):
    """Raised when a file requests anything that is not allowed."""


class _Writer(pickle.Pickler):
    def __init__(self, data: io.BytesIO, names: Mapping[int, str]) -> None:
        super().__init__(data, pickle.HIGHEST_PROTOCOL)
        self._names = names

    def persistent_id(self, obj: Any) -> str | None:
        """Return the name of an object that the reader has as well."""
        return self._names.get(id(obj))


class _Reader(pickle._Unpickler):  # the Python implementation, whose operations can be restricted
    """Unpickles records; calls only the constructors of numpy arrays and of enumerations.

    A dataclass or named tuple is filled with its values: its constructor and checks are not run. Classes are never
    modified, although a pickle can request that.
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
        """Return a record class, or a function that constructs arrays."""
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
        """Make an empty dataclass, or a named tuple with its values."""
        arguments, kind = self.stack.pop(), self.stack.pop()
        if not isinstance(kind, type) or issubclass(kind, Enum):
            raise _Refused("an object without a class")
        made = tuple.__new__(kind, arguments) if issubclass(kind, tuple) else object.__new__(kind)
        self.append(made)

    def load_build(self) -> None:
        """Set the values of a dataclass, or the content of an array."""
        state, made = self.stack.pop(), self.stack[-1]
        if isinstance(made, np.ndarray | np.dtype):
            made.__setstate__(state)  # type: ignore[union-attr]
            return
        if isinstance(made, type) or not dataclasses.is_dataclass(made):
            raise _Refused(f"values for {(made if isinstance(made, type) else type(made)).__name__}")
        names = [field.name for field in dataclasses.fields(made)]
        # with slots, the state is a list of values in order; without fields, a pair with one empty part
        values = dict(zip(names, state, strict=True)) if isinstance(state, list) else _named(state)
        if not values.keys() <= set(names):
            raise _Refused(f"values for fields that {type(made).__name__} does not have")
        for name, value in values.items():
            object.__setattr__(made, name, value)

    def refuse(self) -> None:
        """Refuse the operations by which older pickles construct objects."""
        raise _Refused("an object built by an operation that lfcal never uses")

    dispatch[pickle.REDUCE[0]] = load_reduce
    dispatch[pickle.NEWOBJ[0]] = load_newobj
    dispatch[pickle.BUILD[0]] = load_build
    for _code in (pickle.INST, pickle.OBJ, pickle.NEWOBJ_EX, pickle.EXT1, pickle.EXT2, pickle.EXT4):
        dispatch[_code[0]] = refuse


def _named(state: Any) -> dict[str, Any]:
    parts = [part for part in (state if isinstance(state, tuple) else (state,)) if part]
    if len(parts) > 1 or not all(isinstance(part, dict) for part in parts):
        raise _Refused("an object whose values have no names")
    return parts[0] if parts else {}
