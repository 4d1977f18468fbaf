"""Locate the source of a new frame: the position of H whose pattern is most similar to the frame."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.psf import PSFMatrix

__all__ = ["LocatedPattern", "NewFrame", "find_source", "window_of"]

F4 = NDArray[np.float32]

NEAR = 2
"""Distance from a known position within which the source is searched for (pixels), as stages are not more accurate."""

INSIDE = 0.5
"""Fraction of a cutout that must be on the frame and valid."""

ABOVE = 4.0
"""Standard deviations of dark pixels above which a pixel is lit."""


@dataclass(frozen=True, eq=False)
class NewFrame:
    """A frame of a point source to compare with H.

    Attributes
    ----------
    values
        Samples with the dark level subtracted (counts), ``(rows, columns)``.
    valid
        Mask ``(rows, columns)``, True at valid samples. None: all are valid.
    noise
        ``(constant, slope)``: the variance of a sample of value v is ``constant + slope * max(v, 0)`` (counts²). None:
        unknown.
    origin
        Position (row, column) of the first pixel of the frame on the sensor (px).
    place
        Position (row, column) of the image of the source on the sensor (px). None: unknown, so it is searched for.
    plane
        Index of the depth plane of H in which the source is. None: unknown.
    label
        Name of the frame in messages.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.fit import NewFrame
    >>> frame = NewFrame(np.zeros((80, 96), np.float32), place=(40.0, 48.0), plane=1, label="monday.tif")
    >>> print(frame.label, "has its source at row, column", frame.place)
    monday.tif has its source at row, column (40.0, 48.0)
    """

    values: NDArray[np.float32]
    valid: NDArray[np.bool_] | None = None
    noise: tuple[float, float] | None = None
    origin: tuple[int, int] = (0, 0)
    place: tuple[float, float] | None = None
    plane: int | None = None
    label: str = "frame"


@dataclass(frozen=True, slots=True)
class LocatedPattern:
    """A position of H, the position of its cutout on the sensor, and its similarity to the frame.

    Attributes
    ----------
    z, y, x
        Position in H.
    row, column
        Sensor pixel at the middle of the cutout.
    correlation
        Correlation of the samples of the frame with the values of H; 1 if they differ only in gain and background.
    """

    z: int
    y: int
    x: int
    row: int
    column: int
    correlation: float


def window_of(frame: NewFrame, row: int, column: int, cutout: tuple[int, int]) -> tuple[F4, NDArray[np.bool_]]:
    """Return the samples ``(nt, ns)`` around a pixel of the sensor, and the mask of valid ones.

    ``cutout`` is ``(nt, ns)``. Samples outside the frame, and invalid ones, are 0 and not in the mask.
    """
    nt, ns = cutout
    out, valid = np.zeros(cutout, np.float32), np.zeros(cutout, np.bool_)
    top, left = row - (nt - 1) // 2 - frame.origin[0], column - (ns - 1) // 2 - frame.origin[1]
    rows, columns = frame.values.shape
    first, last = max(0, -top), min(nt, rows - top)
    begin, end = max(0, -left), min(ns, columns - left)
    if last <= first or end <= begin:
        return out, valid
    part = (slice(top + first, top + last), slice(left + begin, left + end))
    out[first:last, begin:end] = frame.values[part]
    valid[first:last, begin:end] = True if frame.valid is None else frame.valid[part]
    valid &= np.isfinite(out)
    out[~valid] = 0.0
    return out, valid


def find_source(matrix: PSFMatrix, frame: NewFrame) -> LocatedPattern:
    """Return the position of H whose pattern best correlates with a frame.

    The lenslet array must not have moved since H was recorded, because H has one pattern for each pixel of the period.
    If ``frame.place`` is known, only pixels up to two rows and columns away are tried. Otherwise, one period around the
    middle of the light is tried. If ``frame.plane`` is known, only that plane is tried.

    Raises
    ------
    InputError
        If the source is outside the frame, or H has no pattern for its position.
    """
    base = np.floor(np.array(matrix.anchor) + 0.5).astype(int)
    if frame.place is None:
        middle, reach = _middle_of_light(frame, matrix.cutout), tuple(n // 2 + 1 for n in matrix.period)
    else:
        middle, reach = (round(frame.place[0]), round(frame.place[1])), (NEAR, NEAR)
    planes = range(matrix.shape[0]) if frame.plane is None else (frame.plane,)
    best: LocatedPattern | None = None
    for row in range(middle[0] - reach[0], middle[0] + reach[0] + 1):
        for column in range(middle[1] - reach[1], middle[1] + reach[1] + 1):
            found = _best_plane(matrix, frame, (row, column), base, planes)
            if found is not None and (best is None or found.correlation > best.correlation):
                best = found
    if best is None:
        raise InputError.expected(
            f"{frame.label}, light",
            "light on the frame, at a recorded position of H",
            "none",
            "record the point at another position",
        )
    return best


def _best_plane(
    matrix: PSFMatrix, frame: NewFrame, at: tuple[int, int], base: NDArray[np.intp], planes: Iterable[int]
) -> LocatedPattern | None:
    y, x = (int(v) for v in (np.array(at) - base) % np.array(matrix.period))
    values, valid = window_of(frame, *at, matrix.cutout)
    if valid.mean() < INSIDE:
        return None
    best: LocatedPattern | None = None
    for z in planes:
        own = np.asarray(matrix[z, y, x], np.float32)
        good = valid & matrix.valid(z, y, x) & np.isfinite(own)
        # missing, masked or constant samples have no correlation
        if matrix.recorded[z, y, x] == 0 or good.mean() < INSIDE or np.ptp(own[good]) == 0:
            continue
        likeness = _correlation(values[good], own[good])
        if best is None or likeness > best.correlation:
            best = LocatedPattern(z, y, x, *at, likeness)
    return best


def _correlation(a: F4, b: F4) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt(np.square(a, dtype=np.float64).sum() * np.square(b, dtype=np.float64).sum()))
    return float(np.multiply(a, b, dtype=np.float64).sum()) / size if size > 0 else 0.0


def _middle_of_light(frame: NewFrame, cutout: tuple[int, int]) -> tuple[int, int]:
    """Return the sensor pixel around which a window of the size of the cutout contains most light."""
    from scipy.ndimage import uniform_filter

    values = np.where(np.isfinite(frame.values), frame.values, 0.0).astype(np.float64)
    if frame.valid is not None:
        values[~frame.valid] = 0.0
    values -= np.median(values)
    # the positive noise of all dark pixels would outweigh dim light and shift the middle
    noise = float(np.median(np.abs(values))) / 0.6745
    bright = np.maximum(values - ABOVE * noise, 0.0)
    values = bright if bright.any() else np.maximum(values, 0.0)
    mean = uniform_filter(values, cutout, mode="constant")
    # the middle of all light in the brightest window, whose own maximum is flat
    row, column = np.unravel_index(int(mean.argmax()), mean.shape)
    top, left = max(0, int(row) - cutout[0] // 2), max(0, int(column) - cutout[1] // 2)
    part = values[top : int(row) + cutout[0] // 2 + 1, left : int(column) + cutout[1] // 2 + 1]
    total = float(part.sum())
    if total <= 0:
        raise InputError.expected(
            f"{frame.label}, light", "light from the point", "none", "check the shutter and the lamp"
        )
    rows, columns = (float((part.sum(1 - axis) * np.arange(part.shape[axis])).sum()) / total for axis in (0, 1))
    return round(top + rows) + frame.origin[0], round(left + columns) + frame.origin[1]
