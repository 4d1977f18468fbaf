"""Regions of a frame: checked, grown, and read from sources that can read a part."""

from __future__ import annotations

from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lfcal.errors import InputError
from lfcal.frames.source import FrameSource

__all__ = ["Region", "RegionReader", "check_region", "grow_region", "read_region", "region_shape", "whole"]

Region: TypeAlias = tuple[slice, slice]
"""Rows and columns of a frame, each ``slice(start, stop)`` with step 1, in sensor pixels."""


@runtime_checkable
class RegionReader(Protocol):
    """A frame source that reads a part of a frame without reading all of it."""

    def read_region(self, index: int, rows: slice, columns: slice) -> NDArray[Any]:
        """Return the part ``[rows, columns]`` of frame ``index`` as a new array."""
        ...


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


def read_region(source: FrameSource, index: int, rows: slice, columns: slice) -> NDArray[Any]:
    """Return the part ``[rows, columns]`` of frame ``index`` as a new contiguous array.

    A source with a ``read_region`` method reads no more than it must; any other reads the frame and cuts it.

    Raises
    ------
    InputError
        If the region leaves the sensor.
    """
    rows, columns = check_region((rows, columns), source.shape)
    if isinstance(source, RegionReader):
        return source.read_region(index, rows, columns)
    return np.ascontiguousarray(source.read(index)[rows, columns])
