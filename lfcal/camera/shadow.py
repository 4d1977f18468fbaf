"""Size of the image of a point on the sensor, by geometry."""

from __future__ import annotations

import math

import numpy as np

from lfcal.camera.description import Camera
from lfcal.camera.main_lens import Microscope

__all__ = ["cutout_for", "half_extent_px", "rms_radius_px"]

AIRY_RADII = 3.0
"""Margin in Airy radii of a lenslet; 5.7 % of a spot at the pattern's edge is outside, much less of the pattern."""

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


def half_extent_px(camera: Camera, z_um: float) -> float:
    """Return the half width of the pattern of a point at depth ``z_um`` about its chief ray (sensor pixels).

    A ray through pupil point p meets the array p·a/(b+a) from the chief ray with slope -p/(b+a). Its lenslet deflects
    it by -e/f, where e is the distance from the lenslet's centre. On the sensor, B behind, this gives ``p (a - B)/(b +
    a) - (B/f) e``, whose bound is taken over the pupil's corners and the lenslet's edge.
    """
    gap = camera.lattice.gap_um
    shadow, slope = _edge_slope(camera, z_um)
    spread = abs(math.copysign(shadow, camera.image_shift_um(z_um)) - gap * slope)
    diameter = camera.lattice.clear_diameter_um / camera.lattice_scale
    bend = max(gap / kind.focal_length_um for kind in camera.lattice.types) * diameter / 2
    airy = 1.22 * camera.wavelength_um * gap / diameter
    return (spread + bend + AIRY_RADII * airy) / camera.sensor.pixel_um


def rms_radius_px(camera: Camera, z_um: float) -> float:
    """Return the RMS distance of the light of a point at depth ``z_um`` from its chief ray (sensor pixels).

    Uses the rays of `half_extent_px` from an evenly lit pupil (for a microscope, by the sine condition), with the
    deflection and diffraction by the lenslets. It is valid for a pattern of several lenslets.
    """
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
    """Return the odd side of the smallest square cutout that contains the pattern at every depth (pixels).

    Half a pixel is added for an anchor between two pixels.
    """
    half = max(half_extent_px(camera, z) for z in depths_um)
    return 2 * math.ceil(half + 0.5) + 1
