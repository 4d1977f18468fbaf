"""Attributes of an HDF5 object, each asked for with what it must be."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError
from lfcal.base.h5._errors import damage

__all__ = ["Attributes"]

D = TypeVar("D")


class Attributes:
    """The attributes of one object of a file; an absent one gives the default, one of another kind an error.

    Parameters
    ----------
    path
        The file.
    owner
        Open h5py object.
    name
        Its name in the file, for messages; empty for the file itself.
    """

    def __init__(self, path: Path, owner: Any, name: str = "") -> None:
        self._path, self._name = path, name
        with damage(path, name):
            self._values = owner.attrs
            # the child that looked at the file went by this list: what is not in it is not asked for
            self._keys = tuple(str(key) for key in self._values)

    @overload
    def text(self, key: str) -> str | None: ...
    @overload
    def text(self, key: str, default: str) -> str: ...
    def text(self, key: str, default: str | None = None) -> str | None:
        """Return an attribute that must be text."""
        value = self._get(key)
        if value is None:
            return default
        if isinstance(value, bytes):
            with damage(self._path, self._name):
                return value.decode()
        if not isinstance(value, str):
            raise self._wrong(key, "text", value)
        return value

    def integer(self, key: str) -> int | None:
        """Return an attribute that must be one whole number, None where it is absent."""
        value = self._get(key)
        if value is None:
            return None
        if not isinstance(value, int | np.integer):
            raise self._wrong(key, "a whole number", value)
        return int(value)

    def numbers(self, key: str, lengths: tuple[int, ...]) -> NDArray[np.float64] | None:
        """Return an attribute that must be finite numbers, as many as one of ``lengths`` (1: also a plain number)."""
        value = self._get(key)
        if value is None:
            return None
        if not isinstance(value, np.ndarray | np.number) or np.asarray(value).dtype.kind not in "iuf":
            raise self._wrong(key, "numbers", value)
        numbers = np.asarray(value, np.float64)
        if numbers.ndim > 1 or numbers.size not in lengths or not np.isfinite(numbers).all():
            wanted = " or ".join(str(n) for n in sorted(set(lengths)))
            raise self._wrong(key, f"finite numbers, {wanted} of them", value)
        return numbers.ravel()

    def plain(self) -> dict[str, Any]:
        """Return all attributes that are text or numbers."""
        with damage(self._path, self._name):
            found = {key: self._values[key] for key in self._keys}
        return {key: value for key, value in found.items() if isinstance(value, str | np.ndarray | np.generic)}

    def _get(self, key: str) -> Any:
        with damage(self._path, self._name):
            return self._values[key] if key in self._keys else None

    def _wrong(self, key: str, wanted: str, value: Any) -> FileFormatError:
        place = f"{self._path}:/{self._name}" if self._name else str(self._path)
        shown = " ".join(repr(value).split())
        return FileFormatError.expected(
            f"{place}, attribute {key}",
            wanted,
            shown if len(shown) <= 60 else f"{shown[:60]}…",
            "take the file from its source again",
        )
