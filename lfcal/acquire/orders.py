"""Orders in which positions are visited."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan

__all__ = ["coarse_order"]


def coarse_order(plan: ScanPlan) -> NDArray[np.intp]:
    """Return all positions ``(N, 3)`` as (z, y, x), coarse grids first.

    The first pass visits every plane on a grid of up to 16 pixels' pitch, each later pass the points of a
    grid twice as fine that are not yet taken; so that after 1/256 of the session all planes have been seen.
    Within a pass the plan's own order holds.
    """
    order = plan.order_indices()
    largest = 1 << max(0, min(4, (max(plan.period) - 1).bit_length() - 1))
    level = np.zeros(len(order), np.intp)
    pitch = 2
    while pitch <= largest:
        level += (order[:, 1] % pitch == 0) & (order[:, 2] % pitch == 0)
        pitch *= 2
    return order[np.argsort(-level, kind="stable")]
