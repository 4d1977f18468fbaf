"""Effects of the pixels on every response: light-sensitive area and crosstalk."""

from __future__ import annotations

import math
from collections.abc import Mapping
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

    Light beside the square is lost, and the pixel blurs less.

    Attributes
    ----------
    fill_factor
        Light-sensitive share of a pixel's area; None takes the camera's.
    """

    fill_factor: float | None = None

    name: ClassVar[str] = "pixel_fill"
    units: ClassVar[Mapping[str, str]] = {"fill_factor": "share"}
    titles: ClassVar[Mapping[str, str]] = {"fill_factor": "sensitive area"}
    described: ClassVar[Mapping[str, str]] = {"fill_factor": "sensor.fill_factor"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"fill_factor": (1e-6, 1.0)}
    title: ClassVar[str] = "pixel integration and fill factor"
    rank: ClassVar[int] = 90

    def share(self, camera: Camera) -> float:
        """Return the light-sensitive share of a pixel's area."""
        share: float = self.magnitude("fill_factor", camera)
        return share

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the sensitive share, and the larger of the light lost and the blur that is less."""
        share = self.share(outlook.camera)
        sharper = outlook.blurred(math.sqrt((1.0 - share) / 12.0))
        error = min(2.0, max((1.0 - share) / share, sharper))
        return Estimate(share, "of the area", error, "(1 - fill)/fill, at least 0.74 (1 - fill)/(12 w²)")

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
    units: ClassVar[Mapping[str, str]] = {"share": "share"}
    titles: ClassVar[Mapping[str, str]] = {"share": "to each neighbour"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"share": (0.0, 0.25)}
    title: ClassVar[str] = "pixel crosstalk"
    deviation: ClassVar[bool] = True

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the share and the blur it makes: a variance of 2 x per axis, on spots of at least 0.4 px.

        Light that is all in one pixel changes by 8 x, which a Gaussian of 0.43 px does too.
        """
        error = outlook.blurred(math.sqrt(2.0 * self.share), floor_px=0.41)
        return Estimate(self.share, "per neighbour", error, "0.74 * 2 x/(w² + 0.17)")

    def kernel(self, camera: Camera) -> NDArray[np.float64]:
        """Return the 3 x 3 kernel, the product of two three-point kernels."""
        del camera
        # A product of two lines, so that the diagonal neighbours get the square of the share.
        line = np.array([self.share, 1.0 - 2.0 * self.share, self.share])
        return np.outer(line, line)


EFFECTS = (PixelFill, Crosstalk)
