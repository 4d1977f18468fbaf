"""Depth from one frame of a Fourier light-field microscope: disparity between elemental images.

Each lenslet images the whole field through its part of the pupil. Let c be the position of a lenslet from the optical
axis at o. A point at the depth z and the lateral position X then appears at o + c + m X + w c/cos θ. Here m is the
magnification, and θ is the angle of the lenslet's light in the object. The slope of these cameras is
w = -z B M²/(n f²), as given by `PupilLenslets.spread`. By the sine condition, sin θ = |c| M/(n f) (Guo et al. 2019,
Opt. Express 27, 25573). Elemental images are therefore views that move along c with the depth.
"""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, Work, drain, drained
from lfcal.camera import Camera, Microscope, PupilLenslets
from lfcal.lattice._depth_map import DepthMap, half_window
from lfcal.lattice._depth_views import MovedViews, iter_swept, map_of_views, planes_between

__all__ = ["elemental_depth", "elemental_lenses", "elemental_seconds", "iter_elemental_depth"]

Image = NDArray[np.float32]
Array = NDArray[np.float64]

BLUR_PX = 16.0
"""Blur of an elemental image up to which depths are searched (diameter, pixels): beyond it, little texture is left."""

LIT = 0.2
"""White light below which pixels are left out, relative to the brightest pixels of the white image."""

LARGEST_SINE = 0.99
"""Largest sine of the angle of a lenslet's light in the object, relative to the index of the medium."""

SAMPLES = 15
"""Number of points across a lenslet from which its mean position is computed."""

FORECAST_PLANES = 3
"""Number of planes whose time is measured for a forecast."""


class ElementalLenses(NamedTuple):
    """Elemental images: centres relative to the optical axis, and displacements per unit of slope.

    Both are ``(n, 2)`` as (row, column), in px.
    """

    centres: Array
    moves: Array


def elemental_lenses(camera: Camera) -> ElementalLenses:
    """Return the positions of the elemental images of a Fourier light-field microscope, and their displacements.

    Elemental images are blurred by defocus. Their positions are means over the part of each lenslet that is inside the
    pupil.

    Raises
    ------
    InputError
        If the camera is not a Fourier light-field microscope.
    """
    lattice, optics = _described(camera)
    centres = np.array(lattice.lens_centres_um)[:, ::-1]
    rate = optics.magnification / (optics.medium_index * lattice.fourier_um)
    grid = (np.arange(SAMPLES) + 0.5) / SAMPLES * 2 - 1
    parts = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    if lattice.aperture == "round":
        parts = parts[np.hypot(*parts.T) <= 1]
    places = centres[:, None] + parts * lattice.clear_um / 2
    sine = np.hypot(*np.moveaxis(places, -1, 0)) * rate
    lit = sine <= min(optics.numerical_aperture / optics.medium_index, LARGEST_SINE)
    # a lenslet outside the pupil is described wrongly; the nearest light represents it
    lit |= (~lit.any(1))[:, None] & (sine <= sine.min(1)[:, None])
    share = (lit / lit.sum(1)[:, None])[..., None]
    slant = places / np.sqrt(1 - np.minimum(sine, LARGEST_SINE) ** 2)[..., None]
    bent = (places - centres[:, None]) * (1 - lattice.gap_um / lattice.focal_um)[:, None, None]
    pixel = camera.sensor.pixel_um
    return ElementalLenses((centres + (share * bent).sum(1)) / pixel, (share * slant).sum(1) / pixel)


