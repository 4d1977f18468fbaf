"""Effects that vary over the field: cos^4 fall-off and mechanical vignetting."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera, MainLens
from lfcal.simulate.effects.base import Estimate, FrameEffect, SceneEffect, SensorStrip
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.scene import Scene

__all__ = ["CosFourth", "MechanicalVignetting"]


@dataclass(frozen=True, slots=True)
class CosFourth(FrameEffect):
    """Natural fall-off of illuminance with the fourth power of the cosine of the field angle; 1 on the axis.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import CosFourth
    >>> corner = CosFourth().gain(preset("r29"), row=0, rows=1)[0, 0]
    >>> round(float(corner), 3)  # of the light on the axis
    0.985
    """

    name: ClassVar[str] = "cos4"
    title: ClassVar[str] = "cos^4 fall-off"
    rank: ClassVar[int] = 10

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the loss 1 - cos^4 at the rms distance of the light from the axis, both as size and as error.

        For a telecentric camera, both are 0.
        """
        optics = outlook.camera.optics
        if optics.telecentric:
            return Estimate(0.0, "relative", 0.0, "telecentric")
        field = math.hypot(*outlook.field_um)
        r = math.hypot(field, outlook.field_rms_px * outlook.pixel_um)
        loss = 1.0 - math.cos(math.atan(r / optics.image_distance_um)) ** 4
        return Estimate(loss, "relative", loss, "1 - cos^4(r_rms/b)")

    def gain(self, camera: Camera, row: int, rows: int) -> NDArray[np.float32]:
        """Return the gain of the ``rows`` sensor rows from index ``row``, shape ``(rows, columns)``; 1 on the axis.

        For a telecentric camera, whose gain is 1 everywhere, the shape is ``(1, 1)``.
        """
        optics, sensor = camera.optics, camera.sensor
        if optics.telecentric:
            return np.ones((1, 1), np.float32)
        unit = sensor.pixel_um / optics.image_distance_um
        y = (np.arange(row, row + rows) - sensor.centre_px[0]) * unit
        x = (np.arange(sensor.shape[1]) - sensor.centre_px[1]) * unit
        return ((1.0 + (y * y)[:, None] + x * x) ** -2.0).astype(np.float32)

    def on_frame(self, strip: NDArray[np.float32], view: SensorStrip) -> NDArray[np.float32]:
        """Multiply ``strip`` (electrons) in place by `gain`, and return it."""
        strip *= self.gain(view.camera, view.row, len(strip))
        return strip


@dataclass(frozen=True, slots=True)
class MechanicalVignetting(SceneEffect):
    """A rim of the lens barrel that clips the pupil seen from off-axis points (cat's-eye vignetting).

    Attributes
    ----------
    distance_um
        Distance from the pupil to the rim along the axis (µm).
    radius
        Ratio of the radius of the rim to that of the pupil, both as seen from the sensor.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import MechanicalVignetting, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), (127, 127), (55, 95), field_um=(0.0, 10e3))
    >>> found = MechanicalVignetting(distance_um=100e3, radius=1.0).estimate(plane)
    >>> print(f"rim {found.size:.2f} {found.unit}: light lost over light left {found.error:.0%}")
    rim 0.16 pupil radii off axis: light lost over light left 11%
    """

    distance_um: float = 30e3
    radius: float = 1.05

    name: ClassVar[str] = "vignetting"
    changes_work: ClassVar[bool] = True
    units: ClassVar[Mapping[str, str]] = {"radius": "pupil radii"}
    titles: ClassVar[Mapping[str, str]] = {"distance_um": "from pupil to rim", "radius": "radius of the rim"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"radius": (1e-3, math.inf)}
    title: ClassVar[str] = "mechanical vignetting"
    rank: ClassVar[int] = 65
    deviation: ClassVar[bool] = True

    def shift(self, outlook: Outlook) -> tuple[float, float]:
        """Return the shift ``(y, x)`` of the rim relative to the pupil (pupil radii); zero without a main lens.

        It is the shift that is seen from the middle of the region.
        """
        optics = outlook.camera.optics
        if not isinstance(optics, MainLens):
            return 0.0, 0.0
        # the rim moves across the pupil in proportion to its distance from the pupil (whose radius is f/(2 N))
        unit = self.distance_um / optics.image_distance_um * 2.0 * optics.f_number / optics.focal_length_um
        return outlook.field_um[0] * unit, outlook.field_um[1] * unit

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the shift of the rim (pupil radii), and the ratio of the lost light to the remaining light."""
        shift = math.hypot(*self.shift(outlook))
        kept = overlap(shift, self.radius)
        error = min(2.0, (1.0 - kept) / max(kept, 1e-9))
        return Estimate(shift, "pupil radii off axis", error, "overlap of two discs; 1.27 s/D for equal ones")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with the rim as a second stop, or unchanged if the rim clips no light."""
        y, x = self.shift(outlook)
        # a stop that cuts nothing would still lose the symmetry and the tables of a circular pupil
        if overlap(math.hypot(y, x), self.radius) >= 1.0:
            return scene
        return replace(scene, iris=replace(scene.iris, stop=(x, y, self.radius)))


def overlap(distance: float, radius: float) -> float:
    """Return the fraction of a unit disc that a disc of ``radius`` covers, with ``distance`` between the centres."""
    d, r = distance, radius
    if d >= 1.0 + r:
        return 0.0
    if d <= abs(r - 1.0):
        return min(1.0, r * r)
    # at tangency, rounding makes the cosines exceed 1 and the kite negative
    a = math.acos(min(1.0, max(-1.0, (d * d + 1 - r * r) / (2 * d))))
    b = math.acos(min(1.0, max(-1.0, (d * d + r * r - 1) / (2 * d * r))))
    kite = 0.5 * math.sqrt(max(0.0, (1 + r - d) * (d + 1 - r) * (d + r - 1) * (d + r + 1)))
    return (a + r * r * b - kite) / math.pi


EFFECTS = (CosFourth, MechanicalVignetting)
