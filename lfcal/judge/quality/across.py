"""Compare planes with each other: dark planes, copies, and the sizes of their shadows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import Camera, Microscope
from lfcal.judge.quality._expected import footprint_variance
from lfcal.judge.quality._sums import spread as spread_of
from lfcal.judge.quality.measure import PlaneMeasures, lattice_camera
from lfcal.psf import PSFMatrix

__all__ = ["MatrixMeasures", "shadow_sizes"]

DARK_PLANE = 0.1
"""Fraction of the typical energy below which a plane is dark."""

NOVEL = 0.05
"""Fraction of the difference between neighbours below which a plane is a copy of another."""

MOST_STEP = 0.2
"""Largest difference (1 - correlation) of neighbouring planes that is taken into account."""

MOST_NOISE, CLEARLY = 3.0, 6.0
"""Largest difference of recordings of one depth, and smallest of two depths, relative to the difference by noise."""

SAME_NOISE, IDENTICAL = 0.05, 1e-12
"""Largest difference of a recording that was stored twice: relative to the difference by noise, and without noise."""

CLEAR = 4.0
"""Ratio of the second moments of a sum and of the lenslets above which the size of the shadow can be determined."""


@dataclass(frozen=True, slots=True, eq=False)
class MatrixMeasures:
    """Measurements of all planes, for metrics of H as a whole.

    Attributes
    ----------
    matrix
        H, not transposed.
    planes
        Measurements of each plane, without patterns.
    energy
        Median energy of the patterns of each plane, ``(nz,)``, in the unit of H; 0 without light.
    dark
        Mask ``(nz,)``, True for planes with hardly any light.
    copies
        Index of the earlier plane of which a plane is a copy, ``(nz,)``; -1 if it is not a copy.
    shadows_px
        Diameter of the shadow of the iris on the sensor for each plane (px), ``(nz,)``; NaN if unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix
    >>> from lfcal.judge.quality import MatrixMeasures, Reading
    >>> def loss(found: MatrixMeasures) -> list[Reading]:  # as `of_matrix` of your own metric
    ...     energy = found.energy[~found.dark]
    ...     return [Reading(float(100 * (1 - energy.min() / energy.max())))]
    >>> H, dark = PSFMatrix(np.ones((3, 2, 2, 5, 5))), np.array([False, False, True])
    >>> found = MatrixMeasures(H, (), np.array([100.0, 75.0, 0.0]), dark, np.full(3, -1), np.full(3, np.nan))
    >>> print(loss(found)[0].value, "%")
    25.0 %
    """

    matrix: PSFMatrix
    planes: tuple[PlaneMeasures, ...]
    energy: NDArray[np.float64]
    dark: NDArray[np.bool_]
    copies: NDArray[np.intp]
    shadows_px: NDArray[np.float64]

    @classmethod
    def of(cls, matrix: PSFMatrix, planes: Sequence[PlaneMeasures]) -> MatrixMeasures:
        """Return the measurements of ``matrix`` as a whole, from those of its ``planes``, in order."""
        energy = np.array([p.energy if p.lit else 0.0 for p in planes])
        usual = float(np.median(energy[energy > 0])) if (energy > 0).any() else 0.0
        dark = energy < DARK_PLANE * usual if usual else np.ones(len(planes), bool)
        shadows = shadow_sizes(planes, lattice_camera(matrix), matrix.pixel_scale)
        return cls(matrix, tuple(planes), energy, dark, _copies(planes, ~dark, _places(matrix)), shadows)


def _copies(planes: Sequence[PlaneMeasures], lit: NDArray[np.bool_], places: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the index of the earlier plane of which each plane is a copy; -1 if there is none.

    Planes are compared on some patterns. Two planes with equal noise are one recording. Two recordings show the same
    depth if they differ only by noise, although planes at such a distance normally differ by much more. This is known
    only from the other planes.
    """
    out = np.full(len(planes), -1, np.intp)
    chosen = [z for z in range(len(planes)) if lit[z] and planes[z].sample.size]
    if len(chosen) < 2:
        return out
    vectors = np.stack([planes[z].sample for z in chosen])
    norms = np.maximum(np.sqrt(np.einsum("ij,ij->i", vectors, vectors, dtype=np.float64)), 1e-300)
    noisy = [planes[z].dark.noise * math.sqrt((vectors[k] > 0).sum()) / norms[k] for k, z in enumerate(chosen)]

    def apart(a: int, b: int) -> float:
        # for unit vectors, 1 minus the correlation; from differences, which are exactly 0 for equal patterns
        return float(np.square(vectors[a] / norms[a] - vectors[b] / norms[b]).sum()) / 2

    steps = [apart(k, k + 1) - noisy[k] * noisy[k + 1] for k in range(len(chosen) - 1)]
    spaces = np.abs(np.diff(places[chosen]))
    # the medians over neighbours, so that one repeated plane does not set the typical step
    step, space = (min(float(np.median(steps)), MOST_STEP), float(np.median(spaces))) if len(steps) > 1 else (0.0, 0.0)
    for b in range(1, len(chosen)):
        for a in range(b):
            found, chance = apart(a, b), noisy[a] * noisy[b]
            # patterns of nearby planes change with the square of their distance
            ratio = abs(places[chosen[b]] - places[chosen[a]]) / space if space > 0 else 0.0
            wanted = step * min(1.0, ratio) ** 2
            again = CLEARLY * chance < wanted and found < max(NOVEL * wanted, MOST_NOISE * chance)
            if again or found < max(SAME_NOISE * chance, IDENTICAL):
                out[chosen[b]] = chosen[a]
                break
    return out


