"""Indices into the five axes of a PSF matrix, by numpy's basic rules."""

from __future__ import annotations

import operator
from collections.abc import Iterable
from typing import Any, cast

import numpy as np

__all__ = ["in_range", "resolved"]


def in_range(value: int, axis: int, n: int) -> int:
    """Return an index counted from the start of an axis; raise `IndexError` if it is out of range."""
    index = operator.index(value)
    if not -n <= index < n:
        raise IndexError(f"index {index} is out of range for axis {axis} ({'zyxts'[axis]}) with {n} entries")
    return index % n


def resolved(key: Any, shape: tuple[int, ...]) -> tuple[int | slice, ...]:
    """Return ``key`` as one integer or slice for each axis."""
    parts = list(key) if isinstance(key, tuple) else [key]
    holes = [k for k, part in enumerate(parts) if part is Ellipsis]
    if len(holes) > 1:
        raise IndexError("an index can have only one ellipsis ('...')")
    if len(parts) - len(holes) > len(shape):
        raise IndexError(
            f"too many indices: a PSF matrix has 5 axes (z, y, x, t, s), but {len(parts)} indices were given"
        )
    at = holes[0] if holes else len(parts)
    fill: Iterable[Any] = [slice(None)] * (len(shape) - (len(parts) - len(holes)))
    full = [*parts[:at], *fill, *parts[at + len(holes) :]]
    return tuple(_axis_index(part, axis, n) for axis, (part, n) in enumerate(zip(full, shape, strict=True)))


def _axis_index(part: Any, axis: int, n: int) -> int | slice:
    if isinstance(part, slice):
        return part
    # a bool has __index__ in Python, but numpy treats it as a mask
    if isinstance(part, bool | np.bool_) or not hasattr(part, "__index__"):
        raise IndexError(
            "a PSF matrix can be indexed only with integers, slices and an ellipsis; read the part you need, "
            "then index it with NumPy"
        )
    return in_range(cast(int, part), axis, n)
