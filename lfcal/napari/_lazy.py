"""Arrays for napari that load only the parts that are displayed."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["Index", "Lazy"]

Index = tuple[int | slice, ...]
"""An integer or a slice for every axis."""


class Lazy:
    """An array that stays in its file, with shape, type and slicing.

    Parameters
    ----------
    shape, dtype
        Shape and type of the array.
    read
        Function that returns the values at an index with an integer or a slice for every axis, as in numpy.
    holder
        Object that must be kept alive, so that its file stays open.
    """

    def __init__(
        self, shape: tuple[int, ...], dtype: DTypeLike, read: Callable[[Index], NDArray[Any]], holder: object = None
    ) -> None:
        self.shape = tuple(map(int, shape))
        self.dtype = np.dtype(dtype)
        self._read, self._holder = read, holder

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """Number of entries."""
        return int(np.prod(self.shape, dtype=object))

    def __len__(self) -> int:
        """Return the length of the first axis."""
        return self.shape[0]

    def __getitem__(self, key: Any) -> NDArray[Any]:
        """Return the part at ``key``: integers, slices and an ellipsis."""
        parts = list(key) if isinstance(key, tuple) else [key]
        holes = [k for k, part in enumerate(parts) if part is Ellipsis]
        if len(holes) > 1:
            raise IndexError("an index can have only one ellipsis ('...')")
        if len(parts) - len(holes) > self.ndim:
            raise IndexError(f"too many indices: {len(parts) - len(holes)} for {self.ndim} axes")
        at = holes[0] if holes else len(parts)
        fill = [slice(None)] * (self.ndim - len(parts) + len(holes))
        full = [*parts[:at], *fill, *parts[at + len(holes) :]]
        index: list[int | slice] = []
        for axis, (part, n) in enumerate(zip(full, self.shape, strict=True)):
            if isinstance(part, slice):
                index.append(part)
                continue
            k = operator.index(part)
            if not -n <= k < n:
                raise IndexError(f"index {k} is out of range for axis {axis} with {n} entries")
            index.append(k % n)
        return np.asarray(self._read(tuple(index)))

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the complete array in memory."""
        return np.asarray(self[...], dtype)
