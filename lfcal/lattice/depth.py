"""Depth maps from one light-field frame: disparity between micro-images, or between views.

A point of slope w (`sensor_slope`) whose chief ray meets the sensor at S appears at c + (S - c)/w below the lenslet at
c. Focused plenoptic cameras show it in several micro-images, whose disparity is their distance divided by w. Each
micro-image is matched with its neighbours (Perwass and Wietzke 2012; Fleischmann and Koch 2014, Palmieri and Koch 2017
for several lens types). The depths of all micro-images are joined in the central view by their standard errors (Zeller,
Quint and Stilla 2015). In cameras whose lenslets are focused at infinity, a micro-image shows the aperture. The slope
is then the slope of the epipolar lines between views (Wanner and Goldluecke 2012). It is found from the variance of the
views on a sweep of planes (Tao et al. 2013), with shifts of fractions of a sample (Jeon et al. 2015).
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import (
    Clock,
    InputError,
    Work,
    check_choice,
    check_number,
    chunks,
    drain,
    drained,
    for_each_chunk,
    format_pixels,
)
from lfcal.camera import Camera, Microscope, PupilLenslets
from lfcal.lattice._depth_kernels import Lenslets, Matching, Raster, join_rows, match_lenslets
from lfcal.lattice._depth_map import FLOOR, METHODS, DepthMap, confidence_of, half_window, supported
from lfcal.lattice._depth_views import MovedViews, iter_swept, map_of_views, planes_between
from lfcal.lattice._refocus import sensor_slope, virtual_depth_of_slope
from lfcal.lattice._view_grid import ViewGrid, view_grid
from lfcal.lattice.elemental_depth import elemental_lenses
from lfcal.lattice.lens_types import expected_blur
from lfcal.lattice.micro_images import FrameLattice, TypeOf, cropped
from lfcal.lattice.rendering import render
from lfcal.lattice.views import RADIUS, extract_views, sample_views, subtract_dark

__all__ = ["depth_map", "depth_seconds", "iter_depth_map", "metric_depth"]

Image = NDArray[np.float32]
Array = NDArray[np.float64]

MIN_SLOPE = 1.5
"""Smallest slope for matching micro-images: nearer to the lenslets, two of them hardly show the same place."""

VIEW_SLOPE = 8.0
"""Largest slope for matching views if no range is given."""

REACH = 1.8
"""Largest distance of micro-images that are compared (pitches): neighbours, and the nearest of the same type."""

STEP_PX = 0.5
"""Step of the disparity of neighbouring micro-images (pixels)."""

LIT = 0.2
"""White light below which pixels are left out, relative to the brightest."""

SAMPLE_PX = 4.0
"""Approximate distance of the samples of the central view with matched micro-images (pixels)."""

VIEWS_FOCUS = 20.0
"""Virtual depth in focus beyond which lenslets are focused at infinity."""

SHARED = 3.8
"""Number of pixels that share the noise of one after the filter (1, 2, 1)."""

BIAS_PX = 0.04
"""Systematic error of disparities due to windows on slanted surfaces, added to their standard error (pixels)."""

COMPLETE = 0.85
"""Smallest weight of the good pixels about a pixel: one of the eight may be missing."""

MIN_DISPARITY_PX = 0.75
"""Smallest disparity of neighbouring micro-images (pixels)."""

PARTS = 40
"""Number of parts after which progress is reported."""

LEVELS = 12
"""Number of planes on which the central view of micro-images is rendered."""

FORECAST_PITCHES = 24.0
"""Side of the part of the frame that is measured for a forecast (pitches)."""


def iter_depth_map(
    frame: ArrayLike,
    lattice: FrameLattice,
    *,
    white: ArrayLike | None = None,
    dark: ArrayLike | float = 0.0,
    mask: ArrayLike | None = None,
    camera: Camera | None = None,
    type_of: TypeOf | None = None,
    method: str = "auto",
    slopes: tuple[float, float] | None = None,
    radius_px: float | None = None,
    workers: int | None = None,
) -> Work[DepthMap]:
    """Compute the depth map of the central view of a light-field frame, and return it.

    The depth can be determined only where the scene has texture. Elsewhere, it is NaN and is not interpolated.

    Parameters
    ----------
    frame
        Light-field frame ``(rows, columns)``; NaN and infinity are ignored.
    lattice, white, dark
        As in `extract_views`. Without a white frame, the fall-off of light within the micro-images is estimated from
        the frame.
    mask
        Boolean mask ``(rows, columns)``, true at pixels to leave out. None: all pixels are used.
    camera
        Camera, from which the range of slopes, the blur of the lens types and the method are derived. None: unknown.
    type_of
        Function that returns the lens types of lenslets (q, r): `LensTypes.type_of`, or `LensletLattice.type_of` if
        ``lattice`` is the lattice of the camera. Comparisons of lenslets with different blur then have less weight.
        None: a single type.
    method
        ``"micro-images"``: match each micro-image with its neighbours, for lenslets that are focused on the scene.
        ``"views"``: compare the views refocused on several planes, for lenslets focused at infinity. ``"auto"``: choose
        by the focus of the camera's lenslets. Without a camera, ``"auto"`` chooses ``"views"`` if ``slopes`` are
        between -1.5 and 1.5. Otherwise, it chooses the method with the higher mean confidence in the middle of the
        frame.
    slopes
        Smallest and largest slope to consider (see `sensor_slope`). None: for ``"micro-images"``, the slopes that the
        camera's lenslets show, or without a camera all slopes beyond ±1.5; for ``"views"``, -8 to 8.
    radius_px
        Radius of the micro-images (px). None: 0.45 times the smaller of pitch and row pitch.
    workers
        Number of threads. None: one for each available CPU core.

    Yields
    ------
    Progress
        After each processed part of the frame.

    Raises
    ------
    InputError
        If the shape of a frame or of the mask differs from that of the lattice, or no micro-image is complete. Also if
        ``radius_px`` is less than 2 or more than the pitch, or ``slopes`` are outside the limits of the method.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import DepthMap, depth_map, lattice_of
    >>> camera = preset("bench")
    >>> lattice = lattice_of(camera)
    >>> pixels = np.moveaxis(np.indices(lattice.shape), 0, -1)
    >>> centres = lattice.centres_px(*np.rint(lattice.lenslet_at(*np.indices(lattice.shape))).transpose(2, 0, 1))
    >>> row, column = np.moveaxis(centres + 2.5 * (pixels - centres), -1, 0)  # the plane of slope 2.5
    >>> found: DepthMap = depth_map(2 + np.sin(row / 3) + np.sin(column / 4), lattice, camera=camera)
    >>> print(found.method, f"{np.nanmedian(found.slope):.1f}")
    micro-images 2.5
    """
    check_choice("method", method, METHODS)
    radius = _radius(lattice, radius_px)
    if method == "auto":
        method = _method_for(camera, slopes)
    scene = _Scene.of(frame, lattice, white, dark, mask, radius)
    if not method:
        part = scene.middle()
        method = max(METHODS[1:], key=lambda name: _explained(part, name, slopes, workers))
    return (yield from _iter_by(method, scene, camera, type_of, slopes, workers))


depth_map = drained(iter_depth_map)


def depth_seconds(
    frame: ArrayLike,
    lattice: FrameLattice,
    *,
    white: ArrayLike | None = None,
    dark: ArrayLike | float = 0.0,
    mask: ArrayLike | None = None,
    camera: Camera | None = None,
    type_of: TypeOf | None = None,
    method: str = "auto",
    slopes: tuple[float, float] | None = None,
    radius_px: float | None = None,
) -> float:
    """Predict the CPU time (s) of `depth_map` with the same parameters.

    The middle of the frame is processed, and the measured time is scaled by the number of pairs of adjacent
    micro-images.

    Raises
    ------
    InputError
        As in `depth_map`.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import depth_seconds, lattice_of
    >>> camera = preset("bench")
    >>> lattice = lattice_of(camera)
    >>> print(0 < depth_seconds(np.ones(lattice.shape), lattice, camera=camera) < 60)
    True
    """
    begin = time.thread_time()
    scene = _Scene.of(frame, lattice, white, dark, mask, _radius(lattice, radius_px))
    prepared, part = time.thread_time() - begin, scene.middle(FORECAST_PITCHES)
    chosen = _method_for(camera, slopes) or METHODS[1] if method == "auto" else method
    for _ in range(2):  # the first time, kernels are loaded
        begin = time.thread_time()
        drain(_iter_by(chosen, part, camera, type_of, slopes, workers=1))
    # most of the time goes into pairs of micro-images, of which there are fewer at the edge
    whole, few = (int((_near(one) >= 0).sum()) or 1 for one in (scene, part))
    return prepared + (time.thread_time() - begin) * whole / few


def metric_depth(
    found: DepthMap,
    camera: Camera,
    *,
    origin: tuple[int, int] = (0, 0),
    measured: Sequence[tuple[float, float]] = (),
) -> DepthMap:
    """Return a copy of a depth map with depths and lateral positions (µm), corrected with planes of known depth.

    Parameters
    ----------
    found
        Depth map returned by `depth_map` or `elemental_depth`.
    camera
        Camera with which the frame was recorded.
    origin
        Sensor position (row, column) of the first pixel of the frame (px).
    measured
        Known depth (µm) and measured slope of each calibration plane, for example from H. A line fitted to them
        corrects the slopes before they are converted; a single plane corrects only their scale. Empty: no correction.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import DepthMap, metric_depth, sensor_slope
    >>> camera = preset("bench")
    >>> slope = np.full((1, 1), sensor_slope(camera, -20e3), np.float32)
    >>> one = np.ones((1, 1), np.float32)
    >>> found = DepthMap(slope, 0.01 * one, one, one, "micro-images", (159.5, 259.5), (4.0, 4.0), 11.0)
    >>> known = metric_depth(found, camera)
    >>> print(known.z_um.round(-1), known.points()[0].round(-1))
    [[-20000.]] [[  2550.      0. -20000.]]
    """
    wanted = np.array([sensor_slope(camera, z) for z, _ in measured])
    seen = np.array([slope for _, slope in measured], float)
    scale, offset = 1.0, 0.0
    if len(seen) > 1 and np.ptp(seen) > 0:
        scale, offset = (float(v) for v in np.polyfit(seen, wanted, 1))
    elif len(seen) and seen[0]:
        scale = float(wanted[0] / seen[0])
    slope, sigma = scale * found.slope.astype(float) + offset, abs(scale) * found.sigma.astype(float)
    z = _depths_of(camera, slope)
    small = 1e-4 * np.maximum(np.abs(slope), 1)
    z_sigma = np.abs(_depths_of(camera, slope + small) - _depths_of(camera, slope - small)) / (2 * small) * sigma
    # the lateral step is a linear function of the depth
    step = camera.step_um(0.0) + (camera.step_um(1.0) - camera.step_um(0.0)) * z
    places = found.places_px() + np.array(origin) - np.array(camera.sensor.centre_px)
    if isinstance(camera.lattice, PupilLenslets):
        places = places - _displaced(found, camera, places)
    across = places * step[..., None]
    return replace(found, z_um=z.astype(np.float32), z_sigma_um=z_sigma.astype(np.float32), across_um=across)


def _displaced(found: DepthMap, camera: Camera, places: Array) -> Array:
    """Return how far the lenslet that shows the map displaces the points from the axis ``(rows, columns, 2)`` (px).

    ``places`` are relative to the centre of the sensor.
    """
    lenses = elemental_lenses(camera)
    axis = np.array(camera.lattice.offset_um)[::-1] / camera.sensor.pixel_um
    middle = places[found.slope.shape[0] // 2, found.slope.shape[1] // 2]
    k = int(np.hypot(*(lenses.centres + axis - middle).T).argmin())
    displaced: Array = axis + lenses.centres[k] + found.slope[..., None] * lenses.moves[k]
    return displaced


def _depths_of(camera: Camera, slope: Array) -> Array:
    """Return the depths (µm) of slopes; NaN beyond an object at infinity. Inverse of `sensor_slope`, for arrays."""
    optics, gap = camera.optics, camera.lattice.gap_um
    if isinstance(camera.lattice, PupilLenslets) and isinstance(optics, Microscope):
        of_one: Array = slope / camera.lattice.spread(optics, 1.0)
        return of_one
    if isinstance(optics, Microscope):
        depths: Array = -slope * gap * optics.medium_index / optics.magnification**2
        return depths
    b, f = optics.image_distance_um, optics.focal_length_um
    left = b + gap - slope * gap
    image = b + slope * b * gap / np.where(left > 0, left, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        result: Array = np.where((left > 0) & (image > f), 1 / (1 / f - 1 / image) - optics.working_distance_um, np.nan)
    return result


@dataclass(frozen=True, eq=False)
class _Scene:
    """Light of the pixels relative to the white frame with mean 1, weights of 0 or 1, white light, and the lattice."""

    light: Image
    good: Image
    lit: Image
    lattice: FrameLattice
    radius: float
    centres: Array
    index: NDArray[np.intp]

    @classmethod
    def of(
        cls,
        frame: ArrayLike,
        lattice: FrameLattice,
        white: ArrayLike | None,
        dark: ArrayLike | float,
        mask: ArrayLike | None,
        radius: float,
    ) -> _Scene:
        """Return the scene of a frame: bad pixels are left out, and the fall-off in the micro-images is removed."""
        values = np.asarray(frame)
        bad = ~np.isfinite(values) if values.dtype.kind == "f" else np.zeros(values.shape, np.bool_)
        if mask is not None:
            given = np.asarray(mask, np.bool_)
            if given.shape != bad.shape:
                raise InputError.expected(
                    "mask", f"shape {bad.shape}", f"shape {given.shape}", "use a mask for these frames"
                )
            bad = bad | given
        light = subtract_dark(np.where(bad, 0, values), dark, lattice, "light-field frame")
        bad = bad | _hot(light)
        index, centres = _lenslets(lattice, radius)
        if white is None:
            # a little beyond the radius, so that the filter is complete at the rim
            lit = _own_white(light, ~bad, centres, max(radius, min(radius + 1.5, lattice.pitch_px / 2)))
        else:
            lit = subtract_dark(white, dark, lattice, "white frame")
            lit /= np.float32(max(float(np.percentile(lit, 99)), 1e-30))
        good = (lit >= LIT) & ~bad
        light = np.where(good, light / np.maximum(lit, LIT), 0).astype(np.float32)
        light /= np.float32(max(float(light.sum() / max(good.sum(), 1)), 1e-30))
        return cls(light, good.astype(np.float32), lit, lattice, radius, centres, index)

    def middle(self, pitches: float = 30.0) -> _Scene:
        """Return the middle of the frame."""
        size = [min(n, math.ceil(pitches * self.lattice.pitch_px)) for n in self.light.shape]
        top, left = ((n - k) // 2 for n, k in zip(self.light.shape, size, strict=True))
        part = (slice(top, top + size[0]), slice(left, left + size[1]))
        lattice = cropped(self.lattice, size, (top, left))
        index, centres = _lenslets(lattice, self.radius)
        light, good, lit = (np.ascontiguousarray(one[part]) for one in (self.light, self.good, self.lit))
        return _Scene(light, good, lit, lattice, self.radius, centres, index)

    def raster(self, samples: int) -> tuple[Raster, tuple[int, int]]:
        """Return the samples of the central view, several per lenslet, and their rows and columns."""
        grid = view_grid(self.lattice, self.light.shape, float(np.floor(self.radius)))
        corner = [c + (0.5 / samples - 0.5) * s for c, s in zip(grid.corner_px, grid.step_px, strict=True)]
        raster = Raster(corner[0], corner[1], grid.step_px[0] / samples, grid.step_px[1] / samples)
        return raster, (grid.shape[0] * samples, grid.shape[1] * samples)


def _lenslets(lattice: FrameLattice, radius: float) -> tuple[NDArray[np.intp], Array]:
    """Return the indices (q, r) and centres (row, column) of the lenslets whose micro-images are in the frame."""
    edges = [np.linspace(0, n - 1, 33) for n in lattice.shape]
    border = [(edges[0], 0 * edges[0]), (edges[0], 0 * edges[0] + lattice.shape[1] - 1)]
    border += [(0 * edges[1], edges[1]), (0 * edges[1] + lattice.shape[0] - 1, edges[1])]
    ends = np.concatenate([lattice.lenslet_at(y, x) for y, x in border])
    low, high = np.floor(ends.min(0)).astype(int) - 1, np.ceil(ends.max(0)).astype(int) + 1
    q, r = (v.ravel() for v in np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)))
    centres = lattice.centres_px(q, r)
    margin = math.floor(radius)
    inside = ((centres >= margin) & (centres <= np.array(lattice.shape) - 1 - margin)).all(1)
    if not inside.any():
        wanted = f"a frame with a complete micro-image of radius {radius:.1f} px"
        raise InputError.expected(
            "light-field frame", wanted, f"a frame of {format_pixels(lattice.shape)}", "use a larger frame"
        )
    order = np.argsort(centres[inside][:, 0], kind="stable")
    index: NDArray[np.intp] = np.stack([q, r], axis=-1)[inside][order]
    return index, centres[inside][order]


def _hot(light: Image) -> NDArray[np.bool_]:
    """Return the pixels that are far brighter than all of their neighbours."""
    from lfcal.base import cv2

    around = np.ones((3, 3), np.uint8)
    around[1, 1] = 0
    low, high = np.quantile(light.ravel()[::7], (0.05, 0.95))
    hot: NDArray[np.bool_] = light > 2 * np.maximum(cv2.dilate(light, around), 0) + (high - low)
    return hot


def _own_white(light: Image, good: NDArray[np.bool_], centres: Array, radius: float) -> Image:
    """Return a white frame with the fall-off in the micro-images: their mean as a function of the radius."""
    side = math.ceil(radius)
    steps = np.indices((2 * side + 1, 2 * side + 1)).reshape(2, -1).T - side
    places = np.rint(centres).astype(np.intp)[:, None, :] + steps
    inside = ((places >= 0) & (places < np.array(light.shape))).all(-1)
    arm = np.hypot(*(places - centres[:, None, :]).transpose(2, 0, 1))
    y, x = (np.where(inside, places[..., k], 0) for k in (0, 1))
    used = inside & good[y, x] & (arm <= radius)
    bins = np.minimum(np.rint(arm[used]).astype(int), side)
    total, count = np.bincount(bins, light[y, x][used], side + 1), np.bincount(bins, minlength=side + 1)
    at = np.flatnonzero(count)
    profile = total[at] / count[at]
    profile = np.maximum(profile / max(float(profile.max(initial=0)), 1e-30), LIT)
    lit = np.zeros(light.shape, np.float32)
    lit[y[used], x[used]] = np.interp(arm[used], at, profile)
    return lit


def _method_for(camera: Camera | None, slopes: tuple[float, float] | None) -> str:
    """Return the method for a camera, or for slopes that only one method allows; empty: the frame decides."""
    if camera is not None:
        gap = camera.lattice.gap_um
        return "views" if all(abs(kind.focus_depth(gap)) > VIEWS_FOCUS for kind in camera.lattice.types) else METHODS[1]
    if slopes is not None and slopes[0] < MIN_SLOPE and slopes[1] > -MIN_SLOPE:
        return "views"
    return ""


def _radius(lattice: FrameLattice, radius_px: float | None) -> float:
    """Return the radius of the micro-images (pixels)."""
    radius = RADIUS * min(lattice.pitch_px, lattice.row_pitch_px) if radius_px is None else radius_px
    check_number("radius of the micro-images (px)", radius, at_least=2, at_most=lattice.pitch_px)
    return radius


def _explained(scene: _Scene, method: str, slopes: tuple[float, float] | None, workers: int | None) -> float:
    """Return the mean confidence of a method."""
    found = drain(_iter_by(method, scene, None, None, slopes, workers))
    return float(found.confidence.mean())


def _iter_by(
    method: str,
    scene: _Scene,
    camera: Camera | None,
    types: TypeOf | None,
    slopes: tuple[float, float] | None,
    workers: int | None,
) -> Work[DepthMap]:
    """Compute the map with a method, and return it."""
    if method == "views":
        return (yield from _iter_views(scene, camera, slopes, workers))
    return (yield from _iter_micro_images(scene, camera, types, slopes, workers))


# -- micro-images --------------------------------------------------------------------------------------------------
def _iter_micro_images(
    scene: _Scene, camera: Camera | None, types: TypeOf | None, slopes: tuple[float, float] | None, workers: int | None
) -> Work[DepthMap]:
    """Match the micro-images with their neighbours, and join their depths in the central view."""
    lattice = scene.lattice
    light, good = _smoothed(scene.light, scene.good)
    kind = (0 * scene.index[:, 0] if types is None else types(*scene.index.T)).astype(np.int32)
    lenslets = Lenslets(scene.centres, _near(scene), kind, scene.radius - 0.5)
    rho = _inverse_slopes(camera, slopes, lattice.pitch_px)
    weight = _pair_weights(camera if types is not None else None, rho)
    how = Matching(rho, weight, half_window(scene.radius), _most(light, good), FLOOR**2, SHARED)
    found = np.full((2, *light.shape), np.nan, np.float32)
    clock = Clock("match micro-images", len(scene.centres))
    for first, last in chunks(len(scene.centres), PARTS):

        def match(a: int, b: int, first: int = first) -> None:
            match_lenslets(light, good, lenslets, how, found, (first + a, first + b))

        for_each_chunk(match, last - first, workers)
        yield clock.at(last)
    samples = max(1, round(min(lattice.pitch_px, lattice.row_pitch_px) / SAMPLE_PX))
    raster, shape = scene.raster(samples)
    joined = np.full((4, *shape), np.nan, np.float32)
    for_each_chunk(lambda a, b: join_rows(found, lenslets, how, raster, joined, (a, b)), shape[0], workers)
    result = _joined(joined, raster, lattice.pitch_px)
    return replace(result, image=_central(scene, result, samples, workers))


def _most(light: Image, good: Image) -> float:
    """Return the limit of squared differences: four times the variance of the scene without hot pixels."""
    low, high = np.quantile(light[good > 0][::7], (0.05, 0.95)) if good.any() else (0.0, 1.0)
    return float(4 * ((high - low) / 3.3) ** 2)


def _joined(joined: Image, raster: Raster, pitch: float) -> DepthMap:
    """Return the map of inverse slopes, standard errors, agreement and lenslets ``(4, rows, columns)``."""
    error = np.hypot(joined[1], np.float32(BIAS_PX / pitch))
    with np.errstate(divide="ignore"):
        slope = 1 / joined[0]
    # a pattern that all micro-images share has no disparity: dirt, or what is left of the fall-off
    seen = (joined[3] >= 2) & (np.abs(joined[0]) * pitch >= MIN_DISPARITY_PX)
    confidence = np.where(seen, confidence_of(error * np.float32(pitch)) * joined[2], 0).astype(np.float32)
    corner, step = (raster.corner_y, raster.corner_x), (raster.step_y, raster.step_x)
    empty = np.zeros(slope.shape, np.float32)
    return supported(DepthMap(slope, error * slope**2, confidence, empty, METHODS[1], corner, step, pitch))


def _smoothed(light: Image, good: Image) -> tuple[Image, Image]:
    """Return the light after a filter (1, 2, 1) along both axes: linear interpolation is then accurate.

    Only good pixels contribute. A pixel stays good if one neighbour is missing. At the rim of a micro-image, a whole
    row is missing, and the rest would show a point further inside.
    """
    from lfcal.base import cv2

    line = np.array([0.25, 0.5, 0.25], np.float32)
    total = cv2.sepFilter2D(light * good, -1, line, line, borderType=cv2.BORDER_REPLICATE)
    count = cv2.sepFilter2D(good, -1, line, line, borderType=cv2.BORDER_REPLICATE)
    kept = ((count >= COMPLETE) & (good > 0)).astype(np.float32)
    return np.where(kept > 0, total / np.maximum(count, COMPLETE), 0).astype(np.float32), kept


def _near(scene: _Scene) -> NDArray[np.int32]:
    """Return the numbers of the neighbours ``(n, k)`` of each lenslet; -1: none."""
    steps = np.array([(i, j) for i in range(-2, 3) for j in range(-2, 3) if (i, j) != (0, 0)])
    distance = np.hypot(*(steps @ scene.lattice.basis_px()).T)
    steps = steps[distance <= REACH * min(scene.lattice.pitch_px, float(distance.min()))]
    low = scene.index.min(0) - 2
    table = np.full(scene.index.max(0) - low + 3, -1, np.int32)
    table[tuple((scene.index - low).T)] = np.arange(len(scene.index))
    wanted = scene.index[:, None, :] + steps - low
    return np.ascontiguousarray(table[wanted[..., 0], wanted[..., 1]])


def _inverse_slopes(camera: Camera | None, slopes: tuple[float, float] | None, pitch: float) -> Array:
    """Return the inverse slopes to search: equal steps of the disparity, one step beyond the range at both ends."""
    low, high = slopes or _slopes_of(camera)
    if not low < high or (low < MIN_SLOPE and high > -MIN_SLOPE and slopes is not None):
        wanted = f"smallest and largest, both above {MIN_SLOPE:g} or both below {-MIN_SLOPE:g}"
        raise InputError.expected(
            "slopes", wanted, f"{low:g} to {high:g}", "give such a range, or use the method views"
        )
    ends = (1 / high, 1 / low) if low * high > 0 else (-1 / MIN_SLOPE, 1 / MIN_SLOPE)
    step = STEP_PX / pitch
    return np.arange(ends[0] - 1.5 * step, ends[1] + 2 * step, step)


def _slopes_of(camera: Camera | None) -> tuple[float, float]:
    """Return the slopes that lenslets of a camera show: from the lenslets to three times their farthest focus."""
    if camera is None:
        return -MIN_SLOPE, MIN_SLOPE
    focus = [kind.focus_depth(camera.lattice.gap_um) for kind in camera.lattice.types]
    far = 3 * max(abs(v) for v in focus)
    if min(focus) > 0:
        return MIN_SLOPE, far
    return (-far, -MIN_SLOPE) if max(focus) < 0 else (-MIN_SLOPE, MIN_SLOPE)


def _pair_weights(camera: Camera | None, rho: Array) -> NDArray[np.float32]:
    """Return the weights ``(m, 3, 3)`` of pairs of lens types: small if their blur differs by pixels."""
    weight = np.ones((len(rho), 3, 3), np.float32)
    if camera is None or len(camera.lattice.types) != 3:
        return weight
    diameter = camera.lattice.clear_diameter_um / camera.sensor.pixel_um
    for k, one in enumerate(rho):
        try:
            depth = virtual_depth_of_slope(camera, 1 / one)
        except (InputError, ZeroDivisionError):
            continue
        blur = diameter * np.array(expected_blur(camera, depth))
        weight[k] = 1 / (1 + (blur[:, None] - blur[None, :]) ** 2)
    return weight


def _central(scene: _Scene, found: DepthMap, samples: int, workers: int | None) -> Image:
    """Return the central view: each sample from the rendered plane nearest to its depth.

    Samples of unknown depth are taken from the plane of the median depth.
    """
    known = found.known
    levels = np.quantile(1 / found.slope[known], np.linspace(0, 1, LEVELS)) if known.any() else np.array([1 / 3])
    levels = np.unique(np.clip(levels, -1 / MIN_SLOPE, 1 / MIN_SLOPE).astype(np.float32))
    levels = levels[np.abs(levels) > 1e-3]
    planes = render(
        scene.light,
        scene.lattice,
        tuple(1 / levels),
        white=scene.good,
        radius_px=scene.radius,
        samples=samples,
        workers=workers,
    )
    wanted = np.where(known, 1 / found.slope, np.float32(np.median(levels)))
    nearest = np.abs(wanted[None] - levels[:, None, None]).argmin(0)
    image: Image = np.take_along_axis(planes.images, nearest[None], axis=0)[0]
    return image


# -- views ---------------------------------------------------------------------------------------------------------
def _iter_views(
    scene: _Scene, camera: Camera | None, slopes: tuple[float, float] | None, workers: int | None
) -> Work[DepthMap]:
    """Compare the views on planes of all slopes."""
    low, high = slopes or (-VIEW_SLOPE, VIEW_SLOPE)
    if not low < high:
        raise InputError.expected(
            "slopes", "smallest,largest", f"{low:g},{high:g}", "give two different numbers, the smaller one first"
        )
    light, good, offsets, grid = _compared(scene, workers)
    shift = float(np.abs(offsets).max()) / min(grid.step_px)
    planes = planes_between(low, high, shift)
    swept = MovedViews(light, good, -offsets / grid.step_px, 0 * offsets)
    found = yield from iter_swept(swept, planes, half_window(min(grid.shape) / 4), workers)
    central = int(np.hypot(*offsets.T).argmin())
    image = (light[central] + (good[central] > 0)).astype(np.float32)
    corner, steps = grid.corner_px, grid.step_px
    return map_of_views(found, shift, good[central] > 0, image, (corner, steps))


def _compared(scene: _Scene, workers: int | None) -> tuple[Image, Image, Array, ViewGrid]:
    """Return the views relative to the white frame minus 1, their weights ``(n, rows, columns)``, offsets and grid."""
    lit = np.where(scene.good > 0, scene.lit, 0).astype(np.float32)
    views = extract_views(scene.light * lit, scene.lattice, radius_px=scene.radius, full=True, workers=workers)
    weights = sample_views(lit, views.grid, np.empty_like(views.images), workers=workers)
    offsets = np.stack(np.meshgrid(views.offsets, views.offsets, indexing="ij"), axis=-1).reshape(-1, 2)
    # views at the rim are interpolated from the steep edge of the white light
    used = np.hypot(*offsets.T) <= scene.radius - 0.5
    weights = weights.reshape(-1, *views.shape)[used]
    # interpolation averages noise: without these weights, noise alone would prefer the plane of the lenslets
    part = np.modf(views.grid.centres_px)[0]
    kept = ((1 - part) ** 2 + part**2).prod(-1)
    noise = (views.grid.share**2 * kept[views.grid.near]).sum(-1)
    good = np.where((weights >= LIT) & views.mask, 1 / np.maximum(noise, 0.05), 0).astype(np.float32)
    light = views.images.reshape(-1, *views.shape)[used] / np.maximum(weights, LIT)
    # small numbers lose less in sums of squares
    return np.where(good > 0, light - 1, 0).astype(np.float32), good, offsets[used], views.grid
