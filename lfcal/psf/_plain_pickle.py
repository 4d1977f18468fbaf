"""Read numbers, arrays and tables from a Python pickle without running any code in it.

A pickle is a program that may call any function on this computer. Here it may name only a few objects. Each is
replaced by a placeholder that stores its arguments; not even numpy functions are called.
"""

from __future__ import annotations

import io
import pickle
import pickletools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, UnsafeFileError

__all__ = ["Record", "load_plain"]

MAX_ITEMS = 1 << 31
"""Largest number of samples in an array; a pickle with more is refused."""


class Record:
    """Placeholder for an object of an allowed class; ``values`` are its attributes."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        """Keep the attributes."""
        if isinstance(state, dict):
            self.values = state


class _Type:
    """A numpy dtype of plain numbers: their kind, size and byte order."""

    def __init__(self, code: Any = "", *_: Any) -> None:
        self._code, self._order = code, ""

    def __setstate__(self, state: Any) -> None:
        """Keep the byte order."""
        order = state[1] if isinstance(state, tuple) and len(state) > 1 else ""
        self._order = order if order in ("<", ">") else ""

    def dtype(self) -> np.dtype[Any]:
        """Return the type; only real numbers and booleans are allowed."""
        known = {f"{kind}{size}" for kind in "iuf" for size in (1, 2, 4, 8)} - {"f1"} | {"b1"}
        if not isinstance(self._code, str) or self._code not in known:
            raise _Refused(f"values of type {self._code!r}")
        return np.dtype(f"{self._order}{self._code}")


class _Array:
    """A numpy array, from its shape and bytes."""

    def __init__(self, *_: Any) -> None:
        self._state: tuple[Any, ...] = ()

    def __setstate__(self, state: Any) -> None:
        """Keep shape, type and bytes."""
        self._state = state if isinstance(state, tuple) else ()

    def array(self) -> NDArray[Any]:
        """Return the array."""
        if len(self._state) != 5 or not isinstance(self._state[2], _Type):
            raise _Refused("an array without numbers")
        _, shape, kind, fortran, data = self._state
        data = data.encode("latin1") if isinstance(data, str) else data
        if not isinstance(data, bytes) or not isinstance(shape, tuple) or not all(isinstance(n, int) for n in shape):
            raise _Refused("an array of objects")
        if len(data) != int(np.prod(shape, dtype=object)) * kind.dtype().itemsize or len(data) > MAX_ITEMS:
            raise _Refused("an array that is shorter than stated")
        return np.frombuffer(data, kind.dtype()).reshape(shape, order="F" if fortran else "C")


def _scalar(kind: Any, data: Any = b"") -> Any:
    data = data.encode("latin1") if isinstance(data, str) else data
    if not isinstance(kind, _Type) or not isinstance(data, bytes) or len(data) != kind.dtype().itemsize:
        raise _Refused("a number without a value")
    return np.frombuffer(data, kind.dtype())[0].item()


def _text(value: Any, *_: Any) -> Any:
    # protocol 2 writes bytes as text, and asks for its encoding
    return value


class _Refused(Exception):
    """Error raised if a pickle requests something other than numbers."""


def _buffered(data: Any = b"", kind: Any = None, shape: Any = (), order: Any = "C") -> _Array:
    # protocol 5 hands over bytes without numpy's own state
    array = _Array()
    array.__setstate__((1, shape, kind, order == "F", bytes(data) if isinstance(data, bytes | bytearray) else None))
    return array


_NUMPY: dict[str, Callable[..., Any]] = {
    "dtype": _Type,
    "_reconstruct": _Array,
    "_frombuffer": _buffered,
    "scalar": _scalar,
}


class _Reader(pickle.Unpickler):
    def __init__(self, data: bytes, classes: frozenset[str]) -> None:
        super().__init__(io.BytesIO(data), encoding="latin1")
        self._classes = classes

    def find_class(self, module: str, name: str) -> Any:
        """Return the placeholder for an object that a pickle names."""
        # create a new one each time, because a pickle may set attributes of objects it receives
        if module.split(".")[0] == "numpy" and name == "ndarray":
            return type("Array", (), {})
        if name in self._classes:
            return type("Record", (Record,), {})
        stand_in = _NUMPY.get(name) if module.split(".")[0] == "numpy" else None
        if (module, name) == ("_codecs", "encode"):
            stand_in = _text
        if stand_in is None:
            raise _Refused(f"the object {module}.{name}")
        return lambda *arguments: stand_in(*arguments)

    def persistent_load(self, pid: Any) -> Any:
        """Refuse objects that are stored outside of the pickle."""
        raise _Refused("references to data in other files")


def load_plain(data: bytes, classes: frozenset[str], where: str) -> Any:
    """Return the contents of a pickle: plain Python values, arrays, and a `Record` for an object of one of ``classes``.

    Raises
    ------
    UnsafeFileError
        If the pickle names any other object.
    FileFormatError
        If the pickle is damaged.
    """
    try:
        _check_memo(data)
        return _resolved(_Reader(data, classes).load(), 0, {})
    except _Refused as error:
        raise UnsafeFileError.expected(
            where, "numbers and arrays", f"a pickle that contains {error}", "get the file from its source again"
        ) from error
    except Exception as error:  # a damaged pickle may raise any error
        raise FileFormatError.expected(
            where, "an intact pickle", f"a damaged one ({type(error).__name__})", "get the file from its source again"
        ) from error


def _check_memo(data: bytes) -> None:
    """Refuse a pickle that numbers its parts beyond its own length: the reader would make room for all of them."""
    for code, argument, _ in pickletools.genops(data):
        if code.name in ("PUT", "BINPUT", "LONG_BINPUT") and argument is not None and argument > len(data):
            raise _Refused(f"part number {argument}, but is too short for so many parts")


def _resolved(value: Any, depth: int, known: dict[int, Any]) -> Any:
    """Return a value with arrays in place of their placeholders; shared parts are converted only once."""
    if isinstance(value, int | float | str | bytes | None):
        return value
    if depth > 8:
        raise _Refused("tables that are nested too deeply")
    if id(value) not in known:
        known[id(value)] = _made(value, depth + 1, known)
    return known[id(value)]


def _made(value: Any, depth: int, known: dict[int, Any]) -> Any:
    if isinstance(value, _Array):
        return value.array()
    if isinstance(value, Record):
        value.values = {str(key): _resolved(one, depth, known) for key, one in value.values.items()}
        return value
    if isinstance(value, dict):
        return {_resolved(key, depth, known): _resolved(one, depth, known) for key, one in value.items()}
    if isinstance(value, list):
        return [_resolved(one, depth, known) for one in value]
    if isinstance(value, tuple):
        return tuple(_resolved(one, depth, known) for one in value)
    return None
