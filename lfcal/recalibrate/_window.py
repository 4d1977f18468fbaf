"""Windows of the sensor on which frames are compared with a model: where they are, and which of their pixels count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan

__all__ = ["LEAST_SIDE", "SIDE", "SensorWindow", "windows_of"]

F4 = NDArray[np.float32]

SIDE = 100
"""Default side of the part of a window in which all light is explained (pixels)."""

LEAST_SIDE = 40
"""Smallest side of the part of a window without margins (pixels)."""

EDGE_PX = 2
"""Width of the edge of a window at which light from outside is looked for (pixels)."""

LIT = 0.02
"""Mean light at an edge, relative to the bright parts, above which sources are assumed outside of the window."""

CORNERS = ((0.5, 0.5), (0.15, 0.15), (0.15, 0.85), (0.85, 0.15), (0.85, 0.85))
"""Middles of several windows, as fractions of the sensor."""


@dataclass(frozen=True)
class SensorWindow:
    """A rectangle of source positions and the pixels that they light.

    Attributes
    ----------
    plan
        Plan whose period is the rectangle of positions: each position has a separate pattern.
    """

    plan: ScanPlan

    @classmethod
    def at(cls, plan: ScanPlan, period: Sequence[int], anchor: Sequence[float]) -> SensorWindow:
        """Return the window of ``period`` positions (rows, columns), the first at pixel ``anchor`` (row, column)."""
        size, first = (int(period[0]), int(period[1])), (float(anchor[0]), float(anchor[1]))
        return cls(replace(plan, period=size, anchor=first, resample=False))

    @property
    def place(self) -> tuple[tuple[int, int], tuple[float, float]]:
        """Number of positions (rows, columns), and pixel (row, column) of the first."""
        return self.plan.period, self.plan.anchor

    @property
    def origin(self) -> tuple[int, int]:
        """First row and column of the pixels, on the sensor."""
        row, column = (round(a - (n - 1) / 2) for a, n in zip(self.plan.anchor, self.plan.cutout, strict=True))
        return row, column

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns of pixels."""
        (ny, nx), (nt, ns) = self.plan.period, self.plan.cutout
        return ny + nt - 1, nx + ns - 1

    def part(self, image: NDArray[np.generic]) -> NDArray[np.generic]:
        """Return the part of an image of the whole sensor."""
        (row, column), (rows, columns) = self.origin, self.shape
        return image[row : row + rows, column : column + columns]

    def trusted(self, electrons: F4, valid: F4) -> F4:
        """Return the weights ``valid`` of the window's pixels, without margins that sources outside may light.

        A side has a margin, as wide as a cutout, if its edge is lit. A window that is too small for margins has none:
        its objects must be inside, and the goodness of fit shows if they are not.
        """
        if not valid.any():
            return valid
        dark, light = np.quantile(electrons[valid > 0], (0.05, 0.99))
        found = valid.copy()
        if min(n - 2 * (m - 1) for n, m in zip(self.shape, self.plan.cutout, strict=True)) < LEAST_SIDE:
            return found
        for axis in (0, 1):
            margin = self.plan.cutout[axis] - 1
            for end in (1, -1):
                edge, good = (np.moveaxis(one, axis, 0)[::end][:EDGE_PX] for one in (electrons, valid))
                if float((edge * good).sum() / max(1, good.sum())) - dark > LIT * (light - dark):
                    np.moveaxis(found, axis, 0)[::end][:margin] = 0
        return found


def windows_of(plan: ScanPlan, count: int | None = None, side: int = SIDE) -> tuple[SensorWindow, ...]:
    """Return windows of the sensor of a plan: one in the middle, then four near the corners.

    Parameters
    ----------
    plan
        Scan with the camera, the planes and the cutout.
    count
        Number of windows. None: one if it covers a quarter of the sensor, otherwise five.
    side
        Side of the part of a window without margins (pixels).
    """
    shape, cutout = np.array(plan.camera.sensor.shape), np.array(plan.cutout)
    room = shape - cutout + 1
    period = np.minimum(room, side + cutout - 1)
    if count is None:
        count = 1 if 4 * period.prod() >= room.prod() else len(CORNERS)
    found: dict[tuple[int, ...], SensorWindow] = {}
    for middle in CORNERS[: max(1, count)]:
        first = np.clip(np.rint(np.array(middle) * room - period / 2), 0, room - period)
        anchor = first + (cutout - 1) // 2
        found[tuple(anchor.tolist())] = SensorWindow.at(plan, period.tolist(), anchor.tolist())
    return tuple(found.values())
