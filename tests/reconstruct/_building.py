"""H of small cameras that several tests use."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera, ScanPlan, preset
from lfcal.simulate import simulate_psf


def square(**lattice: object) -> Camera:
    """Return the camera ``bench`` with square lenslets of one type, and with changes of its lattice."""
    camera = preset("bench")
    return replace(camera, lattice=replace(camera.lattice, kind="square", types=camera.lattice.types[1:2], **lattice))


@cache
def square_matrix(virtual_depths: tuple[float, ...], cutout: int) -> NDArray[np.float32]:
    """Return H of planes behind square lenslets, for a period of 11 px; it is shared and not to be changed."""
    camera = square()
    depths = tuple(camera.depth_of(v) for v in virtual_depths)
    plan = ScanPlan(camera, (11, 11), cutout=(cutout, cutout), depths_um=depths, anchor=(137, 137))
    values = np.asarray(simulate_psf(plan, effects=(), tolerance=0.1)[:], np.float32)
    values.flags.writeable = False
    return values
