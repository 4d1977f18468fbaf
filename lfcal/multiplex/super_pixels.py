"""Positions of the super-pixels of a light field on the sensor: a straight lattice of any pitch, angle and shear."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import check_choice, check_number, check_tuple

__all__ = ["SuperPixelLattice"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SuperPixelLattice:
    """Lattice of the super-pixels of a light field on the sensor.

    Attributes
    ----------
    kind
        ``"square"`` or ``"hexagonal"``.
    origin_px
        Centre ``(row, column)`` of the super-pixel with the indices (0, 0) (px).
    along_px
        Vector (x, y) from a super-pixel to the next one in its row (px).
    across_px
        Vector (x, y) from a super-pixel to one in the next row (px). In a hexagonal lattice, it includes a shift by
        half a pitch along the row.

    Examples
    --------
    >>> from lfcal.multiplex import SuperPixelLattice
    >>> lattice = SuperPixelLattice("hexagonal", origin_px=(8, 8), along_px=(10, 0), across_px=(5, 8.66))
    >>> print(lattice.pitch_px, round(lattice.row_pitch_px, 3))
    10.0 8.66
    >>> print(lattice.centres_px([0, 1], [1, 1]).round(2).tolist())  # (row, column)
    [[16.66, 13.0], [16.66, 23.0]]
    >>> print(lattice.lenslet_at(16.66, 23).round(2))
    [1. 1.]
    """

    kind: str
    origin_px: tuple[float, float]
    along_px: tuple[float, float]
    across_px: tuple[float, float]

    def __post_init__(self) -> None:
        """Check every value."""
        check_choice("lattice", self.kind, ("square", "hexagonal"))
        for name in ("origin_px", "along_px", "across_px"):
            object.__setattr__(self, name, check_tuple(name, getattr(self, name), 2))
        (ax, ay), (bx, by) = self.along_px, self.across_px
        check_number(
            "area of a super-pixel (px^2)",
            abs(ax * by - ay * bx),
            at_least=0.999,
            remedy="choose a period of at least 1 px",
        )

    @property
    def pitch_px(self) -> float:
        """Distance between adjacent super-pixels in a row (px)."""
        return math.hypot(*self.along_px)

    @property
    def row_pitch_px(self) -> float:
        """Perpendicular distance between adjacent rows (px)."""
        (ax, ay), (bx, by) = self.along_px, self.across_px
        # row distance is the cell's area divided by the pitch, for any angle of the two vectors
        return abs(ax * by - ay * bx) / self.pitch_px

    @property
    def rotation_rad(self) -> float:
        """Angle of the rows from the +x axis towards +y (rad)."""
        return math.atan2(self.along_px[1], self.along_px[0])

    def basis_px(self) -> Array:
        """Return the lattice vectors `along_px` and `across_px` as rows (x, y) of a ``(2, 2)`` array (px)."""
        return np.array([self.along_px, self.across_px])

    def centres_px(self, q: ArrayLike, r: ArrayLike) -> Array:
        """Return the centres (row, column) of the super-pixels with index q in row r, ``(..., 2)`` (px)."""
        q, r = np.asarray(q, float), np.asarray(r, float)
        (ax, ay), (bx, by) = self.along_px, self.across_px
        centres = np.empty((*np.broadcast_shapes(q.shape, r.shape), 2))
        centres[..., 0] = self.origin_px[0] + q * ay + r * by
        centres[..., 1] = self.origin_px[1] + q * ax + r * bx
        return centres

    def lenslet_at(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Return the fractional super-pixel indices (q, r), ``(..., 2)``, of sensor points (``row``, ``column``) in px.

        This is the inverse of `centres_px`.
        """
        points = np.stack(np.broadcast_arrays(np.asarray(row, float), np.asarray(column, float)), axis=-1)
        index: Array = (points - np.array(self.origin_px)) @ np.linalg.inv(self.basis_px()[:, ::-1])
        return index
