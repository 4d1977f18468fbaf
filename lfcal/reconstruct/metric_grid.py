"""Resample volumes to one voxel size, because behind a main lens the voxel size differs between planes.

A voxel of plane z is as wide as the step of the source that moves its image by one pixel. These steps increase with the
distance, by 3 to 12 % over usual depth ranges. Stacking the planes pixel by pixel would turn a cone into a cylinder.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, check_number
from lfcal.psf import PSFMatrix, voxel_um
from lfcal.reconstruct.resample import Resampling

__all__ = ["MetricGrid"]

Pair = tuple[float, float]

MOST_VOXELS = 1 << 31
"""Largest number of voxels of a volume; more are probably a mistake in the requested size."""

SMALLEST_UM = 1e-6
"""Smallest side of a voxel (µm); the number of smaller ones might overflow."""


@dataclass(frozen=True, eq=False)
class MetricGrid:
    """Grid of voxels of equal size around the optical axis, and the weights with which every plane is resampled to it.

    Attributes
    ----------
    voxel_um
        Side of a voxel, the same for rows and columns (µm).
    origin_um
        Position (row, column) of the centre of the first voxel, relative to the optical axis (µm).
    shape
        Number of voxels ``(Y, X)``; they cover the field of the widest plane.
    rows, columns
        Sparse matrices for each plane z: ``rows[z]`` ``(Y, y)`` contains the fraction of each row of the plane that is
        in each row of the grid. ``columns[z]`` ``(X, x)`` contains the same for columns.

    Examples
    --------
    Voxels of the second plane are 10 % wider, and so is its field.

    >>> from lfcal.reconstruct import MetricGrid
    >>> grid = MetricGrid.of([(10.0, 10.0), (11.0, 11.0)], shape=(60, 80), axis=(29.5, 39.5))
    >>> grid.voxel_um, grid.shape
    (10.0, (66, 88))
    """

    voxel_um: float
    origin_um: Pair
    shape: tuple[int, int]
    rows: tuple[Any, ...]
    columns: tuple[Any, ...]

    @classmethod
    def of(cls, sides_um: Sequence[Pair], shape: tuple[int, int], axis: Pair, voxel: float | None = None) -> MetricGrid:
        """Return the grid for planes of ``shape`` whose voxels have the sides ``sides_um``.

        Parameters
        ----------
        sides_um
            Voxel sides (rows, columns) of each plane (µm).
        shape
            Number of voxels ``(y, x)`` of each plane.
        axis
            Row and column of the optical axis in all planes (voxels of the planes, from the centre of the first).
        voxel
            Side of the grid's voxels (µm). None: the smallest voxel side of all planes.

        Raises
        ------
        InputError
            If ``voxel`` is invalid, or leads to too many voxels.
        """
        side = min(min(pair) for pair in sides_um) if voxel is None else voxel
        check_number("voxel (µm)", side, at_least=SMALLEST_UM)
        lows, counts = [], []
        for k in range(2):
            low = min((-axis[k] - 0.5) * pair[k] for pair in sides_um)
            high = max((shape[k] - axis[k] - 0.5) * pair[k] for pair in sides_um)
            lows.append(low)
            # slightly less, so that a field of whole voxels has no empty voxel at its end
            counts.append(max(1, math.ceil((high - low) / side - 1e-6)))
        if math.prod(counts) * len(sides_um) > MOST_VOXELS:
            got = f"{len(sides_um)} x {counts[0]} x {counts[1]}"
            raise InputError.expected("voxels of the volume", f"at most {MOST_VOXELS:,}", got, "choose larger voxels")
        matrices = [
            tuple(_shares(shape[k], axis[k], pair[k], lows[k], counts[k], side) for pair in sides_um) for k in range(2)
        ]
        origin = (lows[0] + side / 2, lows[1] + side / 2)
        return cls(side, origin, (counts[0], counts[1]), matrices[0], matrices[1])

    @classmethod
    def for_matrix(
        cls,
        matrix: PSFMatrix,
        shape: tuple[int, int],
        anchor: Pair | None = None,
        voxel: float | None = None,
        view: Resampling | None = None,
    ) -> MetricGrid:
        """Return the grid for volumes that are reconstructed with H from images of ``shape``.

        Parameters
        ----------
        matrix
            H with its camera.
        shape
            Shape ``(y, x)`` of the image, and of each plane of the volume.
        anchor
            Pixel (row, column) of the image onto which H's position (0, 0) is imaged. None: the anchor of H. A
            different anchor means that the image shows another part of the sensor. For an image of the entire sensor,
            whole periods of the difference are ignored.
        voxel
            Side of the grid's voxels (µm). None: the smallest voxel side of all planes.
        view
            Resampling of frames of the entire sensor to the image, which locates the optical axis instead of
            ``anchor``. None: the image is not resampled.

        Raises
        ------
        InputError
            If H has no camera; also as in `of`.
        """
        if matrix.camera is None:
            raise InputError.expected(
                "voxels of a fixed size", "an H with its camera", "an H without one", "leave the voxel size out"
            )
        sides = [voxel_um(matrix, float(z)) for z in matrix.depths]
        middle, scale = matrix.camera.pixels((0.0, 0.0)), matrix.pixel_scale
        known = [side for side in sides if side is not None]
        if view is not None:
            return cls.of(known, shape, view.pixel((float(middle[0]), float(middle[1]))), voxel)
        axis = []
        for k in range(2):
            moved = 0.0 if anchor is None else anchor[k] - matrix.anchor[k]
            if abs(shape[k] - matrix.camera.sensor.shape[k] * scale[k]) < 1:
                # the whole sensor: another anchor names the same position, whole periods on
                moved = math.remainder(moved, matrix.period[k])
            axis.append(float(middle[k]) * scale[k] + moved)
        return cls.of(known, shape, (axis[0], axis[1]), voxel)

    def apply(self, volume: NDArray[Any]) -> NDArray[np.float32]:
        """Return a volume ``(nz, y, x)`` resampled to the grid, ``(nz, Y, X)``; the sum of each plane is conserved.

        Raises
        ------
        InputError
            If the shape of ``volume`` is not that for which the grid was made.
        """
        wanted = (len(self.rows), self.rows[0].shape[1], self.columns[0].shape[1])
        if volume.shape != wanted:
            raise InputError.expected("volume", f"shape {wanted}", volume.shape, "give a volume of this grid")
        out = np.empty((len(self.rows), *self.shape), np.float32)
        for z, (rows, columns) in enumerate(zip(self.rows, self.columns, strict=True)):
            out[z] = (columns @ (rows @ volume[z].astype(np.float64)).T).T
        return out


def _shares(count: int, axis: float, width: float, low: float, cells: int, side: float) -> Any:
    """Return the fraction of each of ``count`` pixels that falls into each of ``cells`` voxels, ``(cells, count)``."""
    edges = (np.arange(count + 1) - axis - 0.5) * width
    first = np.clip(np.floor((edges[:-1] - low) / side).astype(np.int64), 0, cells - 1)
    last = np.clip(np.ceil((edges[1:] - low) / side).astype(np.int64), 1, cells)
    most = int((last - first).max())
    cell = first[:, None] + np.arange(most)
    left, right = low + cell * side, low + (cell + 1) * side
    # the grid ends with the widest plane; light beyond it due to rounding belongs to the last voxel
    left, right = np.where(cell == 0, -np.inf, left), np.where(cell == cells - 1, np.inf, right)
    shared = np.minimum(right, edges[1:, None]) - np.maximum(left, edges[:-1, None])
    inside = (shared > 0) & (cell < cells)
    pixel = np.broadcast_to(np.arange(count)[:, None], cell.shape)
    values = (shared / width)[inside]
    from scipy import sparse  # slow to import

    return sparse.csr_array((values, (cell[inside], pixel[inside])), shape=(cells, count))