def iter_elemental_depth(
    frame: ArrayLike,
    camera: Camera,
    *,
    origin: tuple[float, float] = (0.0, 0.0),
    white: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    slopes: tuple[float, float] | None = None,
    workers: int | None = None,
) -> Work[DepthMap]:
    """Compute the depth map of a frame of a Fourier light-field microscope, and return it.

    The map has the pixels of the elemental image of the lenslet nearest to the optical axis. A slope is the relative
    displacement of the elemental images, as returned by `sensor_slope`. As in `depth_map`, depths without texture are
    NaN.

    Parameters
    ----------
    frame
        Frame ``(rows, columns)`` without its dark level; NaN and infinity are ignored.
    camera
        Camera, whose lenslet centres must be correct within a fraction of a pixel (`lfcal white`, `lfcal fit`).
    origin
        Sensor position (row, column) of the first pixel of the frame (px).
    white
        White image of the same shape without its dark level, to correct the fall-off of light. None: no correction.
        In both cases, each elemental image is then scaled to a mean of 1.
    mask
        Boolean mask ``(rows, columns)``, true at pixels to leave out; None: all pixels are used.
    slopes
        Smallest and largest slope to search. None: the range in which elemental images are blurred by less than 16 px.
    workers
        Number of threads; None: one for each available CPU core.

    Yields
    ------
    Progress
        After each plane.

    Raises
    ------
    InputError
        If the camera is not a Fourier light-field microscope, or the frame contains the centres of fewer than two
        elemental images. Also if the shapes differ, or ``slopes`` are not in order.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.base import drain
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import iter_elemental_depth
    >>> camera = preset("flfm_20x05")
    >>> found = drain(iter_elemental_depth(np.ones(camera.sensor.shape), camera, slopes=(0.0, 0.005)))
    >>> print(f"{found.known.mean():.0%} known: a uniform frame has no texture")
    0% known: a uniform frame has no texture
    """
    views, place, shift = _views(frame, camera, origin, white, mask)
    low, high = _slopes(camera, slopes)
    planes = planes_between(low, high, shift)
    found = yield from iter_swept(views, planes, half_window(math.inf), workers)
    central = int(np.hypot(*views.moves.T).argmin())
    seen = views.good[central] > 0
    image = views.light[central] + seen.astype(np.float32)
    return map_of_views(found, shift, seen, image, (place, (1.0, 1.0)))


