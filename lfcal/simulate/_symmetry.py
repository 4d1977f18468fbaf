"""Source rows whose responses mirror each other."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.simulate.scene import PupilIris, Scene

__all__ = ["folded", "is_mirror_symmetric", "mirrored_rows"]

EXACT = 1e-6
"""Misplacement (pixels) up to which two rows are the mirror images of each other."""


def folded(axis: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return the different distances from 0 along an axis, and the index of the distance of each place.

    A quantity that is even along both axes is ``values[np.ix_(places, places)]`` of the values at the distances: about
    a quarter of the work, with identical results.
    """
    distances, places = np.unique(np.abs(axis), return_inverse=True)
    return distances, places


def is_mirror_symmetric(scene: Scene) -> bool:
    """Return whether array, pupil and sources look the same upside down, but for where the rows lie.

    A square or hexagonal array along the pixel rows does, lens types included, about every row of lenslets.
    """
    # offsets could mirror each other too; they are not looked at.
    lattice = scene.lattice
    upright = lattice.rotation_rad == lattice.shear_rad == 0 and scene.pixel_aspect == 1
    in_place = scene.offsets_um is None and scene.image_map is None and scene.tilt == (0, 0)
    # one lenslet is seldom where its mirror image is; an oblique chief ray has another response than its own
    alike = not scene.defects and scene.accept[1] == 0
    return (
        upright and in_place and alike and _iris_is_symmetric(scene.iris) and all(m >= 0 for _, m, _ in scene.wavefront)
    )


def _iris_is_symmetric(iris: PupilIris) -> bool:
    if iris.stop is not None and iris.stop[1] != 0:
        return False
    if iris.blades == 0 or iris.curvature == 1:
        return True
    # a regular iris mirrors itself about x where a vertex or the middle of an edge lies on it.
    turns = iris.rotation_rad * iris.blades / math.pi
    return abs(turns - round(turns)) < 1e-9


def mirrored_rows(scene: Scene, rows: NDArray[np.int64]) -> dict[int, int]:
    """Return ``{i: j}``: row ``rows[i]`` is the mirror image of ``rows[j]``, which is not itself in the result."""
    if not is_mirror_symmetric(scene):
        return {}
    lattice = scene.lattice
    twice = 2 * lattice.row_step_um * scene.scale / scene.pixel_um
    offset = 2 * lattice.offset_um[1] * scene.scale / scene.pixel_um
    pairs: dict[int, int] = {}
    for i, y in enumerate(rows):
        for j in range(i):
            turns = (float(y + rows[j]) - offset) / twice
            if j not in pairs and abs(turns - round(turns)) * twice < EXACT:
                pairs[i] = j
                break
    return pairs
