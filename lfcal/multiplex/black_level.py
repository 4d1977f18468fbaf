"""The level of no light of recorded frames: one number, or, as RAW files state it, one per place of a pattern."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError

__all__ = ["black_level_map", "without_black_level"]


def black_level_map(levels: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the level of no light of every pixel, ``(rows, columns)``, or one number as ``()``.

    Parameters
    ----------
    levels
        One number, one per pixel ``(rows, columns)``, or those of a square pattern by rows, such as (R, G, G, B):
        metadata ``black_level`` of a frame.
    shape
        Rows and columns of the frame, which begins with the pattern's first place.

    Raises
    ------
    InputError
        If these are no finite levels of a square pattern.
    """
    values = np.asarray(levels, float)
    if values.ndim == 2 and values.shape == tuple(shape) and np.isfinite(values).all():
        return values
    side = math.isqrt(values.size)
    if not values.size or side * side != values.size or not np.isfinite(values).all():
        raise InputError.expected("black level", "a number, or those of a square pattern", values.shape, "correct it")
    if values.size == 1:
        return values.reshape(())
    rows, columns = (np.arange(n) % side for n in shape)
    found: NDArray[np.float64] = values.ravel()[rows[:, None] * side + columns]
    return found


def without_black_level(frame: ArrayLike, levels: ArrayLike) -> NDArray[Any]:
    """Return a frame less its level of no light (`black_level_map`), float64 for frames of float64, else float32.

    Examples
    --------
    >>> from lfcal.multiplex import without_black_level
    >>> raw = [[110, 220], [330, 400]]
    >>> without_black_level(raw, (10, 20, 30, 40)).tolist()  # of a pattern of 2 x 2, as RAW files state them
    [[100.0, 200.0], [300.0, 360.0]]
    >>> without_black_level(raw, 64).tolist()
    [[46.0, 156.0], [266.0, 336.0]]
    """
    raw = np.asarray(frame)
    if raw.ndim != 2 or raw.dtype.kind not in "uif":
        raise InputError.expected("frame", "numbers in rows and columns", f"{raw.dtype} {raw.shape}", "give one plane")
    kind = np.float64 if raw.dtype == np.float64 else np.float32
    light: NDArray[Any] = raw.astype(kind) - black_level_map(levels, raw.shape).astype(kind)
    return light
