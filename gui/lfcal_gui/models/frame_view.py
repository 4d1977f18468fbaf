"""View of a frame in Record > Folder: visible part, statistics and lattice. No Qt."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera
from lfcal_gui.models.display import DisplaySettings, bin_max, tinted, to_uint8

MAX_PIXELS = 1600 * 1200
"""Largest number of pixels sent to the screen."""

MAX_POINTS = 20_000


@dataclass(frozen=True)
class Tile:
    """Part of a frame to draw: rows and columns, with each ``step`` x ``step`` block as one pixel."""

    rows: tuple[int, int]
    columns: tuple[int, int]
    step: int


def visible_tile(
    shape: tuple[int, int], rows: tuple[float, float], columns: tuple[float, float], screen: tuple[int, int]
) -> Tile:
    """Return the tile for a view of ``rows`` and ``columns`` (pixels) on ``screen`` (height, width; points).

    At 100 % and above, the visible part is drawn pixel by pixel. Below, each block is drawn with its maximum, so
    that no point source disappears.
    """
    top, left = (min(max(0, math.floor(low) - 1), n - 1) for low, n in zip((rows[0], columns[0]), shape, strict=True))
    bottom, right = (
        min(max(first + 1, math.ceil(high) + 2), n)
        for first, high, n in zip((top, left), (rows[1], columns[1]), shape, strict=True)
    )
    per_point = max((bottom - top) / max(1, screen[0]), (right - left) / max(1, screen[1]))
    step = max(1, math.floor(per_point))
    while ((bottom - top) // step) * ((right - left) // step) > MAX_PIXELS:
        step += 1
    step = min(step, bottom - top, right - left)
    top, left = top - top % step, left - left % step
    return Tile((top, bottom), (left, right), step)


def render_tile(
    frame: NDArray[np.generic],
    tile: Tile,
    display: DisplaySettings,
    levels: tuple[float, float],
    tint: NDArray[np.floating] | None = None,
) -> NDArray[np.uint8]:
    """Return the tile of the frame as image values 0..255; with a ``tint``, as RGB values."""
    part = slice(*tile.rows), slice(*tile.columns)
    if tint is None:
        return to_uint8(bin_max(frame[part], tile.step), display, levels)
    # a maximum of light and a depth would be of two places
    rows, columns = ((b - a) // tile.step * tile.step for a, b in (tile.rows, tile.columns))
    some = slice(0, rows, tile.step), slice(0, columns, tile.step)
    return tinted(frame[part][some], tint[part][some], display, levels)


@dataclass(frozen=True)
class FrameNumbers:
    """Exact statistics of a frame.

    Attributes
    ----------
    low, high, mean
        Smallest, largest and mean value.
    saturated
        Number of saturated pixels. None: unknown.
    """

    low: float
    high: float
    mean: float
    saturated: int | None


def frame_numbers(frame: NDArray[np.generic], saturated: int | None) -> FrameNumbers:
    """Return the extremes and the mean over all pixels of ``frame``, with its number of ``saturated`` pixels."""
    return FrameNumbers(float(frame.min()), float(frame.max()), float(frame.mean(dtype=np.float64)), saturated)


def lattice_points(
    camera: Camera, rows: tuple[float, float], columns: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return the micro-image centres (row, column) inside a view and their lens types; none if there are too many."""
    pixel = camera.sensor.pixel_um
    rows, columns = (
        (max(low, -0.5), min(high, n - 0.5))
        for (low, high), n in zip((rows, columns), camera.sensor.shape, strict=True)
    )
    middle_row, middle_column = ((n - 1) / 2 for n in camera.sensor.shape)
    height, width = max(1.0, rows[1] - rows[0]), max(1.0, columns[1] - columns[0])
    if camera.has_lattice and height * width / camera.pitch_px**2 > MAX_POINTS:
        return np.zeros((0, 2)), np.zeros(0, np.intp)
    about = (
        ((columns[0] + columns[1]) / 2 - middle_column) * pixel,
        ((rows[0] + rows[1]) / 2 - middle_row) * pixel,
    )
    centres, types = camera.lattice.lenslets_within(width * pixel / 2, height * pixel / 2, about)
    points = np.stack([centres[:, 1] / pixel + middle_row, centres[:, 0] / pixel + middle_column], axis=-1)
    return points, types
