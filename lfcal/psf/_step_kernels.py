"""Compiled loops over single patterns: their light by row and column, and their values rounded to steps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["add_rounded", "error_of_step", "light_by_line", "round_pattern", "values_of_steps", "write_steps"]


@njit(error_model="numpy")
def light_by_line(pattern: NDArray[Any], rows: NDArray[Any], columns: NDArray[Any]) -> tuple[float, float, float]:
    """Fill ``rows`` (nt,) and ``columns`` (ns,) with the sums of the magnitudes of ``pattern`` (nt, ns).

    Returns
    -------
    tuple of float
        Sum of all magnitudes, lowest and highest value.
    """
    rows[:] = 0
    columns[:] = 0
    low, high, total = np.inf, -np.inf, 0.0
    for t in range(pattern.shape[0]):
        line = pattern[t]
        for s in range(pattern.shape[1]):
            size = abs(line[s])
            low, high = min(low, line[s]), max(high, line[s])
            rows[t] += size
            columns[s] += size
        total += rows[t]
    return total, low, high


@njit(error_model="numpy")
def error_of_step(pattern: NDArray[Any], window: tuple[int, int, int, int], step: float) -> float:
    """Return the total error of rounding values within ``window`` (first and last row, column) to whole steps."""
    error, each = 0.0, 1 / step
    for t in range(window[0], window[1] + 1):
        line, lacking = pattern[t], 0.0
        for s in range(window[2], window[3] + 1):
            lacking += abs(line[s] - np.rint(line[s] * each) * step)
        error += lacking
    return error


@njit(error_model="numpy")
def write_steps(
    pattern: NDArray[Any], window: tuple[int, int, int, int], step: float, most: int, out: NDArray[Any]
) -> tuple[float, float, float, int]:
    """Fill ``out`` (nt, ns), float32, with ``pattern`` rounded to whole steps; outside ``window``, all values are 0.

    Returns
    -------
    float, float, float, int
        Sum of the magnitudes outside the window; sum of the errors inside it; sum of all magnitudes; and number of
        values that need more than ``most`` steps.
    """
    outside, error, total, lost = 0.0, 0.0, 0.0, 0
    each = 1 / step
    for t in range(pattern.shape[0]):
        line, to = pattern[t], out[t]
        within = window[0] <= t <= window[1]
        for s in range(pattern.shape[1]):
            total += abs(line[s])
            if not (within and window[2] <= s <= window[3]):
                to[s] = 0
                outside += abs(line[s])
                continue
            count = np.rint(line[s] * each)
            if abs(count) > most:
                lost += 1
            to[s] = np.float32(count * step + 0.0)  # no negative zero, which would cost one bit
            error += abs(line[s] - np.float64(to[s]))
    return outside, error, total, lost


@njit(error_model="numpy")
def round_pattern(pattern: NDArray[Any], step: float, out: NDArray[Any]) -> None:
    """Fill ``out`` (nt, ns), float32, with ``pattern`` rounded to whole steps whose width is a power of two."""
    each = 1 / step
    for t in range(pattern.shape[0]):
        line, to = pattern[t], out[t]
        for s in range(pattern.shape[1]):
            to[s] = np.float32(np.rint(line[s] * each) * step + 0.0)


@njit(error_model="numpy")
def add_rounded(pattern: NDArray[Any], step: float, total: NDArray[np.float64]) -> tuple[float, float]:
    """Add ``pattern``, rounded to whole steps, to ``total`` (nt, ns); return the sums of errors and of magnitudes."""
    error, size, each = 0.0, 0.0, 1 / step
    for t in range(pattern.shape[0]):
        line, to = pattern[t], total[t]
        for s in range(pattern.shape[1]):
            value = np.rint(line[s] * each) * step
            to[s] += value
            error += abs(line[s] - value)
            size += abs(line[s])
    return error, size


@njit(error_model="numpy")
def values_of_steps(stored: NDArray[Any], step: NDArray[Any], zero: NDArray[Any], out: NDArray[Any]) -> None:
    """Fill ``out`` ``(n, pixels)`` with ``(stored - zero) * step``, float32; ``step`` and ``zero`` are ``(n,)``.

    Patterns are stored like this in files of version 3.
    """
    for k in range(stored.shape[0]):
        line, to, by, nothing = stored[k], out[k], step[k], np.int32(zero[k])
        for p in range(stored.shape[1]):
            to[p] = np.float32(np.int32(line[p]) - nothing) * by
