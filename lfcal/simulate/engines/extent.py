"""Extent of the light of one position on the array and on the sensor, and limits near the native plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["MAX_ORDERS", "MAX_SAMPLES", "MAX_SIDE", "SWITCH", "SWITCH_EXACT", "Extent"]

SWITCH = 12.0
"""Fresnel number of the iris's shadow above which the E-mode is used (see `lfcal.simulate.engines.field`)."""
SWITCH_EXACT = 8.0
"""Fresnel number above which the E-mode is used with exact angles.

It is lower than `SWITCH`, because windows follow exact angles only in E-mode, and this matters more than the error of
the E-mode.
"""

MAX_SAMPLES = 4096
"""Largest side of a position's grid (samples)."""

MAX_SIDE = 12000
"""Largest side of the array's table (samples): 1.2 GB."""

MAX_ORDERS = 16
"""Largest number of fields for a tilted array (`lfcal.simulate.engines.tilted`), far above mounting errors."""

TAILS = 3
"""Ratio of the margin around the shadow to that around the light that reaches the cutout (measured)."""


@dataclass(frozen=True, slots=True)
class Extent:
    """Extent of the light of one position about the source's image; all lengths in pixels.

    Attributes
    ----------
    shadow
        Radius of the light on the array, traced with rays, including aberrations and a displaced source.
    outward
        Outward displacement, between array and sensor, of the rays at the rim of this light. It is that of the main
        lens's rays, or 0 if these move inwards, plus that due to the lenslets' spherical aberration.
    half_cutout
        Half the larger side of the cutout.
    pitch
        Lenslet pitch.
    """

    shadow: float
    outward: float
    half_cutout: float
    pitch: float

    def side(self, per_px: int, margin: float) -> int:
        """Return the side of a grid (samples) around the light, an even number suited to fast transforms.

        There are ``per_px`` samples per pixel. The grid extends ``margin`` pixels beyond the shadow, or less if the
        cutout is smaller. Light that leaves the grid re-enters on the opposite side. The margin must therefore be wide
        enough to keep this light out of the cutout.
        """
        import scipy.fft as sf

        reach = self.half_cutout + 2
        # there is hardly any light beyond the shadow, and very little of it gets far into the cutout
        lit = min(self.shadow + margin, reach + self.outward + self.pitch / 2 + margin / TAILS)
        lands = lit + self.outward
        half = max(lit, reach, min(lands, (lands + reach + self.pitch) / 2))
        size = int(sf.next_fast_len(2 * math.ceil(half * per_px)))
        while size % 2:
            size = int(sf.next_fast_len(size + 1))
        return size
