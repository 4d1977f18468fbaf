"""Effects of the pixels on every response: light-sensitive area and crosstalk."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera
from lfcal.simulate.effects.base import Estimate, PsfEffect, SceneEffect
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.scene import Scene

__all__ = ["Crosstalk", "PixelFill"]


@dataclass(frozen=True, slots=True)
class PixelFill(SceneEffect):
    """Pixels whose light-sensitive square is smaller than their pitch; without it they fill it.

    Values are the mean over the sensitive square times the pixel's area: the light is the same, the blur less.

    Attributes
    ----------
    fill_factor
        Light-sensitive share of a pixel's area; None takes the camera's.
    """

    fill_factor: float | None = None

    name: ClassVar[str] = "pixel_fill"
    title: ClassVar[str] = "pixel integration and fill factor"

    def share(self, camera: Camera) -> float:
        """Return the light-sensitive share of a pixel's area."""
        return camera.sensor.fill_factor if self.fill_factor is None else self.fill_factor

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the sensitive share and the change of width when 1/12 px² of variance becomes share/12."""
        share = self.share(outlook.camera)
        error = outlook.blurred(math.sqrt((1.0 - share) / 12.0))
        return Estimate(share, "of the area", error, "0.74 (1 - fill)/(12 w²)")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return the scene with the smaller sensitive square."""
        return replace(scene, pixel_fill=math.sqrt(self.share(outlook.camera)))


@dataclass(frozen=True, slots=True)
class Crosstalk(PsfEffect):
    """Light that is collected by a neighbouring pixel.

    Attributes
    ----------
    share
        Share that goes to each of the four nearest neighbours; the diagonal ones get its square.
    """

    share: float = 0.01

    name: ClassVar[str] = "crosstalk"
    title: ClassVar[str] = "pixel crosstalk"
    deviation: ClassVar[bool] = True

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the share and the blur it makes: a variance of 2 x per axis."""
        error = outlook.blurred(math.sqrt(2.0 * self.share))
        return Estimate(self.share, "per neighbour", error, "0.74 * 2 x/w²")

    def kernel(self, camera: Camera) -> NDArray[np.float64]:
        """Return the 3 x 3 kernel, the product of two three-point kernels."""
        del camera
        line = np.array([self.share, 1.0 - 2.0 * self.share, self.share])
        return np.outer(line, line)
