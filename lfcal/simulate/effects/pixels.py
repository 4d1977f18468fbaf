"""Effects of the pixels on every response: light-sensitive area, crosstalk, and response to angles."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera
from lfcal.simulate.effects.base import EngineSeconds, Estimate, PsfEffect, SceneEffect
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.scene import Scene

__all__ = ["AngularResponse", "Crosstalk", "PixelFill"]


@dataclass(frozen=True, slots=True)
class PixelFill(SceneEffect):
    """Pixels whose light-sensitive square is smaller than the pitch; without this effect, it is as wide as the pitch.

    Light that falls outside the square is lost, and each pixel averages over a smaller area.

    Attributes
    ----------
    fill_factor
        Fill factor, the light-sensitive fraction of a pixel's area (0 to 1). None: that of the camera.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Outlook, PixelFill
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = PixelFill(0.8).estimate(plane)
    >>> print(f"{found.error:.0%} of the light that is left")  # 0.2/0.8
    25% of the light that is left
    """

    fill_factor: float | None = None

    name: ClassVar[str] = "pixel_fill"
    units: ClassVar[Mapping[str, str]] = {"fill_factor": "share"}
    titles: ClassVar[Mapping[str, str]] = {"fill_factor": "sensitive area"}
    described: ClassVar[Mapping[str, str]] = {"fill_factor": "sensor.fill_factor"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"fill_factor": (1e-6, 1.0)}
    title: ClassVar[str] = "pixel integration and fill factor"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 90

    def share(self, camera: Camera) -> float:
        """Return the fill factor, the light-sensitive fraction of a pixel's area."""
        share: float = self.magnitude("fill_factor", camera)
        return share

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the fill factor, and the larger of the relative errors due to loss of light and to sharper spots."""
        share = self.share(outlook.camera)
        sharper = outlook.blurred(math.sqrt((1.0 - share) / 12.0))
        error = min(2.0, max((1.0 - share) / share, sharper))
        return Estimate(share, "of the area", error, "(1 - fill)/fill, at least 0.74 (1 - fill)/(12 w²)")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with the smaller light-sensitive squares."""
        return replace(scene, pixel_fill=math.sqrt(self.share(outlook.camera)))


@dataclass(frozen=True, slots=True)
class Crosstalk(PsfEffect):
    """Signal of one pixel that appears in neighbouring pixels.

    Attributes
    ----------
    share
        Fraction x of a pixel's light that each of its two neighbours along an axis receives. In two dimensions, each of
        the four nearest pixels receives x (1 - 2 x), and each diagonal neighbour x².

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Crosstalk
    >>> print(Crosstalk(0.1).kernel(preset("r29")).round(2))
    [[0.01 0.08 0.01]
     [0.08 0.64 0.08]
     [0.01 0.08 0.01]]
    """

    share: float = 0.01

    name: ClassVar[str] = "crosstalk"
    units: ClassVar[Mapping[str, str]] = {"share": "share"}
    titles: ClassVar[Mapping[str, str]] = {"share": "to each neighbour"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"share": (0.0, 0.25)}
    title: ClassVar[str] = "pixel crosstalk"
    without_lattice: ClassVar[bool] = True
    deviation: ClassVar[bool] = True
    measured_by: ClassVar[str] = "crosstalk"

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the fraction x, and the relative error due to a blur with a variance of 2 x px² along each axis.

        An rms width of 0.41 px is added in quadrature to that of the spots, because pixels do not resolve narrower
        ones. If all light is in a single pixel, the error is 8 x, as for a Gaussian of 0.43 px rms.
        """
        error = outlook.blurred(math.sqrt(2.0 * self.share), floor_px=0.41)
        return Estimate(self.share, "per neighbour", error, "0.74 * 2 x/(w² + 0.17)")

    def kernel(self, camera: Camera) -> NDArray[np.float64]:
        """Return the kernel ``(3, 3)``, the outer product of (x, 1 - 2 x, x) with itself; its sum is 1."""
        del camera
        # a product of two lines, so that the diagonal neighbours get the square of the share.
        line = np.array([self.share, 1.0 - 2.0 * self.share, self.share])
        return np.outer(line, line)


@dataclass(frozen=True, slots=True)
class AngularResponse(SceneEffect):
    """Lower response of pixels to oblique light: cos^n of the angle of incidence on the sensor.

    Attributes
    ----------
    half_angle_rad
        Angle of incidence at which the response is half of that at normal incidence (rad).

    Examples
    --------
    >>> from math import cos, radians
    >>> from lfcal.simulate.effects import AngularResponse
    >>> power = AngularResponse(radians(25.0)).power
    >>> [round(cos(radians(angle)) ** power, 2) for angle in (0, 10, 25)]
    [1.0, 0.9, 0.5]
    """

    half_angle_rad: float = math.radians(25.0)

    name: ClassVar[str] = "angular_response"
    changes_work: ClassVar[bool] = True
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"half_angle_rad": (0.01, 1.57)}
    title: ClassVar[str] = "pixels' response to angles"
    rank: ClassVar[int] = 91
    deviation: ClassVar[bool] = True

    @property
    def power(self) -> float:
        """Exponent n of the response cos^n."""
        return math.log(0.5) / math.log(math.cos(self.half_angle_rad))

    def slope(self, outlook: Outlook) -> tuple[float, float]:
        """Return the direction sines (y, x) of the chief ray to the middle of the region."""
        y, x = outlook.field_um
        away = math.hypot(outlook.camera.optics.image_distance_um, y, x)
        return y / away, x / away

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the half-response angle (°), and the ratio of lost to remaining light at the rms incidence angle."""
        focal = outlook.camera.lattice.types[0].focal_length_um
        bend = outlook.lit_px * outlook.pixel_um * abs(1 / outlook.shift_um + 1 / focal)
        near = min(1.0, abs(outlook.virtual_depth))  # near the native plane, a lenslet receives the whole cone
        square = (0.5 / outlook.f_number) ** 2 / 2 + near * bend * bend / 2
        square += sum(s * s for s in self.slope(outlook))
        kept = max(1e-9, 1.0 - min(square, 1.0)) ** (self.power / 2)
        error = min(2.0, (1.0 - kept) / kept)
        return Estimate(math.degrees(self.half_angle_rad), "° to half", error, "1 - cos^n of the rms angle")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with this angular response about the chief ray to the middle of the region."""
        return replace(scene, accept=(self.power, *self.slope(outlook)))

    def seconds(self, outlook: Outlook, engine: EngineSeconds) -> float:
        """Return the CPU time for weighting the light by its angle (s): that of the wave engine (measured)."""
        del outlook
        return engine.waves


EFFECTS = (PixelFill, AngularResponse, Crosstalk)