def _places(matrix: PSFMatrix) -> NDArray[np.float64]:
    """Return the image distances of the planes ``(nz,)``; without a camera that images them, their depths."""
    if matrix.camera is not None:
        try:
            return np.array([matrix.camera.image_shift_um(float(depth)) for depth in matrix.depths])
        except InputError:
            pass
    return np.asarray(matrix.depths, np.float64)


def shadow_sizes(
    planes: Sequence[PlaneMeasures], camera: Camera | None, pixel_scale: tuple[float, float] = (1.0, 1.0)
) -> NDArray[np.float64]:
    """Return the diameter of the shadow of the iris on the sensor for each plane ``(nz,)`` (pixels); NaN if unknown.

    Without a ``camera``, it is unknown. ``pixel_scale`` is the number of pixels of H per pixel of the sensor, along
    rows and columns.

    A ray through the iris reaches the sensor at the position r = P (1 - 1/v) - e B/f. Here P is a point of the shadow
    in the plane of the lenslets, and e a point of a lenslet. v is the virtual depth, B the distance from the lenslets
    to the sensor, and f the focal length of the lenslets. Over a full period of the lattice, P and e are distributed
    independently. The second moment of a depth-plane sum is therefore the sum of two second moments: that of the shadow
    (D²/8 for a disc of diameter D) and that of the lenslets. The second moment of the lenslets does not depend on
    depth.
    """
    sizes = np.full(len(planes), math.nan)
    if camera is None:
        return sizes
    scale = math.sqrt(math.prod(pixel_scale))
    pixel, gap = camera.sensor.pixel_um / scale, camera.lattice.gap_um
    airy = 0.42 * camera.wavelength_um * gap / camera.lattice.clear_diameter_um / pixel
    # second moments add: the lenslet's disc, diffraction and the pixel's box, each over both axes
    own = footprint_variance(camera) / pixel**2 + 2 * airy**2 + 2 / 12
    for z, p in enumerate(planes):
        if p.lit and p.spread > CLEAR * own:
            # a uniform disc of diameter D has the second moment D²/8
            sizes[z] = math.sqrt(8 * (p.spread - own)) * _paraxial(p, camera, own, pixel)
    return sizes


def _paraxial(plane: PlaneMeasures, camera: Camera, own: float, pixel_um: float) -> float:
    """Return the shadow diameter |a - B| / N over the diameter that follows from the moment of the expected sum.

    Rays of a microscope move by the tangent of their angle and not by its sine, and tails widen the moment.
    """
    about = plane.about
    if about.expected is None or not isinstance(camera.optics, Microscope):
        return 1.0
    shown = spread_of(about.expected) - own
    shift = camera.image_shift_um(float(about.matrix.depths[about.z])) - camera.lattice.gap_um
    wanted = abs(shift) / camera.optics.working_f_number / pixel_um
    return wanted / math.sqrt(8 * shown) if shown > 0 else 1.0
