"""Half-cell scans: a hexagonal period holds two primitive cells, and half its positions are enough where both fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera.plan import ScanPlan

__all__ = ["HalfCell", "half_cell"]

MOST_PX = 0.05
"""How far the array's own half period may lie from whole pixels: by more a pattern is no longer its partner's."""


@dataclass(frozen=True, slots=True)
class HalfCell:
    """The pattern at (y, x) is that at (y + shift[0], x + shift[1]), around the period's edges.

    Attributes
    ----------
    period
        Positions ``(ny, nx)``.
    shift
        Half of them.
    residual_px
        The array's half period minus that of the grid ``(y, x)``, the larger of both diagonals (pixels).
    """

    period: tuple[int, int]
    shift: tuple[int, int]
    residual_px: tuple[float, float]

    def partners(self, positions: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the positions ``(n, 3)`` whose patterns are the same as those of ``positions``."""
        out = positions.copy()
        out[:, 1:] = (positions[:, 1:] + self.shift) % self.period
        return out

    def half(self, plan: ScanPlan) -> NDArray[np.intp]:
        """Return the positions ``(n, 3)`` of one half, in scan order: the first rows of the period."""
        order = plan.order_indices()
        found: NDArray[np.intp] = order[order[:, 1] < self.shift[0]]
        return found


def half_cell(plan: ScanPlan) -> HalfCell:
    """Return how the half periods of a plan's array fit the pixels.

    Raises
    ------
    InputError
        With the reason, where a pattern half a period away is another one: the period is odd, the array has no lenslet
        there, or one of another type, or it lies more than 0.05 px beside whole pixels.
    """
    ny, nx = plan.period
    what, remedy = "half-cell scan", "scan the whole period, or choose positions for a fit (lfcal plan --for-fit)"
    if plan.resample:
        raise InputError.expected(what, "frames as they are", "frames to be resampled", remedy)
    if ny % 2 or nx % 2:
        wanted = "a period of even numbers of pixels"
        raise InputError.expected(what, wanted, f"{ny} x {nx}: half of it lies half a pixel off", remedy)
    lattice, pixel = plan.cell_camera.lattice, plan.camera.sensor.pixel_um
    basis = lattice.basis_um()
    worst = np.zeros(2)
    # around the period's edges the partner lies on the other diagonal
    for dy, dx in ((ny / 2, nx / 2), (ny / 2, -nx / 2)):
        steps = np.array([dx, dy]) * pixel @ np.linalg.inv(basis)
        whole = np.rint(steps).astype(np.intp)
        x, y = (whole - steps) @ basis / pixel
        if max(abs(x), abs(y)) > 0.25 * lattice.pitch_um / pixel:
            got = f"none within {np.hypot(x, y):.1f} px of it"
            raise InputError.expected(what, "a lenslet half a period from each", got, remedy)
        if int(lattice.type_of(*whole)) != int(lattice.type_of(0, 0)):
            raise InputError.expected(what, "lenslets of the same type half a period away", "another type", remedy)
        worst = np.where(np.abs((y, x)) > np.abs(worst) + 1e-9, (y, x), worst)
    if np.abs(worst).max() > MOST_PX:
        got = f"{worst[0]:+.3f} rows, {worst[1]:+.3f} columns off"
        raise InputError.expected(what, f"half periods within {MOST_PX} px of whole pixels", got, remedy)
    return HalfCell((ny, nx), (ny // 2, nx // 2), (float(worst[0]), float(worst[1])))
