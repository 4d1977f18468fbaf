"""Compute the images of a target's holes on the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera
from lfcal.targets.target import Target

__all__ = ["HoleImages", "hole_images", "whole_at"]


@dataclass(frozen=True, eq=False)
class HoleImages:
    """The images of a target's holes in one frame.

    Attributes
    ----------
    holes
        Labels ``(n, 2)`` as (row, column) of the target.
    pixels
        Position ``(n, 2)`` at which each chief ray meets the sensor (row, column; pixels); integers are pixel centres.
    away_um
        Depth of each hole ``(n,)`` (µm); the depths differ if the target is tilted.
    shift
        Motion of each image ``(n,)`` (pixels) if images of points in the depth plane move by one pixel.
    """

    holes: NDArray[np.intp]
    pixels: NDArray[np.float64]
    away_um: NDArray[np.float64]
    shift: NDArray[np.float64]

    def __len__(self) -> int:
        """Return the number of holes."""
        return len(self.holes)

    def moved(self, offset_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``pixels`` after images in the depth plane have moved by ``offset_px`` (rows, columns; px)."""
        moved: NDArray[np.float64] = self.pixels + self.shift[:, None] * offset_px
        return moved

    def whole(
        self, sensor: tuple[int, int], cutout: tuple[int, int], offset_px: tuple[float, float] = (0.0, 0.0)
    ) -> NDArray[np.bool_]:
        """Return a mask ``(n,)`` of the holes whose cutouts around the nearest pixel are completely on the sensor.

        ``sensor`` and ``cutout`` are (rows, columns). The images have moved by ``offset_px``, as in `moved`.
        """
        return whole_at(self.moved(np.array(offset_px)), sensor, cutout)

    def only(self, which: NDArray[np.bool_]) -> HoleImages:
        """Return the images selected by a mask ``(n,)``."""
        return HoleImages(self.holes[which], self.pixels[which], self.away_um[which], self.shift[which])


def hole_images(target: Target, camera: Camera, z_um: float) -> HoleImages:
    """Return the images of all holes of ``target`` at the depth plane ``z_um`` (µm), on the sensor or outside it.

    The chief ray is computed as for a scan (`lfcal.camera.ScanPlan.object_um`), at each hole's own depth.

    Raises
    ------
    InputError
        If a hole is at a position that the camera does not image.
    """
    placed = target.pose.points(target.flat_um(target.holes))
    away = z_um + placed[:, 2]
    steps = _steps(camera, away)
    pixels = np.array(camera.sensor.centre_px) + placed[:, 1::-1] / steps[:, None]
    return HoleImages(target.holes, pixels, away, camera.step_um(z_um) / steps)


def whole_at(pixels: NDArray[np.float64], sensor: tuple[int, int], cutout: tuple[int, int]) -> NDArray[np.bool_]:
    """Return a mask ``(...)`` of the positions ``pixels`` ``(..., 2)`` whose cutouts are completely on the sensor."""
    middle = np.floor(pixels + 0.5)
    half = (np.array(cutout) - 1) // 2
    inside: NDArray[np.bool_] = ((middle >= half) & (middle <= np.array(sensor) - 1 - half)).all(axis=-1)
    return inside


def _steps(camera: Camera, away_um: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `Camera.step_um` at many depths; it is a linear function of depth."""
    near, far = float(away_um.min()), float(away_um.max())
    first, last = camera.step_um(near), camera.step_um(far)
    if far == near:
        return np.full(away_um.shape, first)
    steps: NDArray[np.float64] = first + (away_um - near) * ((last - first) / (far - near))
    return steps
