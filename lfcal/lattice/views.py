"""Sub-aperture views from one light-field frame."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, as_sensor_frame, check_number, for_each_chunk, format_pixels
from lfcal.lattice._view_grid import ViewGrid, view_grid
from lfcal.lattice._view_kernels import Sites, ViewReading, sample_rows
from lfcal.lattice.micro_images import FrameLattice, MicroImageLattice

__all__ = ["RADIUS", "TAPS", "Views", "extract_views", "sample_views", "subtract_dark"]

Image = NDArray[np.float32]

RADIUS = 0.45
"""Default radius of the micro-images (pitches)."""


@dataclass(frozen=True, eq=False)
class Views:
    """Sub-aperture views: images of the scene through different parts of the aperture.

    Attributes
    ----------
    images
        Views from the pixels that are displaced by `offsets` in v (down) and u (right) from the centre of each
        micro-image, ``(nv, nu, rows, columns)`` float32. They are 0 where no lenslet sees a sample.
    weights
        Weight of each sample, ``(nv, nu, rows, columns)``: the same views of a white frame, scaled to a maximum of 1,
        or a mask of the aperture.
    offsets
        Offsets of the views from the centres of the micro-images (px), the same in v and u.
    radius_px
        Radius within which micro-images were used (px).
    grid
        Positions of the samples, and the lenslets that contribute to each.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import Camera
    >>> from lfcal.frames import read_image
    >>> from lfcal.lattice import Views, extract_views, lattice_of
    >>> camera = Camera.from_json(Path("session/camera.json").read_text(encoding="utf-8"))
    >>> views: Views = extract_views(read_image("session/white/white_0.png"), lattice_of(camera), dark=64.0)
    >>> print(views.central.shape, views.mosaic().shape, views.offsets.tolist())
    (7, 9) (63, 81) [-4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0]
    """

    images: Image = field(repr=False)
    weights: Image = field(repr=False)
    offsets: NDArray[np.float64] = field(repr=False)
    radius_px: float
    grid: ViewGrid

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of a view (samples)."""
        return self.grid.shape

    @property
    def step_px(self) -> tuple[float, float]:
        """Spacing of the samples of a view, down and to the right (px on the sensor)."""
        return self.grid.step_px

    @property
    def rotation_rad(self) -> float:
        """Angle (rad) from the +x axis of the frame to the rows of a view, positive towards +y (down).

        The `offsets` in u are along the +x axis of the frame.
        """
        return self.grid.rotation_rad

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Boolean mask of the samples that at least one lenslet sees, ``(rows, columns)``."""
        return self.grid.mask

    @property
    def central(self) -> Image:
        """View through the middle of the aperture, ``(rows, columns)``."""
        middle = len(self.offsets) // 2
        result: Image = self.images[middle, middle]
        return result

    def mosaic(self, every: int = 1) -> Image:
        """Return a mosaic image of every ``every``-th view along v and u, including the middle one."""
        middle = len(self.offsets) // 2
        pick = np.arange(middle % every, len(self.offsets), every)
        chosen = self.images[np.ix_(pick, pick)]
        rows, columns = self.shape
        result: Image = chosen.transpose(0, 2, 1, 3).reshape(len(pick) * rows, len(pick) * columns)
        return result


def extract_views(
    frame: ArrayLike,
    lattice: FrameLattice,
    *,
    white: ArrayLike | None = None,
    dark: ArrayLike | float = 0.0,
    radius_px: float | None = None,
    axes: str = "frame",
    full: bool = False,
    missing: Iterable[tuple[int, int]] = (),
    raster: MicroImageLattice | None = None,
    workers: int | None = None,
) -> Views:
    """Extract the sub-aperture views of a light-field frame.

    A pixel at a fixed offset from the centre of a micro-image receives light through one part of the aperture of the
    main lens. The pixels at this offset in all micro-images form a view. Samples between pixels are interpolated
    bilinearly, and samples between lenslets as described in `view_grid`.

    Parameters
    ----------
    frame
        Light-field frame ``(rows, columns)``.
    lattice
        Lattice of the micro-images: a `LatticeFit` of a white image of the same camera, or the result of `lattice_of`
        for a camera description.
    white
        White frame ``(rows, columns)``, whose light determines the weights of the views. None: all pixels within the
        radius have equal weights.
    dark
        Dark frame, or dark level (counts), to subtract from both frames.
    radius_px
        Radius of the micro-images (px). None: 0.45 times the smaller of pitch and row pitch (of ``raster``, if it is
        given).
    axes, full, missing, raster
        As in `view_grid`: direction of the rows of a view, whether to return the complete field with a mask, lenslets
        without light, and the lattice that defines the positions of the samples. Without ``full``, the largest box is
        returned.
    workers
        Number of threads. None: one for each available CPU core.

    Raises
    ------
    InputError
        If the shape of a frame differs from that of the lattice, or the frame contains no complete micro-image. Also if
        ``radius_px`` is less than 1 or more than the pitch.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import Camera
    >>> from lfcal.frames import read_image
    >>> from lfcal.lattice import extract_views, lattice_of
    >>> camera = Camera.from_json(Path("session/camera.json").read_text(encoding="utf-8"))
    >>> views = extract_views(read_image("session/white/white_0.png"), lattice_of(camera), dark=64.0)
    >>> print(views.images.shape, f"{views.images[0, 4].mean() / views.central.mean():.2f} of the light at the edge")
    (9, 9, 7, 9) 0.90 of the light at the edge
    """
    light = subtract_dark(frame, dark, lattice, "light-field frame")
    # the views of a single lens type use the raster and the micro-image size of the whole lattice
    of = raster or lattice
    radius = RADIUS * min(of.pitch_px, of.row_pitch_px) if radius_px is None else radius_px
    check_number("radius of the micro-images (px)", radius, at_least=1, at_most=of.pitch_px)
    half = math.floor(radius)
    grid = view_grid(lattice, lattice.shape, half, axes=axes, full=full, missing=missing, raster=raster)
    if not min(grid.shape):
        raise InputError.expected(
            "light-field frame",
            f"room for a micro-image of {2 * half + 1} x {2 * half + 1} px",
            format_pixels(lattice.shape),
            "give a larger frame or a smaller radius",
        )
    offsets = np.arange(-half, half + 1, dtype=float)
    images = np.empty((len(offsets), len(offsets), *grid.shape), np.float32)
    sample_views(light, grid, images, workers=workers)
    # beyond the radius the pixels belong to the gaps between micro-images
    inside = (np.hypot(offsets[:, None], offsets[None, :]) <= radius)[:, :, None, None]
    if white is None:
        weights = (inside & grid.mask).astype(np.float32)
        return Views(images, weights, offsets, radius, grid)
    lit = np.maximum(subtract_dark(white, dark, lattice, "white frame"), 0)
    weights = sample_views(lit, grid, np.empty_like(images), workers=workers)
    weights *= inside
    weights /= max(float(weights.max()), 1e-30)
    return Views(images, weights, offsets, radius, grid)


def subtract_dark(frame: ArrayLike, dark: ArrayLike | float, lattice: FrameLattice, what: str) -> Image:
    """Return a frame minus its dark frame or level (counts) as float32, if the shapes match that of the lattice.

    Raises
    ------
    InputError
        If a shape does not match; the message refers to the frame as ``what``.
    """
    image = as_sensor_frame(what, frame)
    if image.shape != tuple(lattice.shape):
        raise InputError.expected(
            what,
            format_pixels(lattice.shape),
            format_pixels(image.shape),
            "use a frame of the camera of the white image",
        )
    level = np.asarray(dark, np.float32)
    if level.ndim and level.shape != image.shape:
        raise InputError.expected(
            f"dark frame for the {what}",
            format_pixels(lattice.shape),
            format_pixels(level.shape),
            "record both with the same sensor settings",
        )
    return (image - level).astype(np.float32, copy=False)


TAPS = {"nearest": 1, "linear": 2, "cubic": 4}
"""Number of pixels along each side that a filter uses."""


def sample_views(
    frame: NDArray[Any],
    grid: ViewGrid,
    out: NDArray[Any],
    *,
    step_px: tuple[float, float] = (1.0, 1.0),
    filter: str = "linear",
    workers: int | None = None,
) -> NDArray[Any]:
    """Fill the array ``out``, ``(nv, nu, rows, columns)``, with the views of a frame, and return it.

    View (v, u) samples the frame at the offset (v - (nv - 1)/2, u - (nu - 1)/2) times ``step_px`` (down, right; px)
    from the centre of each micro-image. ``filter`` is the interpolation: ``"nearest"``, ``"linear"`` or ``"cubic"``.
    Each sample of a view is the weighted sum over the lenslets that ``grid`` states, or 0 if no lenslet sees it.
    ``out`` must be float32 or float64.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import lattice_of, sample_views, view_grid
    >>> lattice = lattice_of(preset("bench"))
    >>> grid = view_grid(lattice, lattice.shape, margin=5.0)
    >>> ramp = np.tile(np.arange(lattice.shape[1], dtype=np.float32), (lattice.shape[0], 1))
    >>> views = sample_views(ramp, grid, np.empty((1, 5, *grid.shape), np.float32), workers=1)
    >>> (views - views[:, 2:3]).mean((0, 2, 3)).round(2).tolist()
    [-2.0, -1.0, 0.0, 1.0, 2.0]
    """
    half = ((out.shape[0] - 1) / 2 * step_px[0], (out.shape[1] - 1) / 2 * step_px[1])
    sites = Sites(grid.centres_px - np.array(half), grid.near, np.ascontiguousarray(grid.share, out.dtype))
    reading = ViewReading(float(step_px[0]), float(step_px[1]), TAPS[filter])
    for_each_chunk(lambda a, b: sample_rows(frame, sites, reading, out, a, b), grid.shape[0], workers)
    return out
