"""Regions of a frame: checked, grown, clipped, moved."""

from __future__ import annotations

from typing import TypeAlias

from lfcal.base import InputError

__all__ = ["Region", "check_region", "clipped", "grow_region", "moved", "part_of", "region_shape", "whole"]

Region: TypeAlias = tuple[slice, slice]
"""Rows and columns of a frame, each ``slice(start, stop)`` with step 1, in sensor pixels."""


def whole(shape: tuple[int, int]) -> Region:
    """Return the region that covers a frame of ``shape``."""
    return slice(0, shape[0]), slice(0, shape[1])


def region_shape(region: Region) -> tuple[int, int]:
    """Return rows and columns of a checked ``region``."""
    return region[0].stop - region[0].start, region[1].stop - region[1].start


def check_region(region: Region, shape: tuple[int, int]) -> Region:
    """Return ``region`` with explicit bounds, or raise `InputError` unless it lies within ``shape``."""
    checked = []
    for part, n, what in zip(region, shape, ("rows", "columns"), strict=True):
        start = 0 if part.start is None else int(part.start)
        stop = n if part.stop is None else int(part.stop)
        if part.step not in (None, 1) or not 0 <= start < stop <= n:
            step = "" if part.step in (None, 1) else f" in steps of {part.step}"
            raise InputError.expected(
                f"region {what}",
                f"start < stop within 0 … {n}, step 1",
                f"{start} … {stop}{step}",
                "keep the region on the sensor",
            )
        checked.append(slice(start, stop))
    return checked[0], checked[1]


def grow_region(region: Region, margin: int, shape: tuple[int, int]) -> Region:
    """Return ``region`` with ``margin`` more pixels on every side, cut off at the border of ``shape``."""
    rows, columns = check_region(region, shape)
    return (
        slice(max(0, rows.start - margin), min(shape[0], rows.stop + margin)),
        slice(max(0, columns.start - margin), min(shape[1], columns.stop + margin)),
    )


def moved(region: Region, origin: tuple[int, int]) -> Region:
    """Return ``region`` moved by ``origin`` (rows, columns): from frame to sensor coordinates."""
    rows, columns = region
    return (
        slice(rows.start + origin[0], rows.stop + origin[0]),
        slice(columns.start + origin[1], columns.stop + origin[1]),
    )


def clipped(region: Region, shape: tuple[int, int]) -> Region:
    """Return the part of ``region`` that lies inside a frame of ``shape``; it may be empty."""
    rows, columns = (
        slice(min(max(part.start, 0), n), min(max(part.stop, 0), n)) for part, n in zip(region, shape, strict=True)
    )
    return rows, columns


def part_of(region: Region, outer: Region) -> Region:
    """Return ``region`` counted from the first pixel of ``outer``, which holds it."""
    return moved(region, (-outer[0].start, -outer[1].start))
