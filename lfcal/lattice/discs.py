"""Centres of a few large discs in a white image: the elemental images of a Fourier light-field microscope."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, format_pixels
from lfcal.camera import Camera, PupilLenslets

__all__ = ["LensletDiscs", "fit_discs"]

F8 = NDArray[np.float64]

INNER = 0.6
"""Fraction of the largest distance to the edge above which a pixel belongs to the middle of a disc."""

ANGLES = 360
"""Directions in which the edge of a disc is searched for."""

STEP_PX = 0.25
"""Step along each direction (pixels)."""

BEYOND = 1.2
"""Distance up to which the edge is searched for, in radii; touching discs have no edge between them."""

EDGES = 0.5
"""Fraction of the pairs of opposite edges that must be found."""

AROUND_PX = (2.0, 5.0)
"""Distances from an edge at which the light just outside and the uniform light inside are measured (pixels)."""

FAR = 3.0
"""Deviation beyond which an edge is not used (standard deviations of the edges)."""

ROUNDS = 12
"""Largest number of corrections of a centre."""


@dataclass(frozen=True, eq=False)
class LensletDiscs:
    """Located discs of light behind the lenslets of a camera, in the order of its lenslets.

    Attributes
    ----------
    centres_px
        Centres (row, column) of the discs, ``(n, 2)`` (px).
    errors_px
        Standard error of each centre along one axis, ``(n,)`` (px), estimated from the scatter of the edge of the disc.
    radii_px
        Mean radius of each disc, ``(n,)`` (px).
    camera
        Copy of the camera with the lenslets at the measured positions; the position of the optical axis is unchanged.
    """

    centres_px: F8
    errors_px: F8
    radii_px: F8
    camera: Camera


def fit_discs(white: ArrayLike, camera: Camera) -> LensletDiscs:
    """Locate the discs of light behind the lenslets of a Fourier light-field microscope with subpixel accuracy.

    Discs may touch, and their brightness may decrease towards their edges. They must be point-symmetric about their
    centres (round or square).

    Parameters
    ----------
    white
        White image ``(rows, columns)`` of a uniform field, or of the lenslets in the pupil.
    camera
        Description of the camera.

    Raises
    ------
    InputError
        If the camera has a periodic lattice, or the frame does not show the whole sensor. Also if the numbers of discs
        and lenslets differ, a disc is truncated by the edge of the frame, or the discs are far from the positions in
        the description.

    Examples
    --------
    >>> import numpy as np
    >>> from dataclasses import replace
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import fit_discs
    >>> camera = preset("flfm_20x05")
    >>> rows, columns = np.indices(camera.sensor.shape)
    >>> white = np.zeros(camera.sensor.shape)
    >>> for x, y in camera.lattice.lens_centres_um:
    ...     row, column = camera.pixels((x + 13, y))  # displaced by two pixels
    ...     white[np.hypot(rows - row, columns - column) < 150] = 1000.0
    >>> found = fit_discs(white, camera)
    >>> print(type(found).__name__, np.round(found.camera.lattice.lens_centres_um[1]) == (2513, 0))
    LensletDiscs [ True  True]
    """
    lenslets, light = camera.lattice, np.asarray(white, np.float64)
    if not isinstance(lenslets, PupilLenslets):
        raise InputError.expected(
            "camera", "a Fourier light-field microscope", f"{camera.name}, which has a lattice", "use fit_lattice"
        )
    if light.shape != camera.sensor.shape:
        wanted = f"{format_pixels(camera.sensor.shape)}, as {camera.name} has"
        raise InputError.expected("white image", wanted, format_pixels(light.shape), "use a whole frame of this camera")
    seeds, levels = _seeds(light)
    count = len(lenslets.lens_centres_um)
    if len(seeds) != count:
        remedy = "correct the lenslet centres in the description of the camera, or record an evenly lit white image"
        raise InputError.expected(
            "separate discs in the white image", f"{count}, one for each lenslet of {camera.name}", len(seeds), remedy
        )
    found = [_fitted(light, levels, *seed) for seed in seeds]
    centres = np.array([centre for centre, _, _ in found])
    order = _in_order(centres, camera)
    errors, radii = (np.array([one[k] for one in found])[order] for k in (1, 2))
    places = camera.sensor_um(centres[order]) - np.array(lenslets.offset_um)
    lattice = replace(lenslets, lens_centres_um=tuple(map(tuple, places.tolist())))
    marks = camera.marks.marked(["lattice.lens_centres_um"], "measured")
    return LensletDiscs(centres[order], errors, radii, replace(camera, lattice=lattice, marks=marks))


def _seeds(light: F8) -> tuple[list[tuple[F8, float]], tuple[float, float]]:
    """Return middle and rough radius of each disc, the level between light and dark, and the dark level."""
    from lfcal.base import cv2

    finite = np.where(np.isfinite(light), light, 0.0)
    low, high = np.percentile(finite, (1, 99))
    if high <= low:
        raise InputError.expected("white image", "bright discs on a dark background", "even light", "check the frame")
    scaled = np.clip(255 * (finite - low) / (high - low), 0, 255).astype(np.uint8)
    _, mask = cv2.threshold(cv2.medianBlur(scaled, 5), 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    # a border without light, so that discs at the frame's edge end there
    inside = cv2.distanceTransform(np.pad(mask, 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
    count, labels, _, middles = cv2.connectedComponentsWithStats((inside > INNER * inside.max()).astype(np.uint8))
    found = [(np.array(middles[k][::-1], np.float64), float(inside[labels == k].max())) for k in range(1, count)]
    # half the light of the discs: the threshold itself may be either level of an image without noise
    dark, bright = (float(np.median(finite[own])) for own in (mask == 0, mask > 0))
    return found, ((dark + bright) / 2, dark)


def _fitted(light: F8, levels: tuple[float, float], middle: F8, radius: float) -> tuple[F8, float, float]:
    """Return centre, its standard deviation, and radius of a disc, from pairs of opposite edges."""
    angles = np.arange(ANGLES) * 2 * np.pi / ANGLES
    ways = np.stack([np.sin(angles), np.cos(angles)], axis=1)
    half = ANGLES // 2
    centre, scatter, radii = middle, math.inf, np.full(ANGLES, radius)
    for _ in range(ROUNDS):
        radii = _edges(light, levels, centre, ways, radius)
        apart = (radii[:half] - radii[half:]) / 2
        seen = np.isfinite(apart)
        if seen.mean() < EDGES:
            row, column = centre
            raise InputError.expected(
                f"disc at row {row:.0f}, column {column:.0f}",
                "its whole edge on the frame",
                "only a part of it",
                "record a frame with the whole disc",
            )
        step, *_ = np.linalg.lstsq(ways[:half][seen], apart[seen], rcond=None)
        # edges next to a touching disc contain its light too
        left = np.abs(apart - ways[:half] @ step)
        seen &= left <= FAR * 1.4826 * np.median(left[seen]) + 1e-6
        step, *_ = np.linalg.lstsq(ways[:half][seen], apart[seen], rcond=None)
        left = apart[seen] - ways[:half][seen] @ step
        scatter = float(np.sqrt(np.square(left).mean() / (np.count_nonzero(seen) / 2)))
        centre = centre + step
        if np.abs(step).max() < 1e-3:
            break
    return centre, scatter, float(np.nanmean(radii))


def _edges(light: F8, levels: tuple[float, float], centre: F8, ways: F8, radius: float) -> F8:
    """Return the distance of the edge in each direction; NaN where there is none within `BEYOND`."""
    from scipy.ndimage import map_coordinates  # slow to import

    level, dark = levels
    reach = np.arange(INNER * radius, BEYOND * radius + 2, STEP_PX)
    at = centre[:, None, None] + ways.T[:, :, None] * reach
    values = map_coordinates(light, at.reshape(2, -1), order=1, mode="constant", cval=np.nan).reshape(len(ways), -1)
    below = values < level
    first, rows = np.argmax(below, axis=1), np.arange(len(ways))
    good = below.any(1) & (first > round(AROUND_PX[1] / STEP_PX))
    # the light from well inside to just outside, over that inside: unlike a crossing, it is the same for any position
    # of the edge within a pixel
    inner, outer = (np.clip(first - round(k / STEP_PX), 0, len(reach) - 1) for k in AROUND_PX)
    beyond = np.minimum(first + round(AROUND_PX[0] / STEP_PX), len(reach) - 1)
    sums = np.cumsum(values - dark, axis=1)
    plateau = (sums[rows, inner] - sums[rows, outer]) / np.maximum(inner - outer, 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        found = reach[outer] + STEP_PX * ((sums[rows, beyond] - sums[rows, outer]) / plateau + 0.5)
    return np.where(good & np.isfinite(found), found, np.nan)


def _in_order(centres: F8, camera: Camera) -> NDArray[np.intp]:
    """Return the index of each lenslet's disc, from the assignment with the smallest sum of squared distances."""
    from scipy.optimize import linear_sum_assignment  # slow to import

    lenslets = camera.lattice
    assert isinstance(lenslets, PupilLenslets)
    places = camera.pixels(np.array(lenslets.lens_centres_um) + np.array(lenslets.offset_um))
    # the whole array may be displaced
    away = np.hypot(*(places[:, None] - places.mean(0) - centres[None] + centres.mean(0)).transpose(2, 0, 1))
    rows, order = linear_sum_assignment(np.square(away))
    spacing = lenslets.spacing_um / camera.sensor.pixel_um
    if away[rows, order].max() > spacing / 2:
        far = f"one {away[rows, order].max():.0f} px away"
        raise InputError.expected(
            "discs",
            f"positions near the lenslets of {camera.name}",
            far,
            "correct the lenslet centres in the description of the camera",
        )
    found: NDArray[np.intp] = order
    return found
