"""Phases: positions of images in the period of the lenslet array, and the positions of a scan that they show."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from lfcal.camera import LensletLattice, ScanPlan

__all__ = ["Phases", "nearest_positions"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Phases:
    """The phases of a scan: its positions within the cells of the lenslet array.

    The array's period is not a whole number of pixels, and the array may be rotated and distorted. Patterns of distant
    cells therefore differ, although their positions are equal modulo the plan's period, which is rounded to whole
    pixels. A phase is computed in cells of the actual array, and then converted to pixels.

    Attributes
    ----------
    plan
        The scan of a single point.
    lattice
        The actual array, with its distortion.
    to_cells
        Matrix ``(2, 2)`` from lattice indices (q, r) to cells (y, x).
    period
        Height and width of a cell at the anchor (pixels).
    """

    plan: ScanPlan
    lattice: LensletLattice
    to_cells: Array
    period: Array

    @classmethod
    def of(cls, plan: ScanPlan) -> Phases:
        """Return the phases of a scan."""
        lattice, pixel = plan.cell_camera.lattice, plan.camera.sensor.pixel_um
        hexagonal = lattice.kind == "hexagonal"
        # a cell in lattice indices: three lens types repeat after three lenslets, a hexagonal array after two rows
        along = np.array([len(lattice.types) if hexagonal else 1, 0.0])
        across = np.array([-1.0, 2.0]) if hexagonal else np.array([0.0, 1.0])
        cells = [across, along]
        if lattice.quarter_turns % 2:
            cells.reverse()
        index = np.stack(cells) * np.array(plan.cells)[:, None]
        sides = index @ lattice.basis_um() / pixel
        # from the top and from the left, for any direction of the rows
        index *= np.sign([sides[0, 1], sides[1, 0]])[:, None]
        period = np.abs([sides[0, 1], sides[1, 0]])
        return cls(plan, plan.camera.periodic, np.linalg.inv(index), period)

    @property
    def count(self) -> int:
        """Number of positions in a plane."""
        return self.plan.period[0] * self.plan.period[1]

    def cells(self, pixels: ArrayLike) -> Array:
        """Return sensor positions relative to the anchor, as (y, x) in cells of the array.

        ``pixels`` ``(..., 2)`` contains the positions (row, column).
        """
        camera = self.plan.camera
        index = self.lattice.lenslet_at(camera.sensor_um(pixels))
        start = self.lattice.lenslet_at(camera.sensor_um(self.plan.anchor))
        cells: Array = (index - start) @ self.to_cells
        return cells

    def at(self, pixels: ArrayLike) -> Array:
        """Return the phases (y, x) of sensor positions: at least 0 and below the period (pixels).

        ``pixels`` ``(..., 2)`` contains the positions (row, column).
        """
        cells = self.cells(pixels)
        phases: Array = (cells - np.floor(cells)) * self.period
        # just below a whole cell, the fraction rounds to 1
        return np.where(phases >= self.period, 0.0, phases)

    def rates(self, pixels: Array, step: float = 1.0) -> Array:
        """Return the derivatives ``(n, 2, 2)`` of the phases with respect to the sensor position.

        ``pixels`` ``(n, 2)`` contains the positions (row, column), and ``step`` is the step of the difference quotients
        (pixels). The derivatives are the identity matrix for an upright, undistorted array.
        """
        columns = [(self.cells(pixels + e) - self.cells(pixels - e)) / (2 * step) for e in step * np.eye(2)]
        rates: Array = np.stack(columns, axis=-1) * self.period[:, None]
        return rates

    def wanted(self) -> Array:
        """Return the phases ``(ny * nx, 2)`` (y, x) of the scan's positions in row-major order (pixels)."""
        rows, columns = np.indices(self.plan.period).reshape(2, -1)
        return self.at(self.plan.image_px(np.stack([np.zeros_like(rows), rows, columns], axis=1)))

    def covered(self, pixels: Array, tolerance_px: float) -> NDArray[np.intp]:
        """Return the row-major indices of the positions that images at ``pixels`` ``(n, 2)`` match.

        An image matches a position if its phase deviates by at most ``tolerance_px`` in rows and in columns.
        """
        if not len(pixels):
            return np.zeros(0, np.intp)
        lists = self._tree.query_ball_point(self.at(pixels), tolerance_px + 1e-9, p=np.inf)
        return np.unique(np.concatenate([np.array(found, np.intp) for found in lists]))

    @cached_property
    def _tree(self) -> cKDTree:
        """Search tree of the phases of the scan's positions, periodic in both axes."""
        return cKDTree(self.wanted(), boxsize=self.period)


class Nearest(NamedTuple):
    """Positions ``(n, 2)`` as (y, x) with the phases nearest to those of n images.

    ``residual_px`` ``(n, 2)`` contains the phases of the images minus those of the positions.
    """

    positions: NDArray[np.intp]
    residual_px: NDArray[np.float64]


def nearest_positions(phases: Phases, pixels: ArrayLike) -> Nearest:
    """Return the position whose phase is nearest to that of each image.

    ``pixels`` ``(n, 2)`` contains the images (row, column) on the sensor.
    """
    wanted, found = phases.wanted(), phases.at(np.asarray(pixels, float).reshape(-1, 2))
    if not len(found):
        return Nearest(np.zeros((0, 2), np.intp), np.zeros((0, 2)))
    number = cKDTree(wanted, boxsize=phases.period).query(found, p=np.inf)[1]
    away = found - wanted[number]
    away -= phases.period * np.round(away / phases.period)
    return Nearest(np.stack(np.divmod(number, phases.plan.period[1]), axis=-1).astype(np.intp), away)
