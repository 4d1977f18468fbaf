"""Frames as recalibration uses them: in electrons, on the pixels of the sensor or of a window, and checked."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from lfcal.base import InputError, check_number, format_bytes, format_pixels, free_memory, note
from lfcal.camera import ScanPlan
from lfcal.fit import NewFrame
from lfcal.recalibrate._scene import ObjectFrame
from lfcal.recalibrate._window import LEAST_SIDE, SIDE, SensorWindow, windows_of

__all__ = ["ROOM", "distinct_label", "in_window", "pattern_bytes", "whole_frame", "windows_within"]

PLATEAU = 12
"""Number of pixels with exactly the largest value of a frame above which the frame is taken as saturated there."""

ROOM = 0.8
"""Fraction of the free memory that may be used."""

SIDES = tuple(range(SIDE, LEAST_SIDE - 1, -10))
"""Sides of windows (pixels), the best first."""

STRUCTURE = 1.1
"""Least mean square difference of neighbouring pixels of a frame, relative to that of noise."""


def distinct_label(label: str, taken: Collection[str]) -> str:
    """Return a label, with a number appended if it is among those ``taken``."""
    name, number = label, 1
    while name in taken:
        number += 1
        name = f"{label} ({number})"
    return name


def windows_within(plan: ScanPlan, count: int | None, copies: float, *, every: bool) -> tuple[SensorWindow, ...]:
    """Return windows of a sensor whose patterns fit into memory: as large and as many as possible.

    Parameters
    ----------
    plan, count
        As in `windows_of`. If ``count`` is None, memory may also reduce the number of windows.
    copies
        Memory of a window, relative to that of the patterns of all its voxels.
    every
        Whether the patterns of all windows are in memory together, instead of one window at a time.

    Raises
    ------
    InputError
        If not even one window of the smallest size fits.
    """
    free, needed = ROOM * free_memory(), 0.0
    for number in (count, 1) if every and count is None else (count,):
        for side in SIDES:
            found = windows_of(plan, number, side)
            needed = copies * pattern_bytes(found[0].plan) * (len(found) if every else 1)
            if not free or needed <= free:
                return found
    raise InputError.expected(
        "memory for the patterns of a window",
        f"at least {format_bytes(needed)}",
        f"{format_bytes(free)} that may be used",
        "choose a smaller cutout, fewer planes or fewer windows",
    )


def pattern_bytes(plan: ScanPlan) -> int:
    """Return the memory of the patterns of all positions of a plan (bytes)."""
    return 4 * math.prod(plan.shape)


def whole_frame(frame: NewFrame, name: str, plan: ScanPlan, given: tuple[float, float] | None) -> ObjectFrame:
    """Return a frame on the pixels of the sensor, in electrons."""
    noise, sensor = given or frame.noise, plan.camera.sensor
    if noise is None or not noise[1] > 0:
        raise InputError.expected(
            f"{name}, noise",
            "a variance that grows with the signal, from photon noise",
            "none" if noise is None else f"the variance {noise[0]:g} + {noise[1]:g} x value",
            "give the constant and the slope of the variance (--noise)",
        )
    check_number("noise: constant", noise[0], at_least=0)
    (row, column), (rows, columns) = frame.origin, frame.values.shape
    complete = frame.origin != (0, 0) or frame.values.shape == sensor.shape
    if not complete or row + rows > sensor.shape[0] or column + columns > sensor.shape[1]:
        raise InputError.expected(
            f"{name}, size",
            f"{format_pixels(sensor.shape)}, as in the camera",
            f"{format_pixels(frame.values.shape)} from row {row}, column {column}",
            "give whole frames of this camera",
        )
    whole, valid = np.zeros(sensor.shape, np.float32), np.zeros(sensor.shape, np.float32)
    inside = np.s_[row : row + rows, column : column + columns]
    good = np.isfinite(frame.values) if frame.valid is None else frame.valid & np.isfinite(frame.values)
    flat = good & (frame.values == frame.values.max(where=good, initial=-math.inf))
    if flat.sum() > PLATEAU:
        note(f"{name}: {flat.sum():,} pixels have the largest value, and are left out as saturated")
        good = good & ~flat
    whole[inside] = np.where(good, frame.values, 0) / np.float32(noise[1])
    valid[inside] = good
    found = ObjectFrame(whole, valid, math.sqrt(noise[0]) / noise[1], sensor.prnu, name)
    _check_structure(found)
    return found


def _check_structure(frame: ObjectFrame) -> None:
    """Raise `InputError` if neighbouring pixels differ by noise only: an object could be fitted to any noise."""
    differ = expected = 0.0
    noise = frame.valid / np.maximum(frame.inverse_variance(np.maximum(frame.electrons, 0)), 1e-12)
    for axis in (0, 1):
        both = np.minimum(*(np.delete(frame.valid, end, axis) for end in (0, -1)))
        differ += float((both * np.diff(frame.electrons, axis=axis) ** 2).sum())
        expected += float((both * (np.delete(noise, 0, axis) + np.delete(noise, -1, axis))).sum())
    if differ < STRUCTURE * expected and expected > 0:
        raise InputError.expected(
            f"{frame.name}, objects",
            "structure that is larger than the noise",
            f"neighbouring pixels that differ by {math.sqrt(differ / expected):.2f} times the noise",
            "give brighter frames of objects with fine structure, or correct the noise",
        )


def in_window(whole: ObjectFrame, window: SensorWindow) -> ObjectFrame:
    """Return the part of a frame in a window."""
    electrons = np.ascontiguousarray(window.part(whole.electrons))
    valid = np.ascontiguousarray(window.part(whole.valid))
    return replace(whole, electrons=electrons, valid=window.trusted(electrons, valid))
