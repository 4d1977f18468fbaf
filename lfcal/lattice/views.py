"""Sub-aperture views and refocused images from one light-field frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.camera import Camera, MainLens
from lfcal.checks import as_sensor_frame, check_number
from lfcal.errors import InputError
from lfcal.lattice.fit import LatticeFit
from lfcal.lattice.view_grid import ViewGrid, view_grid

__all__ = ["Views", "extract_views", "refocus", "sensor_slope"]

Image = NDArray[np.float32]
MIN_WEIGHT = 0.05
"""Where less than this share of the best-lit place is seen, a refocused image is left at zero."""


@dataclass(frozen=True, eq=False)
class Views:
    """The same scene seen through different parts of the aperture.

    Attributes
    ----------
    images
        ``(nv, nu, rows, columns)`` float32: view from below each lenslet's centre by `offsets` pixels in v (down)
        and u (right). One sample per `step_px` along the lattice's rows and across them.
    weights
        The same of a white frame, or the aperture's mask: the weight of each sample.
    offsets
        Offsets of the views from the micro-images' centres, the same in v and u (pixels).
    step_px
        Distance of samples ``(row, column)`` on the sensor along the lattice's axes (pixels). A square lattice
        has one per lenslet; a hexagonal one is resampled to square samples of its row pitch.
    radius_px
        Radius of the micro-images used (pixels).
    rotation_rad
        Angle from the pixels' +x axis, along which `offsets` count, to the rows of a view, positive downwards (rad).
    """

    images: Image = field(repr=False)
    weights: Image = field(repr=False)
    offsets: NDArray[np.float64] = field(repr=False)
    step_px: tuple[float, float]
    radius_px: float
    rotation_rad: float = 0.0

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of one view."""
        return self.images.shape[2], self.images.shape[3]

    @property
    def central(self) -> Image:
        """The view through the middle of the aperture, ``(rows, columns)``."""
        middle = len(self.offsets) // 2
        result: Image = self.images[middle, middle]
        return result

    def mosaic(self, every: int = 1) -> Image:
        """Return the views side by side, as seen from above to below and left to right; every n-th about the middle."""
        middle = len(self.offsets) // 2
        pick = np.arange(middle % every, len(self.offsets), every)
        chosen = self.images[np.ix_(pick, pick)]
        rows, columns = self.shape
        result: Image = chosen.transpose(0, 2, 1, 3).reshape(len(pick) * rows, len(pick) * columns)
        return result


def extract_views(
    frame: ArrayLike,
    fit: LatticeFit,
    *,
    white: ArrayLike | None = None,
    dark: ArrayLike | float = 0.0,
    radius_px: float | None = None,
) -> Views:
    """Return the sub-aperture views of a light-field frame.

    The pixel u to the right of a lenslet's centre sees the scene through one part of the main lens's aperture;
    taken over all lenslets it makes a view. Samples between pixels are interpolated bilinearly, those between
    the lenslets of a hexagonal row linearly.

    Parameters
    ----------
    frame
        Light-field frame ``(rows, columns)``.
    fit
        Lattice from a white image of the same camera.
    white
        White frame: views are weighed by its light. Without it micro-images count evenly up to the radius.
    dark
        Dark frame or level subtracted from both.
    radius_px
        Radius of the micro-images (pixels); by default 0.45 pitches.

    Raises
    ------
    InputError
        If a frame does not fit the lattice.
    """
    light = _less_dark(frame, dark, fit, "light-field frame")
    weight = np.ones_like(light) if white is None else np.maximum(_less_dark(white, dark, fit, "white frame"), 0)
    radius = 0.45 * min(fit.pitch_px, fit.row_pitch_px) if radius_px is None else radius_px
    check_number("radius of the micro-images (px)", radius, at_least=1, at_most=fit.pitch_px)
    half = math.floor(radius)
    offsets = np.arange(-half, half + 1, dtype=float)
    grid = view_grid(fit.kind, fit.basis_px(), fit.origin_px, fit.shape, half)
    if not min(grid.shape):
        raise InputError.expected(
            "light-field frame",
            f"a micro-image of {2 * half + 1} x {2 * half + 1} px wholly inside",
            f"{fit.shape} px",
            "give a larger frame or a smaller radius",
        )
    images, weights = _sample_views(light, fit, grid, offsets), _sample_views(weight, fit, grid, offsets)
    inside = np.hypot(offsets[:, None], offsets[None, :]) <= radius
    # beyond the radius the pixels belong to the gaps between micro-images
    weights *= inside[:, :, None, None]
    weights /= max(float(weights.max()), 1e-30)
    step = (fit.row_pitch_px, fit.row_pitch_px if fit.kind == "hexagonal" else fit.pitch_px)
    return Views(images, weights, offsets, step, radius, fit.rotation_rad)


