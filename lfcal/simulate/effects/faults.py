"""Faults of the recorded light: ghosts and the nonlinearity of the sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.simulate.effects.base import Estimate, FrameEffect, SensorStrip
from lfcal.simulate.effects.outlook import Outlook

__all__ = ["Ghost", "SensorNonlinearity"]


@dataclass(frozen=True, slots=True)
class SensorNonlinearity(FrameEffect):
    """Nonlinearity of the sensor: a charge of e electrons is read as e (1 - q e/full well).

    Attributes
    ----------
    share
        Fraction q of the signal that is missing at full well. A negative fraction increases the signal. Above the full
        well, the missing fraction is constant.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate import expose
    >>> from lfcal.simulate.effects import SensorNonlinearity
    >>> camera = preset("bench")
    >>> full = np.full(camera.sensor.shape, camera.sensor.full_well_e, np.float32)
    >>> bent, straight = (expose(full, camera, some, exposure_s=0.02) for some in ([SensorNonlinearity(0.02)], []))
    >>> black = camera.sensor.black_level
    >>> round(float((bent[0, 0] - black) / (straight[0, 0] - black)), 3)
    0.98
    """

    share: float = 0.02

    name: ClassVar[str] = "nonlinearity"
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"share": (-0.5, 0.5)}
    units: ClassVar[Mapping[str, str]] = {"share": "share"}
    title: ClassVar[str] = "sensor nonlinearity"
    without_lattice: ClassVar[bool] = True
    # acts on the collected charge, which the well has limited; read noise is added later
    rank: ClassVar[int] = 67
    deviation: ClassVar[bool] = True

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return |q|, and the relative error for Gaussian spots.

        The mean signal of a Gaussian spot, weighted by the signal itself, is half of its peak.
        """
        full, sharp = outlook.camera.sensor.full_well_e, min(outlook.widths_px)

        def lost(width: float) -> float:
            # the mean of e² over the mean of e is half the peak; above the full well, the share is constant
            return min(1.0, 0.5 * outlook.peak_e / full * (sharp / width) ** 2)

        error = self.share * outlook.over_types(lost)
        return Estimate(abs(self.share), "of full well", abs(error) / (1.0 - error), "q peak/(2 full well) (w_min/w)²")

    def on_frame(self, strip: NDArray[np.float32], view: SensorStrip) -> NDArray[np.float32]:
        """Apply the nonlinearity to ``strip`` (electrons) in place, and return it."""
        if self.share:
            full = np.float32(view.camera.sensor.full_well_e)
            # clipped, so that more light never gives a lower value
            strip *= 1 - np.float32(self.share) * np.clip(strip / full, 0, 1)
        return strip


@dataclass(frozen=True, slots=True)
class Ghost(FrameEffect):
    """A faint second image due to reflections in the lens: the frame mirrored about the axis, scaled and shifted.

    Attributes
    ----------
    share
        Light of the ghost as a fraction of the frame's light, 0 to 1. The ghost is added; the image keeps its light.
    scale
        Lateral size of the ghost relative to that of the image.
    rows_um, columns_um
        Position (y and x, µm) of the ghost of a point on the optical axis, relative to the axis on the sensor.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate import expose
    >>> from lfcal.simulate.effects import Ghost
    >>> camera = preset("bench")
    >>> light = np.zeros(camera.sensor.shape, np.float32)
    >>> light[100, 50] = 10e3
    >>> frame = expose(light, camera, [Ghost(0.01)], exposure_s=0.02)
    >>> np.argwhere(frame > 70).tolist()  # mirrored about the middle of 320 x 320 pixels
    [[100, 50], [219, 269]]
    """

    share: float = 0.005
    scale: float = 1.0
    rows_um: float = 0.0
    columns_um: float = 0.0

    name: ClassVar[str] = "ghost"
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"share": (0.0, 1.0), "scale": (0.01, 100.0)}
    units: ClassVar[Mapping[str, str]] = {"share": "share", "scale": ""}
    title: ClassVar[str] = "ghost image"
    rank: ClassVar[int] = 15
    deviation: ClassVar[bool] = True
    pixel_ns: ClassVar[float] = 30.0

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return ``share``, and the relative error: the part of this fraction that falls in the cutout, often zero."""
        seen, px = 1.0, outlook.pixel_um
        moved = self.rows_um, self.columns_um
        for field, place, pixels in zip(outlook.field_um, moved, outlook.cutout, strict=True):
            apart, half = abs(place - (1.0 + self.scale) * field) / px, outlook.pattern_px * self.scale
            overlap = min(apart + half, pixels / 2) - max(apart - half, -pixels / 2)
            seen *= min(1.0, max(0.0, overlap) / (2.0 * half))
        formula = "fraction of the ghost in the cutout" if seen else "outside the cutout"
        return Estimate(self.share, "of the light", self.share * seen, formula)

    def on_frame(self, strip: NDArray[np.float32], view: SensorStrip) -> NDArray[np.float32]:
        """Add the ghost of ``view.light_e`` to ``strip`` (electrons) in place, and return it."""
        if not self.share:
            return strip
        sensor = view.camera.sensor
        rows = self._edges(view.row, len(strip), sensor.centre_px[0], self.rows_um / sensor.pixel_um)
        columns = self._edges(0, strip.shape[1], sensor.centre_px[1], self.columns_um / sensor.pixel_um)
        strip += np.float32(self.share) * _gathered(_gathered(view.light_e, rows).T, columns).T
        return strip

    def _edges(self, start: int, count: int, centre: float, moved: float) -> NDArray[np.float64]:
        """Return the positions in the frame whose ghosts are the edges of ``count`` pixels from ``start`` (pixels)."""
        edges = start - 0.5 + np.arange(count + 1, dtype=np.float64)
        return centre - (edges - centre - moved) / self.scale


def _gathered(light: NDArray[np.float32], edges: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the sums of ``light`` (n, m) between neighbouring ``edges``, in decreasing order: ``(edges - 1, m)``.

    It uses differences of a running sum, so that light is conserved at any scale.
    """
    at = np.clip(edges + 0.5, 0, len(light))
    low = min(int(at[-1]), len(light) - 1)
    part = light[low : int(np.ceil(at[0])) + 1]
    running = np.zeros((len(part) + 1, light.shape[1]))
    np.cumsum(part, axis=0, dtype=np.float64, out=running[1:])
    whole = np.minimum((at - low).astype(np.intp), len(part) - 1)
    rest = (at - low - whole)[:, None]
    sums = (1 - rest) * running[whole] + rest * running[whole + 1]
    gathered: NDArray[np.float32] = (sums[:-1] - sums[1:]).astype(np.float32)
    return gathered


EFFECTS = (Ghost, SensorNonlinearity)
