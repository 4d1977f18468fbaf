"""A free filter of 3 x 3 pixels, for light that appears in neighbouring pixels for any reason."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera
from lfcal.simulate.effects.base import Estimate, PsfEffect
from lfcal.simulate.effects.outlook import Outlook

__all__ = ["NEIGHBOURS", "PixelKernel"]

NEIGHBOURS: Mapping[str, tuple[int, int]] = {
    "up_left": (-1, -1),
    "up": (-1, 0),
    "up_right": (-1, 1),
    "left": (0, -1),
    "right": (0, 1),
    "down_left": (1, -1),
    "down": (1, 0),
    "down_right": (1, 1),
}
"""Names of the eight neighbours of a pixel, with their offsets (rows, columns)."""


@dataclass(frozen=True, slots=True)
class PixelKernel(PsfEffect):
    """Transfer of a fraction of each pixel's light to each of its eight neighbours: smear, residual charge or blur.

    This is an empirical kernel, not a model of a physical cause: crosstalk, source size and pixel size are separate
    effects. The total light is conserved, because a pixel loses what its neighbours gain. Negative fractions sharpen
    the image.

    Attributes
    ----------
    up_left, up, up_right, left, right, down_left, down, down_right
        Fraction of a pixel's light that appears in this neighbour; up is towards row 0.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import PixelKernel
    >>> print(PixelKernel(left=0.01, right=0.02).kernel(preset("r29")).round(2))
    [[0.   0.   0.  ]
     [0.01 0.97 0.02]
     [0.   0.   0.  ]]
    """

    up_left: float = 0.0
    up: float = 0.0
    up_right: float = 0.0
    left: float = 0.0
    right: float = 0.0
    down_left: float = 0.0
    down: float = 0.0
    down_right: float = 0.0

    name: ClassVar[str] = "pixel_kernel"
    units: ClassVar[Mapping[str, str]] = dict.fromkeys(NEIGHBOURS, "share")
    titles: ClassVar[Mapping[str, str]] = {name: f"to the neighbour {name.replace('_', ' ')}" for name in NEIGHBOURS}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = dict.fromkeys(NEIGHBOURS, (-0.1, 0.1))
    title: ClassVar[str] = "arbitrary filter of the pixels"
    rank: ClassVar[int] = 93
    deviation: ClassVar[bool] = True
    measured_by: ClassVar[str] = "pixel_kernel"

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the sum of the absolute fractions, and the larger of the relative errors due to blur and to shift."""
        shares = {place: getattr(self, name) for name, place in NEIGHBOURS.items()}
        aside = math.hypot(*(sum(w * place[k] for place, w in shares.items()) for k in (0, 1)))
        variance = sum(abs(w) * (y * y + x * x) for (y, x), w in shares.items()) / 2
        error = max(outlook.blurred(math.sqrt(variance), floor_px=0.41), outlook.moved(aside))
        moved = sum(abs(w) for w in shares.values())
        return Estimate(moved, "of the light", error, "the larger of 0.74 s²/(w² + 0.17) and the shift")

    def kernel(self, camera: Camera) -> NDArray[np.float64]:
        """Return the kernel, shape ``(3, 3)``, whose sum is 1."""
        del camera
        found = np.zeros((3, 3))
        for one in fields(self):
            dy, dx = NEIGHBOURS[one.name]
            found[1 + dy, 1 + dx] = getattr(self, one.name)
        found[1, 1] = 1.0 - found.sum()
        return found


EFFECTS = PixelKernel
