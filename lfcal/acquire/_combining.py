"""Several exposures of one place made one frame: averaged, or merged to a high dynamic range."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError

__all__ = ["average", "merge"]


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


def merge(
    frames: Sequence[NDArray[Any]],
    saturated: Sequence[NDArray[np.bool_]],
    exposures_s: Sequence[float],
    *,
    reference_s: float,
    black_level: float = 0.0,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return bracketed frames merged to the counts an unlimited sensor had shown at ``reference_s``.

    Each pixel is the sum of its unsaturated counts above black over the sum of their exposures, which is
    the maximum-likelihood rate for shot noise, times the reference exposure, plus black. Values may
    exceed the sensor's range. A pixel saturated even in the shortest exposure keeps that exposure's value,
    a lower bound, and is marked.

    Parameters
    ----------
    frames
        ``(rows, columns)`` counts, one per exposure.
    saturated
        Which pixels of each frame are saturated.
    exposures_s
        Actual exposure of each frame (s).
    reference_s
        Exposure whose counts are returned (s).
    black_level
        Counts of no light, the same at every exposure.

    Returns
    -------
    counts, saturated
        float32 and bool, ``(rows, columns)``.
    """
    if not len(frames) == len(saturated) == len(exposures_s) > 0 or min(exposures_s) <= 0:
        raise InputError.expected(
            "exposure bracket", "one positive exposure per frame", list(exposures_s), "correct the bracket"
        )
    shortest = int(np.argmin(exposures_s))
    light = np.zeros(frames[0].shape, np.float64)
    seconds = np.zeros(frames[0].shape, np.float64)
    for k, (frame, full, exposure) in enumerate(zip(frames, saturated, exposures_s, strict=True)):
        # the shortest exposure is the best there is of a pixel that all of them saturate
        use = ~full if k != shortest else ~full | np.logical_and.reduce(saturated)
        light += np.where(use, frame - np.float64(black_level), 0.0)
        seconds += np.where(use, exposure, 0.0)
    counts = light / seconds * reference_s + black_level
    return counts.astype(np.float32), np.logical_and.reduce(saturated)
