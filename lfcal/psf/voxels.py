"""Sizes of H's pixels and of the voxels at its positions."""

from __future__ import annotations

import numpy as np

from lfcal.psf.matrix import PSFMatrix

__all__ = ["pixel_um", "voxel_um"]

Pair = tuple[float, float]


def pixel_um(matrix: PSFMatrix) -> Pair | None:
    """Return the height and width of a pixel of H's images on the sensor (µm); None: H has no camera.

    If frames were resampled to a whole period, H's pixels differ from the sensor's pixels along each axis.
    """
    return None if matrix.camera is None else _scaled(matrix.camera.sensor.pixel_um, matrix.pixel_scale)


def voxel_um(matrix: PSFMatrix, depth_um: float | None = None) -> Pair | None:
    """Return the height and width of a voxel in object space (µm): the step of the source for one pixel.

    It is None if H has no camera. Behind a main lens, steps grow with distance; by default, the median depth is used.
    """
    if matrix.camera is None:
        return None
    at = float(np.median(matrix.depths)) if depth_um is None else depth_um
    return _scaled(matrix.camera.step_um(at), matrix.pixel_scale)


def _scaled(size: float, scale: Pair) -> Pair:
    return size / scale[0], size / scale[1]
