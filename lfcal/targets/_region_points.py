"""How many points a target's frames give each of several regions of the field: one session serves them all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import RegionPlan
from lfcal.targets.images import whole_at
from lfcal.targets.plan import TargetPlan

__all__ = ["region_points"]


def region_points(plan: TargetPlan, regions: RegionPlan, z: int) -> NDArray[np.intp]:
    """Return how many points each frame of plane ``z`` gives each region, ``(frames, regions)``.

    A point is of the region whose middle is nearest to it.
    """
    scan, images = plan.scan, plan.images(z)
    middles = np.array(regions.anchors) + (np.array(scan.period) - 1) / 2
    counts = np.zeros((len(plan.offsets_px[z]), len(regions)), np.intp)
    for k, offset in enumerate(plan.offsets_px[z]):
        pixels = images.moved(np.array(offset))
        pixels = pixels[whole_at(pixels, scan.camera.sensor.shape, scan.cutout)]
        nearest = np.linalg.norm(pixels[:, None] - middles, axis=2).argmin(1)
        counts[k] = np.bincount(nearest, minlength=len(regions))
    return counts
