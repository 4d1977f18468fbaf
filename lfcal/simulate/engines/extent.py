"""How much of the array and of the sensor the light of one position covers, and where near the native plane begins."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["MAX_ORDERS", "MAX_SAMPLES", "MAX_SIDE", "SWITCH", "SWITCH_EXACT", "Extent"]

SWITCH = 12.0
"""Fresnel number of the iris's shadow above which the E-mode is used (see `lfcal.simulate.engines.field`)."""
SWITCH_EXACT = 8.0
"""The same where rays have exact angles, which windows follow in the E-mode alone: it errs less than they differ."""

MAX_SAMPLES = 4096
"""Largest side of a position's grid."""

MAX_SIDE = 12000
"""Largest side of the array's table: 1.2 GB."""

MAX_ORDERS = 16
"""Most fields that follow a tilted array (see `lfcal.simulate.engines.tilted`); more are no error of mounting."""

TAILS = 3
"""How many times narrower the margin beyond what reaches the cutout may be than that around the shadow (measured)."""


@dataclass(frozen=True, slots=True)
class Extent:
    """Radii about a source's image (pixels).

    Attributes
    ----------
    shadow
        Light on the array by rays, including aberrations and a displaced source.
    outward
        Outward displacement of rays at its rim between array and sensor; 0 if it is inward.
    half_cutout
        Half the cutout.
    pitch
        Lenslet pitch.
    """

    shadow: float
    outward: float
    half_cutout: float
    pitch: float

    def side(self, per_px: int, margin: float) -> int:
        """Return the samples a side of a grid with ``margin`` pixels around the light, even and quick to transform.

        Light that leaves the grid comes in again on its other side: there must be room until the cutout begins.
        """
        import scipy.fft as sf

        reach = self.half_cutout + 2
        # beyond the shadow there is hardly any light, and of that and all else hardly any gets far into the cutout
        lit = min(self.shadow + margin, reach + self.outward + self.pitch / 2 + margin / TAILS)
        lands = lit + self.outward
        half = max(lit, reach, min(lands, (lands + reach + self.pitch) / 2))
        size = int(sf.next_fast_len(2 * math.ceil(half * per_px)))
        while size % 2:
            size = int(sf.next_fast_len(size + 1))
        return size
