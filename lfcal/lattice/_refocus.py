"""Images refocused to a depth, from sub-aperture views."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfcal.base import check_number
from lfcal.camera import Camera, Microscope, PupilLenslets
from lfcal.lattice.views import Views

__all__ = ["MIN_WEIGHT", "refocus", "sensor_slope", "slope_of_virtual_depth", "virtual_depth_of_slope"]

Image = NDArray[np.float32]
MIN_WEIGHT = 0.05
"""Fraction of the light of the best-lit place below which a refocused image is set to zero."""


def sensor_slope(camera: Camera, z_um: float) -> float:
    """Return the slope w of the plane at depth ``z_um`` (µm), which relates views to each other (dimensionless).

    A point whose chief ray meets the sensor at S is imaged at c + (S - c)/w by the lenslet whose micro-image is centred
    at c. Here w = (a/B) (b + B)/(b + a), with the distance a of the image behind the lenslets, the gap B and the image
    distance b of the main lens. This is the virtual depth a/B, corrected for the perspective of a main lens. For a
    Fourier light-field microscope, the slope is `PupilLenslets.spread`.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import sensor_slope
    >>> camera = preset("bench")
    >>> [round(sensor_slope(camera, z_um), 2) for z_um in (-20e3, 0.0, 20e3)]
    [2.97, 0.0, -2.6]
    """
    if isinstance(camera.lattice, PupilLenslets) and isinstance(camera.optics, Microscope):
        return camera.lattice.spread(camera.optics, z_um)
    return slope_of_virtual_depth(camera, camera.image_shift_um(z_um) / camera.lattice.gap_um)


def slope_of_virtual_depth(camera: Camera, virtual_depth: float) -> float:
    """Return the slope of the plane with a virtual depth, the inverse of `virtual_depth_of_slope`."""
    b, gap = camera.optics.image_distance_um, camera.periodic.gap_um
    if camera.optics.telecentric:
        return virtual_depth
    return virtual_depth * (b + gap) / (b + virtual_depth * gap)


def virtual_depth_of_slope(camera: Camera, slope: float) -> float:
    """Return the virtual depth of the plane with a slope (see `sensor_slope`).

    Raises
    ------
    InputError
        If no plane has this slope: behind a main lens, the largest one is (b + B)/B.
    """
    b, gap = camera.optics.image_distance_um, camera.periodic.gap_um
    if camera.optics.telecentric:
        return slope
    limit = (b + gap) / gap
    check_number("slope", slope, below=limit, remedy="choose a plane nearer to the lenslets")
    return slope * b / (b + gap - slope * gap)


def refocus(views: Views, slopes: Sequence[float], *, samples: int = 1) -> Image:
    """Return images refocused on n planes, ``(n, rows * samples, columns * samples)`` float32.

    Views are shifted relative to each other and added (Ng et al. 2005). The sample at S for the slope w is a sum over
    the offsets u, divided by the sum of the weights. Each term is the light at the offset u in the micro-image at S - w
    u. This is valid for images of points behind and in front of the lenslets.

    Parameters
    ----------
    views
        Views returned by `extract_views`.
    slopes
        Slope w of each plane (see `sensor_slope`); 0 for the plane that is imaged onto the lenslets.
    samples
        Number of image samples per view sample along each axis. More than one is useful for planes with large slopes,
        where the samples of the views interleave.

    Raises
    ------
    InputError
        If a slope or ``samples`` is out of range.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import ScanPlan
    >>> from lfcal.frames import open_frames
    >>> from lfcal.lattice import extract_views, lattice_of, refocus, sensor_slope
    >>> plan = ScanPlan.from_json(Path("session/plan.json").read_text(encoding="utf-8"))
    >>> with open_frames("session/frames") as source:
    ...     views = extract_views(source.read(1000), lattice_of(plan.camera), dark=64.0)
    >>> slopes = (0, 2, 3, 4, 5)
    >>> stack, theory = refocus(views, slopes, samples=2), sensor_slope(plan.camera, plan.depths_um[1])
    >>> print(f"sharpest at {slopes[stack.max((1, 2)).argmax()]}, by theory {theory:.1f}")
    sharpest at 4, by theory 3.9
    """
    check_number("samples per lenslet", samples, at_least=1, at_most=32, integer=True)
    rows, columns = views.shape
    stack = np.empty((len(slopes), rows * samples, columns * samples), np.float32)
    for k, slope in enumerate(slopes):
        check_number("slope", slope, at_least=-1e3, at_most=1e3)
        stack[k] = _refocus_one(views, float(slope), samples)
    return stack


def _refocus_one(views: Views, slope: float, samples: int) -> Image:
    from lfcal.base import cv2

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
            # offsets are along the pixels, the samples of a view along the lattice
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
    # if hardly any view sees the plane, the ratio of two small numbers would be noise
    least = max(MIN_WEIGHT * float(weight.max()), 1e-30)
    return np.where(weight > least, total / np.maximum(weight, least), 0).astype(np.float32)
