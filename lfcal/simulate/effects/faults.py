"""Faults of the recorded light: the pixels' nonlinearity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.simulate.effects.base import Estimate, FrameEffect, SensorStrip
from lfcal.simulate.effects.outlook import Outlook

__all__ = ["SensorNonlinearity"]


@dataclass(frozen=True, slots=True)
class SensorNonlinearity(FrameEffect):
    """A sensor whose signal bends: e electrons are read as e (1 - q e/full well).

    Attributes
    ----------
    share
        What is missing at full well, q; negative: too much. It stays the same beyond, where the well may overflow.
    """

    share: float = 0.02

    name: ClassVar[str] = "nonlinearity"
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"share": (-0.5, 0.5)}
    units: ClassVar[Mapping[str, str]] = {"share": "share"}
    title: ClassVar[str] = "sensor nonlinearity"
    # of the collected charge, which the well has limited; read noise comes after it
    rank: ClassVar[int] = 67
    deviation: ClassVar[bool] = True

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return q, and what Gaussian spots of equal light lose: half of q peak/full well in the sharpest."""
        full, sharp = outlook.camera.sensor.full_well_e, min(outlook.widths_px)

        def lost(width: float) -> float:
            # the mean of e² over that of e is half the peak; beyond the full well the share stays
            return min(1.0, 0.5 * outlook.peak_e / full * (sharp / width) ** 2)

        error = self.share * outlook.over_types(lost)
        return Estimate(abs(self.share), "of full well", abs(error) / (1.0 - error), "q peak/(2 full well) (w_min/w)²")

    def on_frame(self, strip: NDArray[np.float32], view: SensorStrip) -> NDArray[np.float32]:
        """Return the strip as it is read; electrons, before the gain."""
        if self.share:
            full = np.float32(view.camera.sensor.full_well_e)
            # clipped, so that more light never reads as less
            strip *= 1 - np.float32(self.share) * np.clip(strip / full, 0, 1)
        return strip


EFFECTS = (SensorNonlinearity,)
