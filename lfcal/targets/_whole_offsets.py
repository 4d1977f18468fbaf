"""Offsets in whole pixels of a display that show all phases with few frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work
from lfcal.targets.images import HoleImages, whole_at
from lfcal.targets.phases import Phases
from lfcal.targets.search import asked_offsets, covered_by

__all__ = ["iter_whole_offsets"]

F8 = NDArray[np.float64]

LOOKED_AT = 8
"""Offsets that are looked at exactly for each frame: those that serve most pairs of a hole and a missing phase."""


def iter_whole_offsets(
    phases: Phases, images: HoleImages, tolerance_px: float, unit_px: float, most: int | None = None
) -> Work[NDArray[np.intp]]:
    """Return offsets ``(frames, 2)`` in units, each the one that shows most of what is missing; yields progress.

    Parameters
    ----------
    phases, images
        The scan, and the images of the target without an offset.
    tolerance_px
        How far off a phase may be, in rows and in columns.
    unit_px
        A pixel of the display, in the image (pixels).
    most
        End after so many.
    """
    asked = asked_offsets(phases, images)
    cells = np.rint(asked / unit_px).astype(np.intp)
    plan = phases.plan
    pixels = images.pixels + images.shift[:, None] * asked
    served = (np.abs(cells * unit_px - asked) <= tolerance_px).all(-1)
    served &= whole_at(pixels, plan.camera.sensor.shape, plan.cutout)
    low = cells.min(axis=(0, 1))
    size = cells.max(axis=(0, 1)) - low + 1
    flat = np.where(served, (cells[..., 0] - low[0]) * size[1] + cells[..., 1] - low[1], -1)
    missing, found = np.ones(phases.count, np.bool_), list[NDArray[np.intp]]()
    clock = Clock("offsets of the display", phases.count)
    yield clock.at(0)
    while missing.any() and (most is None or len(found) < most):
        left = flat[missing]
        counts = np.bincount(left[left >= 0], minlength=int(size.prod()))
        best, shown = None, np.zeros(0, np.intp)
        for cell in np.argsort(-counts, kind="stable")[:LOOKED_AT].tolist():
            if counts[cell] <= len(shown):
                break
            at = np.array(divmod(cell, int(size[1])), np.intp) + low
            covered = covered_by(phases, images, at * unit_px, tolerance_px)
            new = covered[missing[covered]]
            if len(new) > len(shown):
                best, shown = at, new
        if best is None:
            break
        missing[shown] = False
        found.append(best)
        yield clock.at(int((~missing).sum()))
    return np.array(found, np.intp).reshape(-1, 2)
