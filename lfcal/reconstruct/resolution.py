"""Measurement of the two-point resolution in each plane, and of the width of reconstructed beads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, drained
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers import richardson_lucy

__all__ = ["TwoPoint", "bead_widths", "dip", "fwhm", "iter_two_point", "two_point"]

RAYLEIGH_DIP = 0.735
"""Ratio of the value between two Airy patterns at the Rayleigh distance to their peaks."""


@dataclass(frozen=True, slots=True)
class TwoPoint:
    """Two-point resolution in one plane.

    Attributes
    ----------
    plane
        Index of the plane.
    depth_um
        Depth of the plane (µm); the index if H has no depths.
    distance
        Smallest tested distance such that the points are resolved at this and at all larger tested distances (voxels);
        infinity if there is none.
    dips
        Ratio of the minimum between the points to the smaller peak, for each tested distance.
    """

    plane: int
    depth_um: float
    distance: float
    dips: tuple[float, ...]


def dip(profile: NDArray[np.floating], first: int, second: int) -> float:
    """Return the ratio of the minimum between two peaks to the smaller peak: 0 if fully separated, 1 if not resolved.

    The peaks are the largest values near the indices ``first`` and ``second``, within a quarter of their distance.
    """
    # use the largest value nearby, because noise moves a peak by about a pixel
    reach = max(1, abs(second - first) // 4)
    a, b = sorted((first, second))
    tops = []
    for at in (a, b):
        low, high = max(0, at - reach), min(len(profile), at + reach + 1)
        tops.append(low + int(np.argmax(profile[low:high])))
    smaller = min(float(profile[t]) for t in tops)
    # adjacent peaks have no value between them
    if smaller <= 0 or tops[1] - tops[0] < 2:
        return 1.0
    return min(1.0, float(profile[tops[0] : tops[1] + 1].min()) / smaller)


def fwhm(profile: NDArray[np.floating]) -> float:
    """Return the full width at half maximum of the highest peak (samples, interpolated linearly); NaN without a peak.

    If one side does not fall to half of the maximum, it is measured up to the end of the profile.
    """
    top = int(np.argmax(profile))
    half = float(profile[top]) / 2
    if not half > 0:
        return float("nan")

    def reach(side: NDArray[np.floating]) -> float:
        below = np.flatnonzero(side < half)
        if not below.size:
            return len(side) - 1.0
        k = int(below[0])
        return k - 1 + float((side[k - 1] - half) / (side[k - 1] - side[k]))

    return reach(profile[top:]) + reach(profile[top::-1])


def bead_widths(volume: NDArray[np.floating], places: NDArray[np.floating], reach: int = 9) -> float:
    """Return the median full width at half maximum of beads (voxels), over all beads and both directions.

    Each bead is measured down and across, in the plane nearest to it.

    Parameters
    ----------
    volume
        Volume ``(nz, Y, X)``.
    places
        Plane, row and column of each bead, ``(n, 3)`` (planes and voxels).
    reach
        Number of voxels of a profile on each side of the bead. Perpendicular to the profile, a third as many voxels on
        each side are summed.
    """
    widths = []
    for place in places:
        z, y, x = (round(float(at)) for at in place)
        plane = volume[min(max(z, 0), len(volume) - 1)]
        rows, columns = slice(max(y - reach, 0), y + reach + 1), slice(max(x - reach, 0), x + reach + 1)
        strip = reach // 3
        down = plane[rows, max(x - strip, 0) : x + strip + 1].sum(1)
        across = plane[max(y - strip, 0) : y + strip + 1, columns].sum(0)
        widths += [fwhm(down), fwhm(across)]
    return float(np.nanmedian(widths))


def iter_two_point(
    P: Projector,
    distances: Sequence[int] = (2, 3, 4, 6, 8, 12, 16, 24),
    *,
    iterations: int = 30,
    photons: float = 1e5,
    seed: int | None = 0,
    limit: float = RAYLEIGH_DIP,
) -> Work[tuple[TwoPoint, ...]]:
    """Reconstruct pairs of points along x in each plane, and return a `TwoPoint` for each plane.

    Parameters
    ----------
    P
        Projector of H that images and reconstructs the pairs.
    distances
        Distances to test (voxels), ascending.
    iterations
        Number of Richardson-Lucy iterations.
    photons
        Expected total number of photons in the image of a pair.
    seed
        Seed of the Poisson noise. None: no noise.
    limit
        Points count as resolved if their dip (see `TwoPoint.dips`) is below this limit (0.735: the Rayleigh criterion).

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import Projector, iter_two_point
    >>> P = Projector(np.full((1, 1, 1, 3, 3), 1 / 9), (16, 32))
    >>> for step in iter_two_point(P, distances=(2, 4, 8), iterations=5):
    ...     print(step.stage, step.count)
    two-point resolution 1 of 3
    two-point resolution 2 of 3
    two-point resolution 3 of 3
    """
    nz, height, width = P.volume_shape
    clock = Clock("two-point resolution", nz * len(distances))
    results = []
    for z in range(nz):
        dips: list[float] = []
        for k, distance in enumerate(distances):
            row, left = height // 2, width // 2 - distance // 2
            truth = np.zeros(P.volume_shape, P.dtype)
            truth[z, row, [left, left + distance]] = 1.0
            image = P.forward(truth)
            image *= photons / max(float(image.sum()), float(np.finfo(P.dtype).tiny))
            if seed is not None:
                # different noise for each distance, but equal for all planes, so that planes can be compared.
                image = np.random.default_rng(seed + k).poisson(np.maximum(image, 0)).astype(P.dtype)
            volume = richardson_lucy(P, image, iterations).volume
            dips.append(dip(volume[z, row].astype(np.float64), left, left + distance))
            yield clock.at(z * len(distances) + k + 1)
        apart = [d for d, value in zip(distances, dips, strict=True) if value < limit]
        # the smallest distance above which all are resolved
        best = next((d for k, d in enumerate(distances) if all(v < limit for v in dips[k:])), float("inf"))
        results.append(TwoPoint(z, float(P.depths[z]), float(best) if apart else float("inf"), tuple(dips)))
    return tuple(results)


two_point = drained(
    iter_two_point,
    """
    Examples
    --------
    >>> from lfcal.psf import open_psf
    >>> from lfcal.reconstruct import Projector, TwoPoint, two_point
    >>> with open_psf("H.h5") as H:
    ...     P = Projector(H, (20, 30), method="direct")
    ...     found: tuple[TwoPoint, ...] = two_point(P, (2, 4, 6), iterations=10, seed=None)
    >>> for plane in found:
    ...     print(f"plane at {plane.depth_um / 1000:.0f} mm: apart from {plane.distance:.0f} voxels on")
    plane at -20 mm: apart from 4 voxels on
    plane at -26 mm: apart from 6 voxels on
    """,
)
