"""The micro-image centre next to a pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from lfcal.camera.description import Camera

__all__ = ["nearest_lens"]


def nearest_lens(camera: Camera, pixel: tuple[float, float]) -> tuple[float, float]:
    """Return the sensor position ``(row, column)`` of the type-0 micro-image centre nearest to ``pixel`` (pixels)."""
    lattice = camera.lattice
    point = camera.sensor_um(pixel)
    # one period in each direction holds at least one lenslet of each type
    reach = max(lattice.period_um)
    centres, types = lattice.lenslets_within(reach, reach, (float(point[0]), float(point[1])))
    centres = centres[types == 0]
    nearest = centres[np.argmin(np.hypot(*(centres - point).T))]
    x, y = (nearest - point) / camera.sensor.pixel_um
    return float(pixel[0] + y), float(pixel[1] + x)
