"""Find sources whose responses are mirror images of each other, and arrays that act on rows and columns separately."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.simulate._pupil_scene import AnyScene, PupilScene
from lfcal.simulate.scene import PupilIris, Scene

__all__ = ["AxisPhase", "axis_phase", "folded", "is_mirror_symmetric", "is_separable", "mirrored_rows"]

EXACT = 1e-6
"""Largest error of position (pixels) at which two rows still count as mirror images."""

AxisPhase = tuple[float, float, float, int]
"""Lenslet position relative to the source, shift of the nodes, pitch (µm), and pixels of the cutout, along an axis."""


def folded(axis: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return the distinct distances from 0 along an axis, and for each position the index of its distance.

    A quantity that is even along both axes equals ``values[np.ix_(places, places)]``, where ``places`` are these
    indices and ``values`` are computed only at the distances. This is about a quarter of the work, with identical
    results.
    """
    distances, places = np.unique(np.abs(axis), return_inverse=True)
    return distances, places


def is_mirror_symmetric(scene: Scene) -> bool:
    """Return whether array, pupil and sources are mirror symmetric about a row, apart from the positions of the rows.

    A square or hexagonal array along the pixel rows is symmetric, including its lens types, about every row of
    lenslets.
    """
    # offsets could be mirror images of each other too; this is not examined
    lattice = scene.lattice
    upright = lattice.rotation_rad == lattice.shear_rad == 0 and scene.pixel_aspect == 1
    in_place = scene.offsets_um is None and scene.image_map is None and scene.tilt == (0, 0)
    # a missing lenslet is seldom mirrored, and an oblique chief ray has a different response than its mirror image
    alike = not scene.defects and scene.accept[1] == 0
    return (
        upright and in_place and alike and _iris_is_symmetric(scene.iris) and all(m >= 0 for _, m, _ in scene.wavefront)
    )


def _iris_is_symmetric(iris: PupilIris) -> bool:
    if iris.stop is not None and iris.stop[1] != 0:
        return False
    if iris.blades == 0 or iris.curvature == 1:
        return True
    # a regular iris is symmetric about x if a vertex or the middle of an edge lies on it
    turns = iris.rotation_rad * iris.blades / math.pi
    return abs(turns - round(turns)) < 1e-9


def mirrored_rows(scene: AnyScene, rows: NDArray[np.int64]) -> dict[int, int]:
    """Return ``{i: j}``: row ``rows[i]`` is the mirror image of ``rows[j]``, which is not a key itself."""
    if isinstance(scene, PupilScene) or not is_mirror_symmetric(scene):
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


def is_separable(scene: Scene) -> bool:
    """Return whether the array acts on rows and columns separately."""
    lattice = scene.lattice
    upright = lattice.rotation_rad == lattice.shear_rad == 0 and scene.tilt == (0, 0) and not scene.exact_rays
    alike = len(lattice.types) == 1 and not scene.defects and scene.lenslet_quartic == scene.accept[0] == 0
    square = lattice.kind == "square" and scene.gapless and upright
    return square and math.isinf(scene.pupil_um) and alike


def axis_phase(scene: Scene, axis: int, source_um: float, pixel: int) -> tuple[AxisPhase, bool]:
    """Return the phase of a source along an axis, and whether its response is mirrored along this axis.

    Sources at mirror-image positions relative to a lenslet have the same phase; for one of the two, the response must
    be flipped. The response of a separable scene depends only on the phases along both axes and on these flips.

    Parameters
    ----------
    scene
        A separable scene.
    axis
        0 for rows, 1 for columns.
    source_um, pixel
        Coordinate of the source (µm), and the middle pixel of its cutout along the axis.
    """
    lattice = scene.lattice
    pitch = (lattice.row_step_um, lattice.pitch_um)[axis]
    place = (lattice.offset_um[1 - axis] - source_um) % pitch
    shift = pixel * scene.pixel_um - source_um
    grain = scene.pixel_um * 1e-9  # positions that differ only by rounding must have the same key
    mirrored = (pitch - place) % pitch
    flip = (round(mirrored / grain), round(-shift / grain)) < (round(place / grain), round(shift / grain))
    if flip:
        place, shift = mirrored, -shift
    return (round(place / grain) * grain, round(shift / grain) * grain, pitch, scene.cutout[axis]), flip
