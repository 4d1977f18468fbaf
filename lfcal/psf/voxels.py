"""Sizes of the pixels of H and of the corresponding voxels."""

from __future__ import annotations

import numpy as np

from lfcal.psf.matrix import PSFMatrix

__all__ = ["pixel_um", "voxel_um"]

Pair = tuple[float, float]


def pixel_um(matrix: PSFMatrix) -> Pair | None:
    """Return the height and the width of a pixel of H's images on the sensor (µm); None if H has no camera.

    Frames may have been resampled such that the lenslet period is a whole number of pixels. The pixels of H then differ
    in size from those of the sensor.
    """
    return None if matrix.camera is None else _scaled(matrix.camera.sensor.pixel_um, matrix.pixel_scale)


def voxel_um(matrix: PSFMatrix, depth_um: float | None = None) -> Pair | None:
    """Return the height and the width of a voxel in object space (µm); None if H has no camera.

    A voxel is as large as the lateral step of the source that moves the image by one pixel of H. For a main lens, the
    step grows with the distance from the lens. ``depth_um`` is the depth (µm); None: the median depth of the planes.
    """
    if matrix.camera is None:
        return None
    at = float(np.median(matrix.depths)) if depth_um is None else depth_um
    return _scaled(matrix.camera.step_um(at), matrix.pixel_scale)


def _scaled(size: float, scale: Pair) -> Pair:
    return size / scale[0], size / scale[1]
