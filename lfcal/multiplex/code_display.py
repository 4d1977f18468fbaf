"""Show codes on a display: check that its pixels are small enough for a camera, and create its frames."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import (
    InputError,
    check_number,
    check_tuple,
    npy_header,
    replace_whole,
    storage_errors,
    write_png,
)

__all__ = ["DisplayFit", "code_files", "display_fit", "display_frames", "save_code"]

PLACING_PX = 0.1
"""Tolerance of the positions of points, if these are not measured (pixels in the image)."""

WHOLE = 1e-3
"""Relative deviation from a whole number of display pixels below which a step counts as whole."""


@dataclass(frozen=True, slots=True)
class DisplayFit:
    """Suitability of a display in the object plane for a camera.

    Attributes
    ----------
    pixel_um
        Pixel pitch of the display, as it appears in the object plane (µm).
    step_um
        Distance in the object plane whose image is one sensor pixel (µm). If display pixels are larger, some source
        positions share a display pixel.
    image_px
        Width of the image of a display pixel (sensor pixels).
    placing_px
        Largest error, in the image, of a source position that is rounded to whole display pixels (sensor pixels).
    fits
        Whether every source position has a separate display pixel and is reached within 0.1 sensor pixels
        (`PLACING_PX`).

    Examples
    --------
    >>> from lfcal.multiplex import DisplayFit, display_fit
    >>> fit: DisplayFit = display_fit(step_um=10.0, pixel_um=2.0)
    >>> fit
    DisplayFit(pixel_um=2.0, step_um=10.0, image_px=0.2, placing_px=0.0, fits=True)
    """

    pixel_um: float
    step_um: float
    image_px: float
    placing_px: float
    fits: bool

    @property
    def words(self) -> str:
        """One-line verdict; it states the required pixel pitch if the pitch of the display is too large."""
        width = f"a display pixel of {self.pixel_um:.4g} µm is {self.image_px:.3g} px wide in the image"
        if self.fits:
            met = f"positions are {self.step_um:.4g} µm apart and reached within {self.placing_px:.2g} px"
            return f"fine enough: {width}; {met}"
        if self.image_px > 1 + WHOLE:
            remedy = (
                f"choose display pixels of at most {self.step_um:.4g} µm, or optics that demagnify them "
                f"{self.image_px:.3g} times"
            )
            return f"too coarse: {width}; {remedy}"
        needed = 2 * PLACING_PX * self.step_um
        return (
            f"too coarse: {width}, and positions {self.step_um:.4g} µm apart are off by up to "
            f"{self.placing_px:.2g} px; choose display pixels of at most {needed:.4g} µm, or of an integer "
            "fraction of the step, or measure the positions (lfcal fit)"
        )


def display_fit(step_um: float, pixel_um: float) -> DisplayFit:
    """Return whether the pixel pitch of a display is small enough for a camera, with the resulting errors.

    Parameters
    ----------
    step_um
        Distance in the object plane whose image is one sensor pixel (µm). It is the sensor's pixel pitch divided by the
        magnification (`lfcal.camera.Camera.step_um` at the depth of the plane).
    pixel_um
        Pixel pitch of the display, as it appears in that plane (µm).

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.multiplex import display_fit
    >>> step = preset("r29").step_um(0.0)  # moves the image by one pixel
    >>> print(display_fit(step, step / 8).words)
    fine enough: a display pixel of 2.74 µm is 0.125 px wide in the image; positions are 21.92 µm apart and reached
    within 0 px
    >>> print(display_fit(step, 3 * step).words)
    too coarse: a display pixel of 65.77 µm is 3 px wide in the image; choose display pixels of at most 21.92 µm, or
    optics that demagnify them 3 times
    """
    check_number("step in the object plane (µm)", step_um, above=0)
    check_number("pitch of the display's pixels (µm)", pixel_um, above=0)
    ratio = step_um / pixel_um
    whole = ratio > 0.5 and abs(ratio - round(ratio)) < WHOLE * ratio
    placing = 0.0 if whole else pixel_um / step_um / 2
    # each position needs a separate pixel, wherever it is on the display
    fits = ratio >= 1 - WHOLE and placing <= PLACING_PX
    return DisplayFit(pixel_um, step_um, pixel_um / step_um, placing, fits)


def display_frames(
    code: ArrayLike,
    places: ArrayLike,
    fit: DisplayFit,
    shape: tuple[int, int],
    *,
    repeat: tuple[int, int] | None = None,
) -> Iterator[NDArray[np.uint8]]:
    """Yield the display image of each frame of a code, uint8 ``(rows, columns)``; a fully lit point has the value 255.

    Parameters
    ----------
    code
        Relative brightness of each point in each frame, ``(frames, points)``, from 0 to 1.
    places
        Positions (y, x) of the points, ``(points, 2)``, in units of ``fit.step_um``, that is, of one sensor pixel in
        the image. Only differences matter: the block of points is centred on the display.
    fit
        Suitability of the display (`display_fit`), which contains its scale; each point is shown as one display pixel.
    shape
        Number of rows and columns of the display.
    repeat
        Distance (down, across) at which the block of points is repeated, in the units of ``places``. Choose it so large
        that the patterns of different blocks do not overlap on the sensor; this is not checked. The display shows as
        many blocks as fit, all with the same code. None: a single block.

    Raises
    ------
    InputError
        If the shapes of ``code`` and ``places`` do not match, or the block is larger than the display or than
        ``repeat``. Also if two points share a display pixel.

    Examples
    --------
    >>> from lfcal.multiplex import display_fit, display_frames, s_matrix
    >>> fit = display_fit(step_um=10.0, pixel_um=5.0)
    >>> for image in display_frames(s_matrix(3), [(0, 0), (0, 1), (0, 2)], fit, (1, 7)):
    ...     print(image.tolist())
    [[0, 255, 0, 255, 0, 0, 0]]
    [[0, 255, 0, 0, 0, 255, 0]]
    [[0, 0, 0, 255, 0, 255, 0]]
    """
    lit, positions = np.asarray(code, float), np.asarray(places, float)
    rows, columns = check_tuple("display (rows, columns)", shape, 2, at_least=1, at_most=20_000, integer=True)
    if lit.ndim != 2:
        raise InputError.expected("code", "two axes (frames, points)", f"shape {lit.shape}", "give one row per frame")
    if positions.shape != (lit.shape[1], 2):
        raise InputError.expected(
            "positions of the points",
            f"shape ({lit.shape[1]}, 2)",
            positions.shape,
            "give one row and column for each point",
        )
    scale = fit.step_um / fit.pixel_um
    spots = np.rint((positions - positions.min(axis=0)) * scale).astype(np.intp)
    if len(np.unique(spots, axis=0)) < len(spots):
        raise InputError.expected(
            "points", "a separate display pixel for each", fit.words, "choose points farther apart"
        )
    height, width = spots.max(axis=0) + 1
    if height > rows or width > columns:
        raise InputError.expected(
            "points", f"a block within {columns} x {rows} px", f"{width} x {height}", "choose fewer points"
        )
    steps = (rows, columns) if repeat is None else tuple(math.ceil(n * scale) for n in repeat)
    if any(n < size for n, size in zip(steps, (height, width), strict=True)):
        raise InputError.expected(
            "distance of blocks (display pixels)",
            f"{height} x {width} or more",
            f"{steps[0]} x {steps[1]}",
            "increase the distance",
        )
    corners = [_corners(n, size, step) for n, size, step in zip((rows, columns), (height, width), steps, strict=True)]
    for frame in lit:
        image = np.zeros((rows, columns), np.uint8)
        values = np.rint(255 * frame).astype(np.uint8)
        for top in corners[0]:
            for left in corners[1]:
                image[spots[:, 0] + top, spots[:, 1] + left] = values
        yield image


def _corners(length: int, size: int, step: int) -> range:
    """Return the first pixels of as many blocks as fit into ``length``, centred."""
    count = 1 + (length - size) // step
    first = (length - size - (count - 1) * step) // 2
    return range(first, first + count * step, step)


def code_files(folder: Path, frames: int) -> list[Path]:
    """Return the paths of the files that `save_code` writes into ``folder`` for a number of ``frames``."""
    return [*(folder / f"code_{k:03d}.png" for k in range(frames)), folder / "code.npy"]


def save_code(folder: Path, code: NDArray[Any], places: ArrayLike, fit: DisplayFit, **how: Any) -> list[Path]:
    """Write the display image of each frame and the code to ``folder``; return the paths of the files.

    The code is ``(frames, points)``. Pass ``shape`` and ``repeat`` of `display_frames` as ``how``.
    """
    files = code_files(folder, len(code))
    folder.mkdir(parents=True, exist_ok=True)
    for path, image in zip(files, display_frames(code, places, fit, **how), strict=False):
        write_png(path, image)
    values = np.ascontiguousarray(code, "<f8")
    with storage_errors(files[-1]), replace_whole(files[-1]) as part:
        part.write_bytes(npy_header(values.shape, values.dtype) + values.tobytes())
    return files
