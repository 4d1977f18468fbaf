"""Conversion of arrays to images: levels, log, gamma, colour map, binning. Pure functions, no Qt."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, any_of, njit

COLOUR_MAPS = ("magma", "viridis", "cividis", "gray")
"""Perceptually uniform colour maps for intensities; in the first one, zero is black."""

DIVERGING = "vanimo"
"""Colour map for signed values, dark at zero."""

DEPTHS, DARKEST = "plasma", 32
"""Colour map for depths, and the index of the first colour used."""

UNTINTED = np.uint8(128)
"""Grey of pixels without a depth."""

COLOURS = Path(__file__).with_name("colours.npy")
"""RGB values of these maps ``(6, 256, 3)``, copied from matplotlib, whose import would take 0.1 s."""

SCALES = ("linear", "log", "gamma")

DECADES_BELOW = 1e-4
"""Smallest value shown on a logarithmic scale, relative to the largest."""

LARGEST = 1e30
"""Magnitude of levels below which float32 is used, if their span also exceeds the inverse of this number."""


@dataclass(frozen=True)
class DisplaySettings:
    """Display settings of an image.

    Attributes
    ----------
    scale
        ``"linear"``, ``"log"`` (of the value itself, at most four decades below the top) or ``"gamma"`` (square root).
    colour_map
        One of `COLOUR_MAPS`, or the map for signed values.
    levels
        Lowest and highest value shown. None: lowest and highest value of the data.
    """

    scale: str = "linear"
    colour_map: str = "magma"
    levels: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Check every value."""
        if self.scale not in SCALES:
            raise InputError.expected("scaling", any_of(SCALES), self.scale, "choose one of these")
        if self.colour_map not in (*COLOUR_MAPS, DIVERGING):
            raise InputError.expected("colour map", any_of(COLOUR_MAPS), self.colour_map, "choose one of these")


def level_words(value: float, levels: tuple[float, float]) -> str:
    """Return the level at an end of the colour scale as text; values far below the range are shown as 0."""
    low, high = levels
    return f"{value:.4g}" if abs(value) > 1e-4 * abs(high - low) else "0"


def levels_of(image: NDArray[np.generic], *, signed: bool = False) -> tuple[float, float]:
    """Return the lowest and highest level that show all of ``image``; symmetric about zero if ``signed``."""
    finite = image[np.isfinite(image)] if image.dtype.kind == "f" else image
    if finite.size == 0:
        return (0.0, 1.0)
    low, high = float(finite.min()), float(finite.max())
    if signed:
        top = max(abs(low), abs(high)) or 1.0
        return (-top, top)
    return (low, high if high > low else above(low))


def above(value: float) -> float:
    """Return a number above ``value`` for a range of values that are all equal."""
    return value + max(1.0, 1e-6 * abs(value))


def to_uint8(image: NDArray[np.generic], display: DisplaySettings, levels: tuple[float, float]) -> NDArray[np.uint8]:
    """Return ``image`` scaled to 0..255 by ``display``; not-a-number becomes 0."""
    if image.dtype in (np.uint8, np.uint16) and image.size > 1 << 18:
        shown: NDArray[np.uint8] = _table(256**image.dtype.itemsize, display.scale, levels)[image]
        return shown
    return _scaled(image, display.scale, levels)


@lru_cache(maxsize=8)
def _table(count: int, scale: str, levels: tuple[float, float]) -> NDArray[np.uint8]:
    """Return a lookup table of 0..255 for the first ``count`` integers, faster than arithmetic on large frames."""
    return _scaled(np.arange(count, dtype=np.float32), scale, levels)


def _scaled(image: NDArray[np.generic], scale: str, levels: tuple[float, float]) -> NDArray[np.uint8]:
    return (shades(image, scale, levels) * 255.0 + 0.5).astype(np.uint8)