def _less_dark(frame: ArrayLike, dark: ArrayLike | float, fit: LatticeFit, what: str) -> Image:
    image = as_sensor_frame(what, frame)
    if image.shape != fit.shape:
        raise InputError.expected(what, f"shape {fit.shape}", image.shape, "use the white image's camera")
    level = np.asarray(dark, np.float32)
    if level.ndim and level.shape != image.shape:
        raise InputError.expected(f"dark of the {what}", f"shape {fit.shape}", level.shape, "use one sensor setting")
    return (image - level).astype(np.float32)


def _sample_views(image: Image, fit: LatticeFit, grid: ViewGrid, offsets: NDArray[np.float64]) -> Image:
    import cv2

    left, share = grid.neighbours()
    result = np.empty((len(offsets), len(offsets), *grid.shape), np.float32)
    for side, factor in ((0, (1 - share).astype(np.float32)), (1, share.astype(np.float32))):
        if not np.any(factor):
            continue
        centres = fit.centres_px(left + side, grid.rows[:, None]).astype(np.float32)
        map_y, map_x = np.ascontiguousarray(centres[..., 0]), np.ascontiguousarray(centres[..., 1])
        for j, v in enumerate(offsets):
            for i, u in enumerate(offsets):
                # where a share is zero the lenslet may lie outside the frame: its repeated border counts for nothing
                view = factor * cv2.remap(
                    image,
                    map_x + np.float32(u),
                    map_y + np.float32(v),
                    cv2.INTER_LINEAR,
                    borderMode=cv2.BORDER_REPLICATE,
                )
                result[j, i] = view if side == 0 else result[j, i] + view
    return result


def sensor_slope(camera: Camera, z_um: float) -> float:
    """Return by how many micro-image distances a point at depth ``z_um`` moves per distance within a micro-image.

    A point whose chief ray meets the sensor at S is seen at c + (S - c)/w below the lenslet whose micro-image
    is centred at c, w = (a/B) (b + B)/(b + a): the virtual depth, but for the perspective of a main lens.
    """
    a = camera.image_shift_um(z_um)
    v = a / camera.lattice.gap_um
    if not isinstance(camera.optics, MainLens):
        return v
    b = camera.optics.image_distance_um
    return v * (b + camera.lattice.gap_um) / (b + a)


def refocus(views: Views, slopes: Sequence[float], *, samples: int = 1) -> Image:
    """Return the images focused at ``slopes``, ``(n, rows * samples, columns * samples)`` float32.

    Views are shifted against each other and added: at S, the light at offset u below the micro-image at
    S - w u, divided by the sum of the weights there (Ng et al. 2005, for points behind and before
    the lenslets alike).

    Parameters
    ----------
    views
        From `extract_views`.
    slopes
        Slope w of each plane, 0 in the plane of the lenslets: `sensor_slope`.
    samples
        Samples per view sample along each side: more than one where the planes lie off the lenslets, for there
        the views interleave.

    Raises
    ------
    InputError
        If a slope or ``samples`` is out of range.
    """
    check_number("samples per lenslet", samples, at_least=1, at_most=32, integer=True)
    rows, columns = views.shape
    stack = np.empty((len(slopes), rows * samples, columns * samples), np.float32)
    for k, slope in enumerate(slopes):
        check_number("slope", slope, at_least=-1e3, at_most=1e3)
        stack[k] = _refocus_one(views, float(slope), samples)
    return stack


def _refocus_one(views: Views, slope: float, samples: int) -> Image:
    import cv2

    rows, columns = views.shape
    fine = [((np.arange(n * samples) + 0.5) / samples - 0.5).astype(np.float32) for n in (rows, columns)]
    total = np.zeros((rows * samples, columns * samples), np.float32)
    weight = np.zeros_like(total)
    turn = (math.cos(views.rotation_rad), math.sin(views.rotation_rad))
    for j, v in enumerate(views.offsets):
        for i, u in enumerate(views.offsets):
            mask = views.weights[j, i]
            if not mask.any():
                continue
            # offsets count along the pixels, the samples of a view along the lattice
            down, right = turn[0] * v - turn[1] * u, turn[0] * u + turn[1] * v
            shift = (slope * down / views.step_px[0], slope * right / views.step_px[1])
            # an affine map: destination to source, both in view samples
            move = np.array([[1 / samples, 0, fine[1][0] - shift[1]], [0, 1 / samples, fine[0][0] - shift[0]]])
            for target, source in ((total, views.images[j, i]), (weight, mask)):
                target += cv2.warpAffine(
                    source,
                    move,
                    (columns * samples, rows * samples),
                    flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                    borderValue=0,
                )
    # where hardly any view sees the plane, a ratio of two small numbers would show noise
    least = max(MIN_WEIGHT * float(weight.max()), 1e-30)
    return np.where(weight > least, total / np.maximum(weight, least), 0).astype(np.float32)
