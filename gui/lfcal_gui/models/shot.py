"""What one picture shows: values, what is drawn over them, and words, all of one moment. No Qt."""

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
"""Values at both ends of the colours."""

CUTOUT = "#ffd166"
"""Colour of a cutout and of its point, which is seen on every colour map."""


@dataclass(frozen=True, eq=False)
class Outline:
    """A line through ``points`` ``(n, 2)``, rows and columns in the units of the picture."""

    points: NDArray[np.float64]
    colour: str = "#ffffff"
    dashed: bool = False
    closed: bool = True
    width: float = 1.5


@dataclass(frozen=True, eq=False)
class Symbols:
    """A symbol of ``size`` screen pixels at each of the ``points`` ``(n, 2)``: ``o``, ``s`` (square), ``+`` or ``x``.

    ``colours``: one for all, or one for each; ``filled`` with them.
    """

    points: NDArray[np.float64]
    symbol: str = "+"
    colours: str | Sequence[str] = "#ffffff"
    size: float = 12
    filled: bool = False


@dataclass(frozen=True, eq=False)
class Label:
    """Words in the middle of one of the ``points`` ``(1, 2)``."""

    points: NDArray[np.float64]
    words: str
    colour: str = "#ffffff"


Overlay: TypeAlias = "Outline | Symbols | Label"


def cutout_of(
    row: float, column: float, shape: Sequence[int], point: ArrayLike | None = None, colour: str = CUTOUT
) -> tuple[Overlay, ...]:
    """Return the border of a cutout whose first pixel is (row, column), and the paraxial image of its point."""
    top, left = row - 0.5, column - 0.5
    bottom, right = top + shape[0], left + shape[1]
    border = Outline(np.array([(top, left), (top, right), (bottom, right), (bottom, left)]), colour, width=2)
    return (border,) if point is None else (border, Symbols(np.array([point], np.float64), "+", colour))


@dataclass(frozen=True, eq=False)
class Tint:
    """Colours of pixels whose brightness is their value.

    ``values`` ``(rows, columns)``: places on the colours of depths, 0 ... 1; ``ends``: words at both ends of these.
    """

    values: NDArray[np.floating[Any]]
    ends: tuple[str, str]


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture with all that belongs to it.

    Attributes
    ----------
    values
        Any numbers ``(rows, columns)``, not-a-number dark; or red, green and blue in 0 ... 1 ``(rows, columns, 3)``;
        None: nothing.
    caption
        What it is of, written over it.
    quantity
        What the values are, with their unit; empty: as the picture says.
    name
        What files of it are called; empty: as before.
    levels
        Values at the ends of the colours, where it shares them with others; None: its own.
    signed
        Whether zero is in the middle of the colours.
    origin, step
        Coordinates (row, column) of the first pixel, and the length of a pixel.
    overlays
        What is drawn over it.
    cross
        The pixel (row, column) that is pointed out.
    pixel_um
        Length of a pixel, for a scale bar; None: none is drawn.
    tint
        Colours of the pixels; None: those of their values.
    whole
        First row and column, height and width of what it is a part of, in its units; None: it is all there is.
    readout
        Lines of numbers, written in the upper right corner.
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
        """Whether the values are colours."""
        return self.values is not None and self.values.ndim == 3

    @property
    def shape(self) -> tuple[int, int] | None:
        """Rows and columns."""
        return None if self.values is None else (self.values.shape[0], self.values.shape[1])

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """First row and column, height and width of the picture, in its units."""
        rows, columns = self.shape or (0, 0)
        (row, column), step = self.origin, self.step
        return row - step / 2, column - step / 2, rows * step, columns * step

    @property
    def place(self) -> object:
        """What stays where pan and zoom stay: where the whole lies, or where and how large the pixels are."""
        return self.whole or (self.shape, self.origin, self.step)

    @property
    def measured(self) -> NDArray[Any] | None:
        """Values that can be measured: of colours their mean."""
        return self.values.mean(-1) if self.values is not None and self.coloured else self.values

    def levels_in(self, display: DisplaySettings, chosen: Levels | None) -> Levels:
        """Return the values at the ends of the colours; ``chosen`` by the user come first, then those it shares."""
        values = self.measured
        if values is None:
            return (0.0, 1.0)
        return chosen or self.levels or display.levels or levels_of(values, signed=self.signed)

    def pixel_at(self, row: float, column: float) -> tuple[int, int] | None:
        """Return the pixel at coordinates, None outside."""
        if self.shape is None or not (math.isfinite(row) and math.isfinite(column)):
            return None
        pixel = round((row - self.origin[0]) / self.step), round((column - self.origin[1]) / self.step)
        return pixel if all(0 <= k < n for k, n in zip(pixel, self.shape, strict=True)) else None

    def value_at(self, pixel: tuple[int, int]) -> float:
        """Return the value of a pixel."""
        assert self.values is not None
        return float(self.values[pixel].mean())


def scale_bar(pixel_um: float, pixels_a_point: float, longest: float) -> tuple[float, str]:
    """Return the length of a scale bar in points of the screen, at most ``longest``, and its words.

    It is 1, 2 or 5 times a power of ten long; a point of the screen covers ``pixels_a_point`` of the picture.
    """
    most = pixel_um * pixels_a_point * longest
    decade = 10.0 ** math.floor(math.log10(most))
    length = max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= most)
    return length / (pixel_um * pixels_a_point), format_length(length)
