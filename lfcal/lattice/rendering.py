"""Rendering for focused plenoptic cameras: refocused planes, lens types weighted by sharpness, all-in-focus images.

If lenslets are focused on the scene, a micro-image is a small image of it. Rendering resolves detail between lenslets
at the resolution of the pixels, unlike views, whose samples are lenslets (Georgiev and Lumsdaine 2010).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_number, for_each_chunk
from lfcal.camera import Camera
from lfcal.lattice._refocus import MIN_WEIGHT, virtual_depth_of_slope
from lfcal.lattice._view_grid import ViewGrid, view_grid
from lfcal.lattice._view_kernels import RefocusPlane, render_rows
from lfcal.lattice.lens_types import expected_blur
from lfcal.lattice.micro_images import FrameLattice, TypeOf
from lfcal.lattice.views import RADIUS, subtract_dark

__all__ = ["MIN_SLOPE", "RenderedPlanes", "check_slopes", "render", "sharpness_shares", "total_focus"]

Image = NDArray[np.float32]
Array = NDArray[np.float64]

MIN_SLOPE = 1.5
"""Smallest slope for rendering: nearer to the lenslets, no lenslet sees some points; refocus views instead."""

FLOOR_PX = 1.0
"""Blur of a lenslet in focus: a pixel, and the diffraction of a suitable lenslet (pixels)."""

WINDOW = 0.5
"""Standard deviation of the window over which the disagreement of lenslets is averaged (view samples)."""


@dataclass(frozen=True, eq=False)
class RenderedPlanes:
    """Images of a scene rendered on planes at several depths.

    Attributes
    ----------
    images
        Rendered light relative to the white frame, ``(n, rows, columns)`` float32; 0 where no lenslet sees the plane.
    disagreement
        Variance between lenslets at each sample, ``(n, rows, columns)`` float32. It is smallest where the scene is on
        the plane, and infinite where fewer than two lenslets see the sample.
    slopes
        Slope of each of the n planes (see `sensor_slope`).
    grid
        Grid of the samples of a view, each of which is divided into ``samples`` x ``samples`` image samples.
    samples
        Number of image samples along each side of a view sample.
    """

    images: Image = field(repr=False)
    disagreement: Image = field(repr=False)
    slopes: tuple[float, ...]
    grid: ViewGrid
    samples: int


def sharpness_shares(camera: Camera, slope: float) -> tuple[float, ...]:
    """Return the weight of each lens type at a slope, proportional to 1 / blur² and 1 for the sharpest type.

    The blur on the sensor is ``d |1/v - 1/v_focus|``, to which one pixel is added in quadrature. Here d is the clear
    diameter of a lenslet, v the virtual depth at the slope, and v_focus the virtual depth at which the type is in
    focus.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import sharpness_shares
    >>> [round(share, 2) for share in sharpness_shares(preset("r29"), slope=3.0)]
    [0.04, 1.0, 0.06]
    """
    diameter = camera.lattice.clear_diameter_um / camera.sensor.pixel_um
    blur = diameter * np.array(expected_blur(camera, virtual_depth_of_slope(camera, slope)))
    shares = 1 / (blur**2 + FLOOR_PX**2)
    return tuple((shares / shares.max()).tolist())


def render(
    frame: ArrayLike,
    lattice: FrameLattice,
    slopes: Sequence[float],
    *,
    type_of: TypeOf | None = None,
    shares: Sequence[Sequence[float]] | None = None,
    white: ArrayLike | None = None,
    dark: ArrayLike | float = 0.0,
    radius_px: float | None = None,
    samples: int = 4,
    workers: int | None = None,
) -> RenderedPlanes:
    """Render the scene on planes at ``slopes``; each image sample is the weighted mean over the lenslets that see it.

    Consider a point on the plane with the slope w, whose chief ray meets the sensor at S. The lenslet whose micro-image
    is centred at c images this point at c + (S - c)/w.

    Parameters
    ----------
    frame, lattice, white, dark, radius_px
        As in `extract_views`.
    slopes
        Slope of each plane (see `sensor_slope`), whose absolute value must be from 1.5 (`MIN_SLOPE`) to 1000.
    type_of, shares
        Function that returns the lens types of lenslets (q, r), and for each plane the weights of the lens types, such
        as those of `sharpness_shares`. If either is None, all types have equal weights.
    samples
        Number of image samples along each side of a view sample.
    workers
        Number of threads. None: one for each available CPU core.

    Raises
    ------
    InputError
        If the shape of a frame differs from that of the lattice, or ``slopes``, ``radius_px`` or ``samples`` is out of
        range.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import RenderedPlanes, lattice_of, render
    >>> lattice = lattice_of(preset("bench"))
    >>> planes: RenderedPlanes = render(np.full(lattice.shape, 7.0), lattice, (2.0, 3.0), samples=2)
    >>> print(planes.slopes, planes.images.shape, planes.images.mean().round(3))
    (2.0, 3.0) (2, 66, 66) 7.0
    """
    check_number("samples per lenslet", samples, at_least=1, at_most=32, integer=True)
    check_slopes(slopes)
    radius = RADIUS * min(lattice.pitch_px, lattice.row_pitch_px) if radius_px is None else radius_px
    check_number("radius of the micro-images (px)", radius, at_least=1, at_most=lattice.pitch_px)
    light, lit = subtract_dark(frame, dark, lattice, "light-field frame"), _lit(white, dark, lattice)
    grid = view_grid(lattice, lattice.shape, float(np.floor(radius)))
    size = (grid.shape[0] * samples, grid.shape[1] * samples)
    images, spread = np.empty((len(slopes), *size), np.float32), np.empty((len(slopes), *size), np.float32)
    index = np.rint(lattice.lenslet_at(*grid.centres_px.T)).astype(np.intp)
    for k, slope in enumerate(slopes):
        weight = np.ones(len(index))
        if type_of is not None and shares is not None:
            weight = np.array(shares[k], float)[type_of(index[:, 0], index[:, 1])]
        lenslets = np.column_stack([grid.centres_px, weight])[weight > 0]
        plane = _plane(float(slope), radius, grid, samples)
        sums = np.zeros((4, *size), np.float32)

        def work(a: int, b: int, into: Image = sums, near: Array = lenslets, at: RefocusPlane = plane) -> None:
            render_rows(light, lit, near, at, into, (a, b))

        for_each_chunk(work, size[0], workers)
        images[k], spread[k] = _mean_and_variance(sums)
    return RenderedPlanes(images, spread, tuple(map(float, slopes)), grid, samples)


def check_slopes(slopes: Sequence[float]) -> None:
    """Raise `InputError` unless the absolute value of every slope is from `MIN_SLOPE` to 1000, as `render` requires."""
    for slope in slopes:
        check_number("slope", slope, at_least=-1e3, at_most=1e3)
        if abs(slope) < MIN_SLOPE:
            raise InputError.expected(
                "slope of a plane rendered with lens types",
                f"below {-MIN_SLOPE:g} or above {MIN_SLOPE:g}",
                f"{slope:g}",
                "leave the plane out, or refocus views without lens types",
            )


def _lit(white: ArrayLike | None, dark: ArrayLike | float, lattice: FrameLattice) -> Image:
    """Return the white light of every pixel, 1 at its brightest points and 0 if there is hardly any."""
    if white is None:
        return np.ones(tuple(lattice.shape), np.float32)
    lit = subtract_dark(white, dark, lattice, "white frame")
    lit /= np.float32(max(float(np.percentile(lit, 99)), 1e-30))
    # hardly lit pixels contain only noise
    lit[lit < MIN_WEIGHT] = 0
    return lit


def _plane(slope: float, radius: float, grid: ViewGrid, samples: int) -> RefocusPlane:
    corner = [c + (0.5 / samples - 0.5) * step for c, step in zip(grid.corner_px, grid.step_px, strict=True)]
    return RefocusPlane(
        slope, float(radius), corner[0], corner[1], grid.step_px[0] / samples, grid.step_px[1] / samples
    )


def _mean_and_variance(sums: Image) -> tuple[Image, Image]:
    """Return the weighted mean, and the unbiased variance (infinite if fewer than two lenslets see a sample)."""
    weight, light, square, squared_weight = sums
    # positions that only blurred types see are shown as well
    seen = weight > 0
    total = np.where(seen, weight, 1)
    mean = np.where(seen, light / total, 0).astype(np.float32)
    # one over the effective number of lenslets
    single = squared_weight / total**2
    several = seen & (single < 0.9)
    variance = np.maximum(square / total - mean**2, 0) / np.where(several, 1 - single, 1)
    return mean, np.where(several, variance, np.inf).astype(np.float32)


def total_focus(planes: RenderedPlanes) -> tuple[Image, Image]:
    """Return the all-in-focus image and the slope of the plane selected at each sample, both ``(rows, columns)``.

    The selected plane has the smallest disagreement between lenslets in a small window. Where the scene has no texture,
    the selected slope is meaningless, but the image is nearly the same on all planes.

    Raises
    ------
    InputError
        If ``planes`` contains no plane.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import lattice_of, render, total_focus
    >>> lattice = lattice_of(preset("bench"))
    >>> pixels = np.moveaxis(np.indices(lattice.shape), 0, -1)
    >>> centres = lattice.centres_px(*np.rint(lattice.lenslet_at(*np.indices(lattice.shape))).transpose(2, 0, 1))
    >>> stripes_at_2 = 1 + np.sin((centres + 2 * (pixels - centres))[..., 1] / 3)
    >>> image, slope = total_focus(render(stripes_at_2, lattice, (2.0, 3.0, 4.0), samples=2))
    >>> print(image.shape, np.median(slope))
    (66, 66) 2.0
    """
    from lfcal.base import cv2

    if not planes.slopes:
        raise InputError.expected("planes", "one or more", 0, "give slopes")
    sigma = WINDOW * planes.samples
    cost = np.empty_like(planes.disagreement)
    for k, spread in enumerate(planes.disagreement):
        known = np.isfinite(spread).astype(np.float32)
        near = cv2.GaussianBlur(known, (0, 0), sigma)
        summed = cv2.GaussianBlur(np.where(known > 0, spread, 0).astype(np.float32), (0, 0), sigma)
        cost[k] = np.where(near > 0.5, summed / np.maximum(near, 0.5), np.inf)
    best = cost.argmin(0)
    image: Image = np.take_along_axis(planes.images, best[None], axis=0)[0]
    return image, np.array(planes.slopes, np.float32)[best]
