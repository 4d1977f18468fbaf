"""Sides of H's pixels and of the voxels that its positions represent."""

from __future__ import annotations

import numpy as np

from lfcal.psf.matrix import PSFMatrix

__all__ = ["pixel_um", "voxel_um"]

Pair = tuple[float, float]


def pixel_um(matrix: PSFMatrix) -> Pair | None:
    """Return the sides (rows, columns) of a pixel of H's images on the sensor (µm); None: H has no camera.

    Frames that were resampled onto a whole period have other pixels than the sensor, along each axis.
    """
    return None if matrix.camera is None else _scaled(matrix.camera.sensor.pixel_um, matrix.pixel_scale)


def voxel_um(matrix: PSFMatrix, depth_um: float | None = None) -> Pair | None:
    """Return the sides (rows, columns) of a voxel in object space (µm): a pixel's step of the source.

    None where H has no camera. Behind a main lens steps grow with distance; by default it is the median depth's.
    """
    if matrix.camera is None:
        return None
    at = float(np.median(matrix.depths)) if depth_um is None else depth_um
    return _scaled(matrix.camera.step_um(at), matrix.pixel_scale)


def _scaled(size: float, scale: Pair) -> Pair:
    return size / scale[0], size / scale[1]