elemental_depth = drained(
    iter_elemental_depth,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import elemental_depth, metric_depth
    >>> camera = preset("flfm_20x05")
    >>> found = elemental_depth(np.ones(camera.sensor.shape), camera, slopes=(-0.005, 0.005))
    >>> print(found.slope.shape, f"{found.known.mean():.0%} known: a uniform frame has no texture")
    (385, 385) 0% known: a uniform frame has no texture
    """,
)


def elemental_seconds(
    frame: ArrayLike,
    camera: Camera,
    *,
    origin: tuple[float, float] = (0.0, 0.0),
    slopes: tuple[float, float] | None = None,
) -> float:
    """Predict the CPU time (s) of `elemental_depth`, extrapolated from the measured time of a few planes.

    The parameters are as in `elemental_depth`.
    """
    _, _, shift = _views(frame, camera, origin, None, None)
    low, high = _slopes(camera, slopes)
    step = (high - low) / (len(planes_between(low, high, shift)) - 1)
    few, seconds = (low, low + FORECAST_PLANES * step), 0.0
    for _ in range(2):  # the first time, kernels are loaded
        begin = time.thread_time()
        drain(iter_elemental_depth(frame, camera, origin=origin, slopes=few, workers=1))
        seconds = time.thread_time() - begin
    return seconds * len(planes_between(low, high, shift)) / len(planes_between(*few, shift))


def _described(camera: Camera) -> tuple[PupilLenslets, Microscope]:
    lattice, optics = camera.lattice, camera.optics
    if not isinstance(lattice, PupilLenslets) or not isinstance(optics, Microscope):
        wanted = "a Fourier light-field microscope"
        raise InputError.expected("camera", wanted, f"{camera.name}, which has a lattice", "use depth_map")
    return lattice, optics


def _slopes(camera: Camera, slopes: tuple[float, float] | None) -> tuple[float, float]:
    """Return the range of slopes to search."""
    if slopes is None:
        most = BLUR_PX * camera.sensor.pixel_um / camera.lattice.clear_diameter_um
        return -most, most
    if not slopes[0] < slopes[1]:
        got = f"{slopes[0]:g},{slopes[1]:g}"
        raise InputError.expected(
            "slopes", "smallest,largest", got, "give two different numbers, the smaller one first"
        )
    return slopes


def _views(
    frame: ArrayLike,
    camera: Camera,
    origin: tuple[float, float],
    white: ArrayLike | None,
    mask: ArrayLike | None,
) -> tuple[MovedViews, tuple[float, float], float]:
    """Return the elemental images, the position of the central one's first sample, and the largest shift per slope."""
    light, good = _light(frame, white, mask)
    lattice, _ = _described(camera)
    lenses = elemental_lenses(camera)
    axis = np.array(camera.sensor.centre_px) + np.array(lattice.offset_um)[::-1] / camera.sensor.pixel_um
    centres = lenses.centres + axis - np.array(origin)
    inside = ((centres >= 0) & (centres <= np.array(light.shape) - 1)).all(1)
    if np.count_nonzero(inside) < 2:
        got = f"{np.count_nonzero(inside)} in {light.shape[0]} x {light.shape[1]} px"
        remedy = "use the frame of this camera, or give the position of its first pixel (--origin)"
        raise InputError.expected("elemental images", "the centres of two or more in the frame", got, remedy)
    centres, moves = centres[inside], lenses.moves[inside]
    radius = lattice.spacing_um / camera.sensor.pixel_um / 2
    half = math.floor(radius)
    corners = np.rint(centres).astype(np.intp) - half
    central = int(np.hypot(*lenses.centres[inside].T).argmin())
    fixed = centres - np.rint(centres)
    moves, fixed = moves - moves[central], fixed - fixed[central]
    cut = [_cut(light, good, corner, 2 * half + 1) for corner in corners]
    y, x = np.indices((2 * half + 1, 2 * half + 1)) - half
    images, weights = (np.stack(some) for some in zip(*cut, strict=True))
    weights *= np.hypot(y, x) <= radius
    # lenslets at the edge of the pupil have less light; small numbers lose less in sums of squares
    level = (images * weights).sum((1, 2)) / np.maximum(weights.sum((1, 2)), 1)
    weights *= (level > 0)[:, None, None]  # a blank elemental image shows no object
    images = np.where(weights > 0, images / np.where(level > 0, level, 1)[:, None, None] - 1, 0).astype(np.float32)
    place = (float(corners[central, 0]), float(corners[central, 1]))
    return MovedViews(images, weights, moves, fixed), place, float(np.hypot(*moves.T).max())


def _light(frame: ArrayLike, white: ArrayLike | None, mask: ArrayLike | None) -> tuple[Image, Image]:
    """Return the light of the pixels relative to the white image, and weights of 0 or 1."""
    light = np.array(frame, np.float32)
    good = np.isfinite(light)
    for what, one in (("white image", white), ("mask", mask)):
        if one is not None and np.shape(one) != light.shape:
            remedy = "use one with the sensor settings of the frame"
            raise InputError.expected(what, f"shape {light.shape}", f"shape {np.shape(one)}", remedy)
    if mask is not None:
        good &= ~np.asarray(mask, np.bool_)
    if white is not None:
        lit = np.asarray(white, np.float32)
        good &= lit >= LIT * np.nanpercentile(lit, 99)
        light /= np.where(good, lit, np.float32(1))
    return np.where(good, light, np.float32(0)), good.astype(np.float32)


def _cut(light: Image, good: Image, corner: NDArray[np.intp], side: int) -> tuple[Image, Image]:
    """Return a square of both, with zeros outside the frame."""
    images = np.zeros((2, side, side), np.float32)
    top, left = (max(int(c), 0) for c in corner)
    bottom, right = (min(int(c) + side, n) for c, n in zip(corner, light.shape, strict=True))
    into = (slice(top - corner[0], bottom - corner[0]), slice(left - corner[1], right - corner[1]))
    for image, source in zip(images, (light, good), strict=True):
        image[into] = source[top:bottom, left:right]
    return images[0], images[1]
