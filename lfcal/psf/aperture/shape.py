"""The iris polygon with curved blades, and the aperture a fit returns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.errors import InputError

__all__ = ["REFUSALS", "Aperture", "blade_radius", "polygon_area"]

REFUSALS = {
    "too dim": "no lit patch stands out of the noise",
    "cut off": "the lit patch reaches the edge of the cutout",
    "circle": "the outline cannot be distinguished from a circle",
    "cat-eye": "the outline fits no regular iris: vignetted, obstructed or doubled",
    "lenslets": "the shadow is no larger than what the lenslets themselves show",
    "unclear": "two blade counts, or a count and a circle, fit about equally well",
}
"""Why a fit is refused, and what that means."""


def blade_radius(
    theta: ArrayLike, blades: int, rotation_rad: float, apothem: float = 1.0, curvature: float = 0.0
) -> NDArray[np.float64]:
    """Return the iris's edge radius in direction ``theta`` (rad, from +column towards +row).

    A blade is an arc of radius ``apothem / curvature`` whose middle lies ``apothem`` from the centre; with
    m = 1 - curvature and d the angle from the middle of the blade, the edge is at
    ``r = apothem (2 - curvature) / (sqrt(1 - m² sin² d) + m cos d)``: straight blades at 0, a circle at 1.

    Parameters
    ----------
    theta
        Directions, any shape (rad).
    blades
        Number of blades.
    rotation_rad
        Direction of a vertex (rad).
    apothem
        Distance from the centre to the middle of a blade; its unit is the result's.
    curvature
        Apothem over blade radius, 0 to 1.
    """
    step = 2 * math.pi / blades
    # counted from the middle of a blade, where the formula has its axis of symmetry
    d = np.mod(np.asarray(theta, float) - rotation_rad, step) - step / 2
    m = 1.0 - curvature
    edge: NDArray[np.float64] = apothem * (2.0 - curvature) / (np.sqrt(1.0 - (m * np.sin(d)) ** 2) + m * np.cos(d))
    return edge


def polygon_area(blades: int, apothem: float, curvature: float = 0.0) -> float:
    """Return the area inside `blade_radius`: n-gon plus n circular segments (unit of ``apothem`` squared)."""
    half = math.pi / blades
    vertex = float(blade_radius(0.0, blades, 0.0, apothem, curvature))
    polygon = blades * vertex * vertex * math.sin(2 * half) / 2
    # at curvature 0 the segments' radius is infinite, and their area 0
    if curvature <= 0:
        return polygon
    radius = apothem / curvature
    # rounding may push the sine of a full half circle above one
    opening = 2 * math.asin(min(1.0, vertex * math.sin(half) / radius))
    return polygon + blades * radius * radius * (opening - math.sin(opening)) / 2


@dataclass(frozen=True, slots=True)
class Aperture:
    """The iris as a depth-plane sum shows it.

    Angles run from the +column towards the +row axis (clockwise as shown), as in `lfcal.camera.MainLens`.

    Attributes
    ----------
    blades
        Number of blades; 0 where a circle is all that can be said.
    centre
        Centre (row, column) in the cutout (pixels).
    rotation_rad
        Direction of the first vertex, in [0, 2 pi / blades) (rad).
    apothem_px
        Distance from the centre to the middle of a blade; of a circle its radius (pixels).
    area_px2
        Area inside the outline (pixels squared).
    curvature
        Apothem over blade radius: 0 straight blades, 1 a circle. The lenslets' own width rounds the corners
        of a depth-plane sum, so that a small aperture looks rounder than it is.
    blur_px
        Width of the edge: standard deviation of the Gaussian that would make it (pixels).
    ellipticity, ellipse_axis_rad
        1 - minor/major of the stretched outline, and the direction of its longer axis (rad).
    vignetting
        Share by which the light falls from the centre to the middle of a blade.
    snr
        Lit level over the noise of one pixel.
    confidence
        From 0 to 1, how far the blade count stands out.
    confident
        Whether blade count and outline may be relied on.
    refusal
        Key of `REFUSALS`, or empty: why the fit was refused.
    """

    blades: int
    centre: tuple[float, float]
    rotation_rad: float
    apothem_px: float
    area_px2: float
    curvature: float = 0.0
    blur_px: float = 0.0
    ellipticity: float = 0.0
    ellipse_axis_rad: float = 0.0
    vignetting: float = 0.0
    snr: float = 0.0
    confidence: float = 0.0
    confident: bool = False
    refusal: str = ""

    def __post_init__(self) -> None:
        """Check every value."""
        if self.refusal and self.refusal not in REFUSALS:
            raise InputError.expected("refusal", " or ".join(REFUSALS), repr(self.refusal), "choose one")
        if self.refusal and self.confident:
            raise InputError.expected("aperture", "no refusal where confident", self.refusal, "drop either")
        if self.blades < 0 or self.blades in (1, 2):
            raise InputError.expected("blades", "0 (a circle) or 3 and more", self.blades, "correct it")

    @property
    def diameter_px(self) -> float:
        """Diameter of the circle of the same area (pixels)."""
        return 2.0 * math.sqrt(max(0.0, self.area_px2) / math.pi)

    @property
    def reason(self) -> str:
        """What the refusal means, as a sentence part; empty where there is none."""
        return REFUSALS.get(self.refusal, "")

    def outline(self, n: int = 360) -> NDArray[np.float64]:
        """Return ``n`` points (row, column) along the outline, not closed (pixels); shape ``(n, 2)``."""
        theta = self.rotation_rad + 2 * math.pi * np.arange(n) / n
        return self._place(theta)

    def vertices(self) -> NDArray[np.float64]:
        """Return the corners (row, column), shape ``(blades, 2)`` (pixels); empty for a circle."""
        theta = self.rotation_rad + 2 * math.pi * np.arange(self.blades) / max(1, self.blades)
        return self._place(theta)

    def _place(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.blades:
            radius = blade_radius(theta, self.blades, self.rotation_rad, self.apothem_px, self.curvature)
        else:
            radius = np.full(theta.shape, self.apothem_px)
        # the stretch that makes the outline: (1/(1-e), 1/(1+e)) along the longer and the shorter axis
        e = self.ellipticity / (2.0 - self.ellipticity)
        c, s = math.cos(self.ellipse_axis_rad), math.sin(self.ellipse_axis_rad)
        x, y = radius * np.cos(theta), radius * np.sin(theta)
        along, across = (x * c + y * s) / (1 - e), (-x * s + y * c) / (1 + e)
        return np.stack([self.centre[0] + along * s + across * c, self.centre[1] + along * c - across * s], axis=-1)

    def describe(self) -> str:
        """Return one line for people."""
        if self.refusal == "too dim":
            return f"no aperture: {self.reason}"
        where = f"centre ({self.centre[0]:.1f}, {self.centre[1]:.1f}) px, diameter {self.diameter_px:.1f} px"
        # a count that is refused is none to be named
        if self.refusal or not self.blades:
            return f"{where}; {self.reason}" if self.reason else where
        turn = f"rotated {math.degrees(self.rotation_rad):.1f}°, curvature {self.curvature:.2f}"
        return f"{self.blades} blades, {where}, {turn}"
