"""A specimen of another refractive index than the immersion medium, behind a plane interface."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import check_number
from lfcal.camera import Microscope

__all__ = ["Crossing", "Specimen", "cone_radius_um", "ray_heights"]

F8 = NDArray[np.float64]
C16 = NDArray[np.complex128]

STEEPEST = 0.99
"""Sine in the specimen up to which rays are followed: beyond it tangents run away with little light."""
EDGE_RAYS = 64
"""Rays over the pupil among which the outermost on the array is looked for."""


class Crossing(NamedTuple):
    """What an interface does to plane waves by their angles; arrays of one shape.

    Attributes
    ----------
    axial
        n2 cos t2 in the specimen, positive imaginary beyond total reflection.
    s, p
        Fresnel's coefficients of waves polarised along the interface and across it.
    """

    axial: C16
    s: C16
    p: C16


@dataclass(frozen=True, slots=True)
class Specimen:
    """What the light crosses on its way from a microscope's source to the immersion medium.

    Attributes
    ----------
    index
        Refractive index of the specimen.
    depth_um
        Depth of the nominal focal plane below the interface: a source at z lies ``depth_um + z`` deep, and one that
        lies before the interface in the immersion medium.
    """

    index: float
    depth_um: float = 0.0

    def __post_init__(self) -> None:
        """Check every value."""
        check_number("index of the specimen", self.index, at_least=1, at_most=4)
        check_number("depth of the focal plane below the interface (µm)", self.depth_um, at_least=0)

    def source_um(self, z_um: float) -> float:
        """Return the depth of a source below the interface; negative before it."""
        return self.depth_um + z_um

    def focus_um(self, z_um: float, medium_index: float) -> float:
        """Return where a source at ``z_um`` seems to lie by paraxial rays, as seen in the immersion medium."""
        deep = self.source_um(z_um)
        return z_um if deep < 0 else medium_index * deep / self.index - self.depth_um

    def crossing(self, medium_index: float, theta: F8) -> Crossing:
        """Return what the interface does to waves at angles ``theta`` in the medium, per solid angle of the medium.

        With n2 sin t2 = n1 sin t: s = 2 n1 cos t / (n1 cos t + n2 cos t2), p = 2 n1 cos t / (n2 cos t + n1 cos t2).
        They are the coefficients of a wave on its way in: those of the way out times n1 cos t / (n2 cos t2), which
        turns plane waves of the specimen into amplitudes per solid angle of the medium (reciprocity).
        """
        n1, n2 = medium_index, self.index
        across, first = n1 * np.sin(theta), n1 * np.cos(theta)
        axial: C16 = np.sqrt(((n2 - across) * (n2 + across)).astype(np.complex128))
        return Crossing(axial, 2 * first / (first + axial), 2 * first / (n2 * np.cos(theta) + n1 * axial / n2))


def ray_heights(optics: Microscope, z_um: float, specimen: Specimen | None, theta: F8) -> F8:
    """Return where rays of a source at ``z_um`` meet the array, by their angle in the medium (µm, signed by side).

    M z tan t, or M (d tan t2 - D tan t) behind an interface; NaN for those that total reflection keeps.
    """
    if specimen is None or specimen.source_um(z_um) < 0:
        return optics.magnification * z_um * np.tan(theta)
    across = optics.medium_index / specimen.index * np.sin(theta)
    within = np.where(across < STEEPEST, across, np.nan)
    slope = within / np.sqrt(1 - within * within)
    heights: F8 = optics.magnification * (specimen.source_um(z_um) * slope - specimen.depth_um * np.tan(theta))
    return heights


def cone_radius_um(optics: Microscope, z_um: float, specimen: Specimen | None) -> float:
    """Return the radius of the disc that the rays of a source at ``z_um`` light on the array (µm)."""
    if specimen is None:
        return optics.magnification * abs(z_um) * math.tan(optics.half_angle_rad)
    theta = optics.half_angle_rad * np.arange(1, EDGE_RAYS + 1) / EDGE_RAYS
    return float(np.nanmax(np.abs(ray_heights(optics, z_um, specimen, theta))))
