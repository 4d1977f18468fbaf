"""Patterns of all points of a volume above a window of the sensor, without a period, and sums over them.

Rotation and pitch of the array are visible in H only over a field of many lenslets. Every position of the window
therefore has a separate pattern.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import chunks, in_order, njit, worker_count
from lfcal.camera import ScanPlan
from lfcal.fit import PlaneModel, Setup
from lfcal.simulate import Sampling

__all__ = ["VoxelPatterns", "every_voxel", "patterns_at"]

F4 = NDArray[np.float32]

Voxels = tuple[NDArray[np.intp], NDArray[np.float64]]
"""Position (z, y, x) ``(n, 3)`` of each voxel, and its displacement (dy, dx) from there ``(n, 2)`` (pixels)."""

PARTS = 8
"""Number of parts of a sum, which does not depend on the workers, so that results are identical."""


@njit(fastmath={"contract", "reassoc"})
def _spread(values: F4, index: NDArray[np.intp], corners: NDArray[np.intp], weights: F4, out: F4) -> None:
    """Add ``weights[k, v] * values[index[v]]`` at ``corners[v]`` to image ``out[k]``, for all k and v."""
    _, rows, columns = values.shape
    for v in range(len(index)):
        top, left = corners[v, 0], corners[v, 1]
        for k in range(weights.shape[0]):
            weight = weights[k, v]
            if weight == 0:
                continue
            for t in range(rows):
                line = out[k, top + t, left : left + columns]
                pattern = values[index[v], t]
                for s in range(columns):
                    line[s] += weight * pattern[s]


@njit(fastmath={"contract", "reassoc"})
def _collect(values: F4, index: NDArray[np.intp], corners: NDArray[np.intp], images: F4, out: F4) -> None:
    """Set ``out[k, v]`` to the sum of ``values[index[v]]`` times the part of ``images[k]`` at ``corners[v]``."""
    _, rows, columns = values.shape
    for v in range(len(index)):
        top, left = corners[v, 0], corners[v, 1]
        for k in range(images.shape[0]):
            total = np.float32(0)
            for t in range(rows):
                line = images[k, top + t, left : left + columns]
                pattern = values[index[v], t]
                for s in range(columns):
                    total += line[s] * pattern[s]
            out[k, v] = total


@dataclass(frozen=True, eq=False)
class VoxelPatterns:
    """Patterns of voxels, as the columns of a matrix from a volume to an image.

    Attributes
    ----------
    places
        Voxels ``(n, 3)`` (z, y, x).
    offsets_px
        Displacement (dy, dx) of each voxel from its position, in pixels on the sensor ``(n, 2)``.
    values
        Patterns ``(m, nt, ns)``.
    index
        Index of the pattern of each voxel in ``values`` ``(n,)``.
    shape
        Rows and columns of the image, ``(ny + nt - 1, nx + ns - 1)`` for ``ny`` x ``nx`` positions. The pattern of
        position (y, x) begins at row y and column x.
    workers
        Number of threads.
    """

    places: NDArray[np.intp]
    offsets_px: NDArray[np.float64]
    values: F4
    index: NDArray[np.intp]
    shape: tuple[int, int]
    workers: int

    def __len__(self) -> int:
        """Return the number of voxels."""
        return len(self.places)

    def images(self, weights: F4) -> F4:
        """Return the images ``(k, rows, columns)`` of ``k`` volumes, given as values of the voxels ``(k, n)``."""
        corners = np.ascontiguousarray(self.places[:, 1:])
        weights = np.ascontiguousarray(weights, np.float32)

        def part(ends: tuple[int, int]) -> F4:
            own = slice(*ends)
            found = np.zeros((len(weights), *self.shape), np.float32)
            _spread(self.values, self.index[own], corners[own], np.ascontiguousarray(weights[:, own]), found)
            return found

        total = np.zeros((len(weights), *self.shape), np.float32)
        for found in in_order(part, chunks(len(self), PARTS), self.workers):
            total += found
        return total

    def sums(self, images: F4) -> F4:
        """Return the transpose of `images`: sums of ``images`` ``(k, rows, columns)`` over each pattern ``(k, n)``."""
        corners = np.ascontiguousarray(self.places[:, 1:])
        images = np.ascontiguousarray(images, np.float32)

        def part(ends: tuple[int, int]) -> F4:
            own = slice(*ends)
            found = np.empty((len(images), ends[1] - ends[0]), np.float32)
            _collect(self.values, self.index[own], corners[own], images, found)
            return found

        parts = list(in_order(part, chunks(len(self), PARTS), self.workers))
        return np.concatenate(parts or [np.empty((len(images), 0), np.float32)], axis=1)

    def of(self, keep: NDArray[np.bool_]) -> VoxelPatterns:
        """Return the patterns of the voxels in the mask ``keep`` ``(n,)``, without a copy of ``values``."""
        return replace(self, places=self.places[keep], offsets_px=self.offsets_px[keep], index=self.index[keep])


def every_voxel(plan: ScanPlan, *, halves: bool = False) -> Voxels:
    """Return all voxels of a plan whose period is a window; with ``halves``, four per position, half a pixel apart."""
    nz, ny, nx = plan.shape[:3]
    places = np.indices((nz, ny, nx), np.intp).reshape(3, -1).T.copy()
    steps = np.array([(0.0, 0.0)]) if not halves else np.array([(a, b) for a in (-0.25, 0.25) for b in (-0.25, 0.25)])
    return np.repeat(places, len(steps), axis=0), np.tile(steps, (len(places), 1))


def patterns_at(
    setup: Setup, plan: ScanPlan, voxels: Voxels, sampling: Sampling, workers: int | None = None
) -> VoxelPatterns:
    """Return the patterns of a setup at ``voxels`` of a window: see `VoxelPatterns`.

    Values are fractions of the light that passes the iris. The sampling stays fixed, so that differences of nearby
    setups are smooth.

    Raises
    ------
    InputError, EnergyError
        If the setup is impossible, or cannot be computed at ``sampling``.
    """
    (nt, ns), (ny, nx), count = plan.cutout, plan.period, worker_count(workers)
    places, offsets = voxels
    values = np.empty((len(places), nt, ns), np.float32)
    for z in np.unique(places[:, 0]).tolist():
        own = np.flatnonzero(places[:, 0] == z)
        model = PlaneModel(setup, plan, z, sampling)
        model.patterns(places[own[:1], 1:], np.zeros((1, 2)))  # tables are made before the threads start

        def part(ends: tuple[int, int], own: NDArray[np.intp] = own, model: PlaneModel = model) -> None:
            some = own[slice(*ends)]
            values[some] = model.patterns(places[some, 1:], offsets[some])

        for _ in in_order(part, chunks(len(own), 4 * count if count > 1 else 1), count):
            pass
    return VoxelPatterns(places, offsets, values, np.arange(len(places)), (ny + nt - 1, nx + ns - 1), count)
