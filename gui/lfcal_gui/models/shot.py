"""Content of one image view: values, overlays and text that belong together. No Qt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import format_length
from lfcal_gui.models.display import DisplaySettings, levels_of

Levels: TypeAlias = "tuple[float, float]"
"""Values at both ends of the colour scale."""

CUTOUT = "#ffd166"
"""Colour of a cutout and of its point, visible on every colour map."""


@dataclass(frozen=True, eq=False)
class Outline:
    """A line through ``points`` ``(n, 2)`` (row, column), in the units of the image.

    A dark rim (``rimmed``) makes it visible on bright pixels.
    """

    points: NDArray[np.float64]
    colour: str = "#ffffff"
    dashed: bool = False
    closed: bool = True
    width: float = 1.5
    rimmed: bool = False


@dataclass(frozen=True, eq=False)
class Symbols:
    """A symbol of ``size`` screen pixels at each of the ``points`` ``(n, 2)``: ``o``, ``s`` (square), ``+`` or ``x``.

    ``colours``: one for all symbols, or one for each; ``filled``: whether symbols are filled.
    """

    points: NDArray[np.float64]
    symbol: str = "+"
    colours: str | Sequence[str] = "#ffffff"
    size: float = 12
    filled: bool = False


@dataclass(frozen=True, eq=False)
class Label:
    """Text with a dark rim, centred at the point (row, column) in ``points`` ``(1, 2)``."""

    points: NDArray[np.float64]
    words: str
    colour: str = "#ffffff"


Overlay: TypeAlias = "Outline | Symbols | Label"


def cutout_of(
    row: float, column: float, shape: Sequence[int], point: ArrayLike | None = None, colour: str = CUTOUT
) -> tuple[Overlay, ...]:
    """Return the border of a cutout with first pixel (row, column), and the paraxial image of its point."""
    top, left = row - 0.5, column - 0.5
    bottom, right = top + shape[0], left + shape[1]
    border = Outline(np.array([(top, left), (top, right), (bottom, right), (bottom, left)]), colour, width=2)
    return (border,) if point is None else (border, Symbols(np.array([point], np.float64), "+", colour))


@dataclass(frozen=True, eq=False)
class Tint:
    """Colours of pixels whose brightness shows their value.

    ``values`` ``(rows, columns)``: positions on the colour scale of depths, 0 ... 1; ``ends``: labels of its ends.
    """

    values: NDArray[np.floating[Any]]
    ends: tuple[str, str]


@dataclass(frozen=True, eq=False)
class Shot:
    """An image with its overlays, labels and scale.

    Attributes
    ----------
    values
        Numbers ``(rows, columns)``, with not-a-number shown dark; or RGB in 0 ... 1 ``(rows, columns, 3)``.
        None: no image.
    caption
        Caption drawn over the image.
    quantity
        Quantity of the values with its unit; empty: as set in the view.
    name
        Name for files of the image; empty: unchanged.
    levels
        Values at the ends of the colour scale if it is shared with other images. None: from the values.
    signed
        Whether zero is in the middle of the colour scale.
    origin, step
        Coordinates (row, column) of the first pixel, and side of a pixel.
    overlays
        Overlays drawn over the image.
    cross
        Pixel (row, column) marked with a cross.
    pixel_um
        Side of a pixel (µm) for the scale bar. None: no scale bar.
    tint
        Colours of the pixels. None: from their values.
    whole
        First row and column, height and width of the full image that it is a part of. None: it is the full image.
    readout
        Lines of numbers drawn in the upper right corner.
    """

    values: NDArray[Any] | None = None
    caption: str = ""
    quantity: str = ""
    name: str = ""
    levels: Levels | None = None
    signed: bool = False
    origin: tuple[float, float] = (0.0, 0.0)
    step: float = 1.0
    overlays: tuple[Overlay, ...] = ()
    cross: tuple[float, float] | None = None
    pixel_um: float | None = None
    tint: Tint | None = None
    whole: tuple[float, float, float, float] | None = None
    readout: str = ""

    @property
    def coloured(self) -> bool:
        """Whether the values are RGB colours."""
        return self.values is not None and self.values.ndim == 3

    @property
    def shape(self) -> tuple[int, int] | None:
        """Rows and columns."""
        return None if self.values is None else (self.values.shape[0], self.values.shape[1])

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """First row and column, height and width of the image, in its units."""
        rows, columns = self.shape or (0, 0)
        (row, column), step = self.origin, self.step
        return row - step / 2, column - step / 2, rows * step, columns * step

    @property
    def place(self) -> object:
        """Key of the view: as long as it is unchanged, pan and zoom are kept."""
        return self.whole or (self.shape, self.origin, self.step)

    @property
    def measured(self) -> NDArray[Any] | None:
        """Values used for measurements; for RGB the mean of the three."""
        return self.values.mean(-1) if self.values is not None and self.coloured else self.values

    def levels_in(self, display: DisplaySettings, chosen: Levels | None) -> Levels:
        """Return the limits of the colour scale: ``chosen`` by the user, else shared, else from the values."""
        values = self.measured
        if values is None:
            return (0.0, 1.0)
        return chosen or self.levels or display.levels or levels_of(values, signed=self.signed)

    def pixel_at(self, row: float, column: float) -> tuple[int, int] | None:
        """Return the pixel (row, column) at coordinates; None outside the image."""
        if self.shape is None or not (math.isfinite(row) and math.isfinite(column)):
            return None
        pixel = round((row - self.origin[0]) / self.step), round((column - self.origin[1]) / self.step)
        return pixel if all(0 <= k < n for k, n in zip(pixel, self.shape, strict=True)) else None

    def value_at(self, pixel: tuple[int, int]) -> float:
        """Return the value of a pixel."""
        assert self.values is not None
        return float(self.values[pixel].mean())


def scale_bar(pixel_um: float, pixels_a_point: float, longest: float) -> tuple[float, str]:
    """Return the length of a scale bar in screen points, at most ``longest``, and its label.

    Its length is 1, 2 or 5 times a power of ten; a screen point covers ``pixels_a_point`` image pixels.
    """
    most = pixel_um * pixels_a_point * longest
    decade = 10.0 ** math.floor(math.log10(most))
    length = max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= most)
    return length / (pixel_um * pixels_a_point), format_length(length)
