"""Geometric size of the image of a point on the sensor."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.camera.description import Camera, nearest_lens
from lfcal.camera.main_lens import Microscope
from lfcal.camera.pupil_lenslets import PupilLenslets

__all__ = ["cutout_for", "half_extent_px", "rms_radius_px"]

AIRY_RADII = 3.0
"""Margin in Airy radii of a lenslet. Of a spot at the pattern's edge, 5.7 % of the light is outside; of the
whole pattern, much less."""

ELEMENTAL_AIRY_RADII = 8.0
"""Margin in Airy radii of single lenslets with spots far apart: 2.1 % of the light of an outer spot is outside."""

RAYS = 256


def _edge_slope(camera: Camera, z_um: float) -> tuple[float, float]:
    """Return the radius of the light cone on the lenslet array (µm), and the slope of its edge there."""
    optics = camera.optics
    if isinstance(optics, Microscope):
        angle = optics.half_angle_rad
        # sine condition: the object-side cone tan(alpha), M times in the image, at slope NA/M
        return optics.magnification * abs(z_um) * math.tan(angle), optics.numerical_aperture / optics.magnification
    image = optics.image_distance_um + camera.image_shift_um(z_um)
    radius = optics.focal_length_um / optics.f_number / 2
    if optics.blades:
        # the polygon has the area of the circle, so its corners are outside it
        n = optics.blades
        radius *= math.sqrt(math.pi / (n / 2 * math.sin(2 * math.pi / n)))
    return radius * abs(camera.image_shift_um(z_um)) / image, radius / image


def _elemental(camera: Camera, lenslets: PupilLenslets, z_um: float) -> tuple[NDArray[np.float64], float]:
    """Return positions ``(n, 2)`` of a point's spots about its chief ray, and their largest geometric radius (µm).

    A ray through the point c + e of a lenslet at c meets the sensor at c (1 + s) + e (1 - B/f + s), where s is
    `PupilLenslets.spread`.
    """
    assert isinstance(camera.optics, Microscope)
    spread = lenslets.spread(camera.optics, z_um)
    blur = np.abs(1 - lenslets.gap_um / lenslets.focal_um + spread).max() * lenslets.clear_um / 2
    corner = 1.0 if lenslets.aperture == "round" else math.sqrt(2)
    return np.array(lenslets.lens_centres_um) * (1 + spread), corner * float(blur)


def half_extent_px(camera: Camera, z_um: float) -> float:
    """Return the half width of the pattern of a point at depth ``z_um`` about its chief ray (sensor pixels).

    A ray through pupil point p meets the lenslet array at a distance p·a/(b+a) from the chief ray, with slope -p/(b+a).
    Here a is the distance from the array to the image (`Camera.image_shift_um`), and b the image distance of the main
    lens. A lenslet with the focal length f changes the slope by -e/f, where e is the distance from the lenslet's
    centre. On the sensor, at the distance B behind the array, the ray is ``p (a - B)/(b + a) - (B/f) e`` from the chief
    ray. The half width is an upper bound of this expression for the edges of the pupil and of a lenslet, plus three
    Airy radii of a lenslet. Without a lattice, the pattern consists of the spots behind all lenslets, and the margin is
    eight Airy radii.
    """
    if isinstance(camera.lattice, PupilLenslets):
        spots, blur = _elemental(camera, camera.lattice, z_um)
        airy = 1.22 * camera.wavelength_um * camera.lattice.gap_um / camera.lattice.clear_um
        return (float(np.abs(spots).max()) + blur + ELEMENTAL_AIRY_RADII * airy) / camera.sensor.pixel_um
    gap = camera.lattice.gap_um
    shadow, slope = _edge_slope(camera, z_um)
    spread = abs(math.copysign(shadow, camera.image_shift_um(z_um)) - gap * slope)
    diameter = camera.lattice.clear_diameter_um / camera.lattice_scale
    bend = max(gap / kind.focal_length_um for kind in camera.lattice.types) * diameter / 2
    airy = 1.22 * camera.wavelength_um * gap / diameter
    return (spread + bend + AIRY_RADII * airy) / camera.sensor.pixel_um


def rms_radius_px(camera: Camera, z_um: float) -> float:
    """Return the rms distance of the light of a point at depth ``z_um`` from its chief ray (sensor pixels).

    The calculation uses the rays of `half_extent_px` from a uniformly illuminated pupil (for a microscope, according to
    the sine condition). It includes deflection and diffraction by the lenslets. It is valid for patterns of several
    lenslets. Without a lattice, it includes the spots behind all lenslets and their defocus, but no diffraction.
    """
    if isinstance(camera.lattice, PupilLenslets):
        spots, blur = _elemental(camera, camera.lattice, z_um)
        return math.sqrt(float((spots**2).sum(-1).mean()) + blur**2 / 2) / camera.sensor.pixel_um
    optics, gap = camera.optics, camera.lattice.gap_um
    share = (np.arange(RAYS) + 0.5) / RAYS  # of the pupil's area
    if isinstance(optics, Microscope):
        sine = np.sqrt(share) * optics.numerical_aperture / optics.medium_index
        aperture = gap * np.sqrt(share) * optics.numerical_aperture / optics.magnification
        ray = optics.magnification * z_um * sine / np.sqrt(1 - sine**2) + aperture
    else:
        shift = camera.image_shift_um(z_um)
        pupil = np.sqrt(share) * optics.focal_length_um / optics.f_number / 2
        ray = pupil * (shift - gap) / (optics.image_distance_um + shift)
    diameter = camera.lattice.clear_diameter_um / camera.lattice_scale
    bend = np.array([gap / kind.focal_length_um for kind in camera.lattice.types])
    # rays of a lenslet are at c + e on the array, and at c + (1 - bend) e on the sensor
    lenslet = diameter**2 / (6 if camera.lattice.kind == "square" else 8) * float((bend**2 - 2 * bend).mean())
    spot = 2 * (0.42 * camera.wavelength_um * gap / diameter) ** 2
    return math.sqrt(max(float((ray**2).mean()) + lenslet, 0.0) + spot) / camera.sensor.pixel_um


def cutout_for(camera: Camera, depths_um: tuple[float, ...]) -> int:
    """Return the odd side (pixels) of the smallest square cutout that contains the pattern at every depth.

    Half a pixel is added, because the anchor may be between two pixels. Without a lattice, the pattern may be as large
    as the sensor. The cutout is then limited to the largest odd square about the optical axis that is on the sensor.
    """
    half = max(half_extent_px(camera, z) for z in depths_um)
    side = 2 * math.ceil(half + 0.5) + 1
    if camera.has_lattice:
        return side
    axis = [round(v) for v in nearest_lens(camera, camera.sensor.centre_px)]
    room = min(min(k, n - 1 - k) for k, n in zip(axis, camera.sensor.shape, strict=True))
    return min(side, 2 * max(room, 0) + 1)
