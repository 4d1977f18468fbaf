"""Several exposures of one place made one frame: the mean of equal ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.errors import InputError

__all__ = ["average"]


def average(frames: Sequence[NDArray[Any]], max_value: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the mean of equally exposed frames and which pixels were saturated in any of them.

    Parameters
    ----------
    frames
        ``(rows, columns)`` unsigned integers, the same shape each.
    max_value
        Saturated sample value. A pixel that is saturated in one frame has a mean that is too low, however
        the others are, so it counts as saturated.

    Returns
    -------
    mean, saturated
        float32 and bool, ``(rows, columns)``.
    """
    if not frames or any(frame.shape != frames[0].shape for frame in frames):
        raise InputError.expected(
            "frames to average", "one or more of one shape", [f.shape for f in frames], "grab them again"
        )
    total = np.zeros(frames[0].shape, np.uint32)
    saturated = np.zeros(frames[0].shape, np.bool_)
    for frame in frames:
        total += frame
        saturated |= frame >= max_value
    return (total / np.float64(len(frames))).astype(np.float32), saturated