def shades(image: NDArray[np.generic], scale: str, levels: tuple[float, float]) -> NDArray[np.float32]:
    """Return the positions of values on the colour map, 0..1; not-a-number becomes 0.

    For log and gamma scaling, negative values (noise) are as dark as zero.
    """
    low, high = levels
    if scale != "linear" and high > 0:
        low = max(low, 0.0)
    span = high - low if high > low else 1.0
    # products beyond the range of float32
    kind: Any = np.float32 if 1 / LARGEST < span and max(abs(low), abs(high)) < LARGEST else np.float64
    if scale == "log" and high > 0:
        bottom = max(low, DECADES_BELOW * high)
        values = np.asarray(image, kind) * kind(1.0 / bottom)
        np.nan_to_num(values, copy=False, nan=0.0, posinf=high / bottom, neginf=0.0)
        np.log(np.clip(values, 1.0, max(1.0, high / bottom), out=values), out=values)
        decades = math.log(high / bottom)
        return np.asarray(values / kind(decades) if decades > 0 else values >= 0, np.float32)
    values = (np.asarray(image, kind) - kind(low)) * kind(1.0 / span)
    np.nan_to_num(values, copy=False, nan=0.0, posinf=1.0, neginf=0.0)
    np.clip(values, 0.0, 1.0, out=values)
    if scale == "gamma":
        np.sqrt(values, out=values)
    return np.asarray(values, np.float32)


def tinted(
    image: NDArray[np.generic], tint: NDArray[np.floating], display: DisplaySettings, levels: tuple[float, float]
) -> NDArray[np.uint8]:
    """Return RGB values with the brightness of `to_uint8` and the colours of ``tint`` (0..1).

    Where the tint is NaN, they are grey and half as bright.
    """
    bright = to_uint8(image, display, levels)
    index = (np.nan_to_num(tint, nan=0.0).clip(0, 1) * 255 + 0.5).astype(np.uint8)
    colours = np.where(np.isnan(tint)[..., None], UNTINTED, depth_colours()[index, :3])
    shown: NDArray[np.uint8] = (colours * (bright[..., None] + np.uint16(1)) >> 8).astype(np.uint8)
    return shown


@lru_cache(maxsize=1)
def depth_colours() -> NDArray[np.uint8]:
    """Return the colours of depths ``(256, 4)`` from near to far, without the darkest, which would hide light."""
    return np.ascontiguousarray(colour_table(DEPTHS)[np.linspace(DARKEST, 255, 256).round().astype(int)])


@lru_cache(maxsize=16)
def colour_table(name: str, *, red: bool = False) -> NDArray[np.uint8]:
    """Return the RGBA table ``(256, 4)`` of a colour map: one of `COLOUR_MAPS`, `DIVERGING` or `DEPTHS`.

    With ``red`` the table runs from black to red, with the same brightness.
    """
    colours = np.load(COLOURS)[(*COLOUR_MAPS, DIVERGING, DEPTHS).index(name)]
    if red:
        brightness = colours @ np.array([0.2126, 0.7152, 0.0722])
        if name != DIVERGING:
            brightness = np.maximum.accumulate(brightness)
        colours = np.column_stack([brightness, 0 * brightness, 0 * brightness])
    return np.column_stack([colours, np.full(256, 255)]).astype(np.uint8)


@njit()
def _bin_max(image: NDArray[np.uint16], step: int, out: NDArray[np.uint16]) -> None:
    """Reduce rows first, element by element, which the compiler vectorises; then columns."""
    rows, columns = out.shape
    line = np.empty(columns * step, image.dtype)
    for r in range(rows):
        top = image[r * step]
        for c in range(line.size):
            line[c] = top[c]
        for dr in range(1, step):
            below = image[r * step + dr]
            for c in range(line.size):
                line[c] = max(line[c], below[c])
        for c in range(columns):
            best = line[c * step]
            for dc in range(1, step):
                best = max(best, line[c * step + dc])
            out[r, c] = best


def bin_max(image: NDArray[np.generic], step: int) -> NDArray[np.generic]:
    """Return the maximum of every ``step`` x ``step`` block: point sources stay visible when zoomed out.

    Rows and columns at the end that do not fill a block are ignored.
    """
    if step <= 1:
        return image
    rows, columns = image.shape[0] // step, image.shape[1] // step
    if rows == 0 or columns == 0:
        return image
    out = np.empty((rows, columns), image.dtype)
    _bin_max(np.ascontiguousarray(image), step, out)
    return out
