"""Map image and volume planes to the coarse lattice of whole periods."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, centre, check_cutout, check_number

__all__ = ["Grid", "anchor_pixel"]

Pair = tuple[int, int]

FARTHEST = 1e9
"""Largest magnitude of the coordinates of an anchor (pixels); larger values are certainly mistakes."""


def anchor_pixel(anchor: tuple[float, float], *, hair: float = 0.0) -> Pair:
    """Return ``anchor`` (row, column) rounded down to a pixel; values up to ``hair`` below an integer are rounded up.

    Raises
    ------
    InputError
        If a coordinate is not a number, or its magnitude exceeds `FARTHEST`.
    """
    for value in anchor:
        check_number("anchor (pixels)", value, at_least=-FARTHEST, at_most=FARTHEST)
    row, column = (int(np.floor(value + hair)) for value in anchor)
    return row, column


@dataclass(frozen=True)
class Grid:
    """Mapping of pixels to periods: pixel v has phase ``(v - anchor) mod n`` and lattice cell ``(v + origin) // n``.

    v and the period n are (row, column).

    Attributes
    ----------
    image_shape
        Rows and columns of the image and of every volume plane.
    period
        Period ``(ny, nx)`` of H (pixels).
    cutout
        Size ``(nt, ns)`` of a pattern (pixels); both are odd.
    anchor
        Pixel (row, column) whose phase is (0, 0); it may be outside the image.
    """

    image_shape: Pair
    period: Pair
    cutout: Pair
    anchor: Pair = (0, 0)

    def __post_init__(self) -> None:
        """Check every value."""
        check_cutout(*self.cutout)
        if len(self.image_shape) != 2 or min(self.image_shape) < 1:
            raise InputError.expected(
                "image shape", "positive numbers of rows and columns", self.image_shape, "correct the shape"
            )
        if min(self.period) < 1:
            raise InputError.expected("period", "a positive period (ny, nx)", self.period, "correct the period")

    @cached_property
    def origin(self) -> Pair:
        """Phase (row, column) of pixel (0, 0), which is its position in the first lattice cell."""
        return -self.anchor[0] % self.period[0], -self.anchor[1] % self.period[1]

    @cached_property
    def cells(self) -> Pair:
        """Number of lattice cells ``(Ly, Lx)`` that cover the image."""
        (oy, ox), (ny, nx), (height, width) = self.origin, self.period, self.image_shape
        # ceiling division
        return -(-(oy + height) // ny), -(-(ox + width) // nx)

    @cached_property
    def centre(self) -> Pair:
        """Index (row, column) of the centre pixel of the cutout."""
        return centre(self.cutout[0]), centre(self.cutout[1])

    @cached_property
    def reach(self) -> Pair:
        """Number of cells (down, across) by which a pattern extends to either side, at most one less than `cells`."""
        y, x = ((c + n - 1) // n for c, n in zip(self.centre, self.period, strict=True))
        # a pattern wider than the lattice cannot reach beyond it
        return min(y, self.cells[0] - 1), min(x, self.cells[1] - 1)

    @property
    def phases(self) -> int:
        """Number of source positions in one period."""
        return self.period[0] * self.period[1]

    @property
    def pixels(self) -> int:
        """Number of pixels of the image."""
        return self.image_shape[0] * self.image_shape[1]

    def pack(self, plane: NDArray[Any], dtype: Any, *, before: Pair = (0, 0), after: Pair = (0, 0)) -> NDArray[Any]:
        """Return ``plane`` as ``dtype``, zero-padded to the complete `cells`, ``(Ly*ny, Lx*nx)``.

        ``before`` and ``after`` are the numbers (rows, columns) of further zero pixels at the start and at the end.
        """
        (ny, nx), (cy, cx), (oy, ox) = self.period, self.cells, self.origin
        # zeros around the image, so that patterns of positions outside of it project to nothing
        out = np.zeros((before[0] + cy * ny + after[0], before[1] + cx * nx + after[1]), dtype)
        top, left = before[0] + oy, before[1] + ox
        out[top : top + self.image_shape[0], left : left + self.image_shape[1]] = plane
        return out

    def unpack(self, packed: NDArray[Any], *, before: Pair = (0, 0)) -> NDArray[Any]:
        """Return the image contained in ``packed`` as a view: the inverse of `pack` with the same ``before``."""
        top, left = before[0] + self.origin[0], before[1] + self.origin[1]
        return packed[top : top + self.image_shape[0], left : left + self.image_shape[1]]

    def tiled(self, pattern: NDArray[Any]) -> NDArray[Any]:
        """Return an image that repeats the period ``pattern`` ``(ny, nx)`` according to the phase of each pixel."""
        rows = (np.arange(self.image_shape[0]) + self.origin[0]) % self.period[0]
        columns = (np.arange(self.image_shape[1]) + self.origin[1]) % self.period[1]
        return pattern[np.ix_(rows, columns)]
