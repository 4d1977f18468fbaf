"""The iris polygon with curved blades, and the aperture that a fit returns."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, any_of
from lfcal.psf.aperture._arcs import Arcs

__all__ = [
    "KINDS",
    "REFUSALS",
    "Aperture",
    "CountFit",
    "Obstruction",
    "StuckBlade",
    "blade_radius",
    "polygon_area",
    "with_error",
]

REFUSALS = {
    "too dim": "no lit area is visible above the noise",
    "too small": "the cutout has too few pixels to show an outline",
    "cut off": "the lit area reaches the edge of the cutout",
    "irregular": "the outline does not match any known kind of iris",
    "in focus": "the plane is in focus: the outline shows the images of the lenslets, not the iris",
    "unclear": "two shapes or two blade counts fit about equally well",
}
"""Reasons why a fit is refused, with their meaning."""

KINDS = {
    "": "unknown",
    "round": "round",
    "polygon": "polygon",
    "rounded polygon": "polygon of curved blades",
    "stuck blade": "a blade out of place",
    "cat's eye": "cut by a second rim",
    "obstructed": "obstructed",
    "annular": "annular",
}
"""Kinds of aperture, with their names in words."""

CENTRAL = 0.1
"""Distance of an obstruction from the centre, over the radius, below which the stop is annular."""


def blade_radius(
    theta: ArrayLike, blades: int, rotation_rad: float, apothem: float = 1.0, curvature: float = 0.0
) -> NDArray[np.float64]:
    """Return the distance of the iris's edge from its centre in each direction of ``theta``.

    Each blade's edge is an arc of radius ``apothem / curvature`` whose middle is at the distance ``apothem`` from the
    centre. With m = 1 - curvature and d the angle from the middle of the blade, the edge is at ``r = apothem (2 -
    curvature) / (sqrt(1 - m² sin² d) + m cos d)``. Blades with a curvature of 0 are straight; a curvature of 1 is a
    circle.

    Parameters
    ----------
    theta
        Directions (rad), from +column towards +row, in an array of any shape.
    blades
        Number of blades.
    rotation_rad
        Direction of a vertex (rad).
    apothem
        Distance from the centre to the middle of a blade, in any unit; the result has the same unit.
    curvature
        Ratio of the apothem to the radius of a blade's arc, 0 to 1.
    """
    step = 2 * math.pi / blades
    # counted from the middle of a blade, where the formula has its axis of symmetry
    d = np.mod(np.asarray(theta, float) - rotation_rad, step) - step / 2
    m = 1.0 - curvature
    edge: NDArray[np.float64] = apothem * (2.0 - curvature) / (np.sqrt(1.0 - (m * np.sin(d)) ** 2) + m * np.cos(d))
    return edge


def polygon_area(blades: int, apothem: float, curvature: float = 0.0) -> float:
    """Return the area inside the edge of `blade_radius`, in the squared unit of ``apothem``."""
    half = math.pi / blades
    vertex = float(blade_radius(0.0, blades, 0.0, apothem, curvature))
    polygon = blades * vertex * vertex * math.sin(2 * half) / 2
    # at curvature 0, the segments have infinite radius and area 0
    if curvature <= 0:
        return polygon
    radius = apothem / curvature
    # rounding may make the sine of half a circle larger than one
    opening = 2 * math.asin(min(1.0, vertex * math.sin(half) / radius))
    return polygon + blades * radius * radius * (opening - math.sin(opening)) / 2


def with_error(value: float, sigma: float, digits: int) -> str:
    """Return a value with at least ``digits`` decimals as text, with its standard error ``sigma`` if that is finite.

    Examples
    --------
    >>> from lfcal.psf.aperture import with_error
    >>> with_error(31.86, 0.024, 1), with_error(31.86, 2.4, 1), with_error(31.86, float("nan"), 1)
    ('31.86 ± 0.02', '31.9 ± 2.4', '31.9')
    """
    if not math.isfinite(sigma):
        return f"{value:.{digits}f}"
    # show at least one digit of an error, and no more digits of a value than its error has
    digits = max(digits, min(3, -math.floor(math.log10(sigma)))) if sigma > 0 else digits
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


@dataclass(frozen=True, slots=True)
class StuckBlade:
    """A blade of the iris that is displaced from its regular position.

    Attributes
    ----------
    blade
        Number of the blade, counted from 0 at the first vertex.
    direction_rad
        Direction of the blade's middle from the centre (rad), before the elongation is applied, as in `Aperture`.
    out_px, sigma_px
        Outward displacement (negative if inward) and its standard error (pixels). The error is infinite if neighbouring
        blades cover the blade, which may then be anywhere further out.
    """

    blade: int
    direction_rad: float
    out_px: float
    sigma_px: float


@dataclass(frozen=True, slots=True)
class Obstruction:
    """A dark object inside the aperture.

    Attributes
    ----------
    centre
        Centre (row, column) of the dark object (pixels).
    share
        Its area as a fraction of the aperture's area.
    """

    centre: tuple[float, float]
    share: float

    def is_central(self, centre: tuple[float, float], radius_px: float) -> bool:
        """Return whether the obstruction is near the centre, like the secondary mirror of a mirror lens.

        ``centre`` (row, column) and ``radius_px`` are those of the aperture (px). The centres must be less than
        `CENTRAL` radii apart.
        """
        return math.dist(self.centre, centre) < CENTRAL * radius_px


@dataclass(frozen=True, slots=True)
class CountFit:
    """The fit of an iris with a given number of blades to one plane.

    Attributes
    ----------
    blades
        Number of blades.
    gain
        Chi-square minus that of a circle, in units of the best shape's chi-square per degree of freedom; negative if
        the polygon fits better.
    rotation_rad, rotation_sigma
        Direction of the first vertex (rad), before the elongation is applied, and its standard error (rad).
    curvature, curvature_sigma
        Curvature of the blades and its standard error.
    """

    blades: int
    gain: float
    rotation_rad: float
    rotation_sigma: float
    curvature: float
    curvature_sigma: float


@dataclass(frozen=True, slots=True)
class Aperture:
    """Shape of the iris, as fitted to a depth-plane sum.

    Angles are measured from the +column axis towards the +row axis (clockwise as displayed), as in
    `lfcal.camera.MainLens`. ``rotation_rad``, ``apothem_px``, ``curvature``, ``stuck`` and ``rim`` describe the outline
    before the elongation is applied.

    Attributes
    ----------
    blades
        Number of blades; 0 for a circle, or if the blades cannot be resolved.
    centre
        Centre (row, column) in the cutout (px); NaN if no outline was found (`seen` is False).
    rotation_rad
        Direction of the first vertex from the centre (rad), in [0, 2 pi / blades).
    apothem_px
        Distance from the centre to the middle of a blade (px); for a circle, its radius. NaN if no outline was found.
    area_px2
        Area inside the outline (px²); NaN if no outline was found.
    curvature
        Ratio of the apothem to the radius of curvature of a blade: 0 for straight blades, 1 for a circle.
    blur_px
        Blur of the edge, as the standard deviation of a Gaussian (px).
    ellipticity, ellipse_axis_rad
        Elongation of the outline as 1 minus the ratio of the minor to the major axis, and direction of the major axis
        (rad).
    vignetting
        Relative decrease of the light from the centre to the mean radius of the edge. It is negative if the light
        increases towards the edge, and 0 if it was not measured.
    snr
        Signal-to-noise ratio: level of the lit area divided by the rms noise of a pixel.
    confidence
        Probability that the selected shape is correct, from 0 to 1, estimated from its margin over the next best shape;
        NaN if unknown.
    confident
        Whether ``kind``, ``blades`` and the outline are reliable.
    refusal
        Reason why the shape is unknown, a key of `REFUSALS`; empty if it is known.
    kind
        Kind of shape, a key of `KINDS`; empty if unknown.
    curvature_sigma
        Standard error of ``curvature``, including the error due to blur, which also rounds corners; NaN if unknown.
    stuck
        Displaced blade; None if there is none.
    rim
        Second rim that clips the aperture: direction of its nearest point from the centre (rad), distance of this point
        from the centre divided by the apothem, and curvature of the rim times the apothem. None if there is none.
    obstruction
        Dark object inside the aperture; None if there is none.
    ripple, ripple_pitch_px
        Amplitude, relative to the light, and period (px) of the strongest ripple of the lenslet lattice that was
        removed. Without ripple, the amplitude is 0 and the period is NaN.
    counts
        Fits of regular irises, one for each number of blades, best first; empty if none was tried.
    area_sigma_px2
        Standard error of ``area_px2`` (px²) due to noise, shading, and light diffracted beyond the cutout. It is NaN if
        no outline was fitted or the lit area has no uniform level.

    Examples
    --------
    >>> from lfcal.psf.aperture import Aperture
    >>> hexagon = Aperture(6, (40.0, 40.0), 0.0, apothem_px=30.0, area_px2=3117.7, confident=True, kind="polygon")
    >>> print(hexagon.describe())
    6 blades, centre (40.0, 40.0) px, diameter 63.0 px, rotated 0.0°, curvature 0.00
    >>> hexagon.vertices()[0].round(2).tolist()  # 30 / cos 30° = 34.64 to the right
    [40.0, 74.64]
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
    confidence: float = math.nan
    confident: bool = False
    refusal: str = ""
    kind: str = ""
    curvature_sigma: float = math.nan
    stuck: StuckBlade | None = None
    rim: tuple[float, float, float] | None = None
    obstruction: Obstruction | None = None
    ripple: float = 0.0
    ripple_pitch_px: float = math.nan
    counts: tuple[CountFit, ...] = ()
    area_sigma_px2: float = math.nan

    def __post_init__(self) -> None:
        """Check every value."""
        if self.refusal and self.refusal not in REFUSALS:
            raise InputError.expected(
                "reason for refusing the aperture", any_of(REFUSALS), repr(self.refusal), "choose one of these"
            )
        if self.refusal and self.confident:
            raise InputError.expected(
                "aperture that is marked as confident", "no reason for refusal", self.refusal, "remove one of the two"
            )
        if self.kind not in KINDS:
            raise InputError.expected(
                "kind of aperture", any_of(filter(None, KINDS)), repr(self.kind), "choose one of these"
            )
        if self.blades < 0 or self.blades in (1, 2):
            raise InputError.expected(
                "blades", "0 (a circle) or at least 3", self.blades, "change the number of blades"
            )

    def refused(self, refusal: str) -> Aperture:
        """Return a copy whose shape is marked as unknown for the reason ``refusal``, a key of `REFUSALS`."""
        return replace(self, kind="", confident=False, confidence=math.nan, refusal=refusal)

    @property
    def seen(self) -> bool:
        """Whether an outline was found; otherwise, neither position nor size is known."""
        return self.refusal not in ("too dim", "too small")

    @property
    def diameter_px(self) -> float:
        """Diameter of the circle with the same area (px); 0 if no outline was found."""
        return 2.0 * math.sqrt(max(0.0, self.area_px2) / math.pi)

    @property
    def diameter_sigma_px(self) -> float:
        """Standard error of `diameter_px` (px); NaN if unknown."""
        return self.diameter_px * self.area_sigma_px2 / (2.0 * self.area_px2) if self.area_px2 > 0 else math.nan

    @property
    def apothem_sigma_px(self) -> float:
        """Standard error of `apothem_px` (px), derived from that of the area; NaN if unknown."""
        return self.apothem_px * self.area_sigma_px2 / (2.0 * self.area_px2) if self.area_px2 > 0 else math.nan

    @property
    def reason(self) -> str:
        """Reason why the shape is unknown, as part of a sentence; empty if the shape is known."""
        return REFUSALS.get(self.refusal, "")

    @property
    def arcs(self) -> Arcs:
        """The circular arcs that form the outline."""
        # the stretch of the outline: (1/(1-e), 1/(1+e)) along the longer and the shorter axis
        e = self.ellipticity / (2.0 - self.ellipticity)
        turn = 2 * self.ellipse_axis_rad
        stuck, share = -1, 0.0
        if self.stuck is not None:
            stuck, share = self.stuck.blade, self.stuck.out_px / self.apothem_px
        return Arcs(
            self.apothem_px,
            self.curvature,
            self.blades,
            self.rotation_rad,
            stuck,
            share,
            self.rim,
            -e * math.cos(turn),
            -e * math.sin(turn),
        )

    def outline(self, n: int = 360) -> NDArray[np.float64]:
        """Return ``n`` points (row, column) along the outline, ``(n, 2)`` (px); the first point is not repeated.

        They start at the first vertex, with equal angles between them before the elongation is applied.
        """
        return self._place(self.rotation_rad + 2 * math.pi * np.arange(n) / n)

    def vertices(self) -> NDArray[np.float64]:
        """Return the vertices (row, column) of the outline, ``(blades, 2)`` (px); empty for a circle.

        They are the points of the outline in the directions of the vertices of a regular iris. These are the
        directions before the elongation. If a blade is displaced or a second rim clips the aperture, the outline may
        have its corners elsewhere.
        """
        theta = self.rotation_rad + 2 * math.pi * np.arange(self.blades) / max(1, self.blades)
        return self._place(theta)

    def _place(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the points of the outline that lay in directions ``theta`` before it was stretched."""
        arcs = self.arcs
        x, y = np.cos(theta), np.sin(theta)
        determinant = 1 - arcs.stretch**2 - arcs.shear**2
        u = ((1 - arcs.stretch) * x - arcs.shear * y) / determinant
        v = ((1 + arcs.stretch) * y - arcs.shear * x) / determinant
        radius = arcs.radius(np.arctan2(v, u)) / np.hypot(u, v)
        return np.stack([self.centre[0] + radius * v, self.centre[1] + radius * u], axis=-1)

    def describe(self) -> str:
        """Return a one-line description of what is known of the aperture: kind, centre, size, orientation, fault."""
        if not self.seen:
            return f"no aperture: {self.reason}"
        size = with_error(self.diameter_px, self.diameter_sigma_px, 1)
        where = f"centre ({self.centre[0]:.1f}, {self.centre[1]:.1f}) px, diameter {size} px"
        if self.refusal or not self.confident:
            return "; ".join(filter(None, (f"unknown shape, {where}", self.reason, self.fault)))
        return ", ".join(filter(None, (self._what(), where, self._turn(), self.fault)))

    def _what(self) -> str:
        """Return the shape in words."""
        base = f"{self.blades} blades" if self.blades else "round"
        if self.kind == "cat's eye":
            return f"cat's eye ({base}, {KINDS[self.kind]})"
        if self.kind == "annular":
            return f"annular ({base})"
        return base

    def _turn(self) -> str:
        if not self.blades:
            return ""
        error = f" ± {self.curvature_sigma:.2f}" if math.isfinite(self.curvature_sigma) else ""
        return f"rotated {math.degrees(self.rotation_rad):.1f}°, curvature {self.curvature:.2f}{error}"

    @property
    def fault(self) -> str:
        """Description of a displaced blade or an obstruction; empty if there is neither."""
        if self.stuck is not None:
            way, far = "out" if self.stuck.out_px > 0 else "in", abs(self.stuck.out_px)
            at = math.degrees(self.stuck.direction_rad)
            known = math.isfinite(self.stuck.sigma_px)
            size = f"{far:.2f} ± {self.stuck.sigma_px:.2f} px" if known else f"at least {far:.1f} px"
            return f"blade {self.stuck.blade + 1} at {at:.0f}° stuck {size} too far {way}"
        if self.obstruction is not None:
            row, column = self.obstruction.centre
            if self.obstruction.is_central(self.centre, self.apothem_px):
                return f"central obstruction of {100 * math.sqrt(self.obstruction.share):.0f} % of the diameter"
            return f"{100 * self.obstruction.share:.1f} % obstructed about ({row:.1f}, {column:.1f}) px"
        return ""
