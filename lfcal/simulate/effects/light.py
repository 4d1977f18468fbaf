"""Effects of the light: the size of the source and the width of its spectrum."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lfcal.simulate.effects.base import Estimate, LightEffect, LightSample
from lfcal.simulate.effects.outlook import Outlook

__all__ = ["Bandwidth", "FiniteSource"]

DEGREE_PER_WIDTH = 3.0
"""Degree of the quadrature rule per radius of the source's image, in spot widths."""

MAX_DEGREE = 150
"""Largest degree (5738 points), for a source a hundred spots wide; more points would take too long."""


@dataclass(frozen=True, slots=True)
class FiniteSource(LightEffect):
    """A source of finite size: a uniformly bright disc.

    Attributes
    ----------
    diameter_um
        Diameter of the source in object space (µm). None: a pinhole of 50 µm, or a bead of 0.2 µm for a microscope.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import FiniteSource, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> pinhole = FiniteSource(diameter_um=50.0)
    >>> print(f"{pinhole.image_px(plane):.1f} px on the lenslets, in {pinhole.runs(plane)} points")
    2.4 px on the lenslets, in 7 points
    """

    diameter_um: float | None = None

    name: ClassVar[str] = "finite_source"
    typical_sizes: ClassVar[Mapping[str, tuple[float, float]]] = {"diameter_um": (50.0, 0.2)}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"diameter_um": (0.0, math.inf)}
    title: ClassVar[str] = "finite source size"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 10
    deviation: ClassVar[bool] = True
    measured_by: ClassVar[str] = "source"

    def image_px(self, outlook: Outlook) -> float:
        """Return the diameter of the source's paraxial image at the lenslets (px)."""
        diameter: float = self.magnitude("diameter_um", outlook.camera)
        return diameter / outlook.camera.step_um(outlook.z_um)

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the diameter of the source's image on the sensor, formed by one lenslet (px), and the relative error.

        The error is due to the blur of the spots and of the edge of the iris's shadow.
        """
        image = self.image_px(outlook)
        # the rms of a disc's coordinate is a quarter of its diameter; defocus scales the image by 1/v
        spot = image / outlook.depth
        edge = outlook.shadow_moved(0.4 * image / 4)
        return Estimate(spot, "px", min(2.0, outlook.blurred(spot / 4) + edge), "D |M|/v; 0.74 (s/w)² + edge, s = D/4")

    def degree(self, outlook: Outlook) -> int:
        """Return the polynomial degree, 5 to 150, up to which the quadrature rule over the source must be exact.

        The spatial frequencies k of a spot of rms width w reach about 2/w. If the spot moves by R between the centre
        and the edge of the source, a rule of degree D is accurate up to k R of about D/2. The same applies to the edge
        of the iris's shadow, which moves across the lenslets.
        """
        radius = self.image_px(outlook) / 2
        moved = radius / outlook.depth / min(outlook.widths_px)
        if outlook.camera.has_lattice:
            moved = max(moved, 2 * radius / outlook.camera.pitch_px)
        return min(MAX_DEGREE, max(5, math.ceil(DEGREE_PER_WIDTH * moved) + 3))

    def spread(self, samples: tuple[LightSample, ...], outlook: Outlook) -> tuple[LightSample, ...]:
        """Return, for each of ``samples``, one sample for each point of `disc_rule` on the source.

        There are 7 points, or more if `degree` requires them for a source whose image is large.
        """
        radius = self.image_px(outlook) / 2
        points = disc_rule(self.degree(outlook))
        return tuple(
            LightSample(s.rows + radius * y, s.columns + radius * x, s.wavelength_um, s.weight * w)
            for s in samples
            for y, x, w in points
        )


def disc_rule(degree: int = 5) -> list[tuple[float, float, float]]:
    """Return the points ``(y, x, weight)`` of a quadrature rule for the mean over the unit disc; weights sum to 1.

    The rule is exact for polynomials up to ``degree``. Up to degree 5, it has the 7 points of Abramowitz & Stegun
    25.4.61. For higher degrees, it has rings of ``degree`` + 1 points at Gauss-Legendre nodes of the squared radius.
    """
    if degree <= 5:
        radius, turns = math.sqrt(2 / 3), 2 * math.pi * np.arange(6) / 6
        return [(0.0, 0.0, 1 / 4), *((radius * math.sin(t), radius * math.cos(t), 1 / 8) for t in turns)]
    # averaged over the angle, a polynomial is one in the squared radius, of half the degree
    nodes, weights = np.polynomial.legendre.leggauss(degree // 4 + 1)
    count = degree + 1
    rule = []
    for k, (node, weight) in enumerate(zip(nodes.tolist(), weights.tolist(), strict=True)):
        radius = math.sqrt((node + 1) / 2)
        for turn in range(count):
            angle = 2 * math.pi * (turn + 0.5 * (k % 2)) / count
            rule.append((radius * math.sin(angle), radius * math.cos(angle), weight / 2 / count))
    return rule


@dataclass(frozen=True, slots=True)
class Bandwidth(LightEffect):
    """Light with a uniform spectrum centred on the design wavelength.

    Attributes
    ----------
    width_um
        Full width of the spectrum (µm). None: that of the camera.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Bandwidth, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = Bandwidth(0.055).estimate(plane)
    >>> print(f"{found.size:.0%} of 0.55 µm washes out {found.error:.1%} of the image")
    10% of 0.55 µm washes out 0.4% of the image
    """

    width_um: float | None = None

    name: ClassVar[str] = "bandwidth"
    titles: ClassVar[Mapping[str, str]] = {"width_um": "full width"}
    described: ClassVar[Mapping[str, str]] = {"width_um": "bandwidth_um"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"width_um": (0.0, math.inf)}
    title: ClassVar[str] = "bandwidth"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 20

    def width(self, outlook: Outlook) -> float:
        """Return the full width of the spectrum (µm)."""
        width: float = self.magnitude("width_um", outlook.camera)
        return width

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the bandwidth divided by the wavelength, and the relative error due to fringes that are washed out.

        For narrow bands, the error is quadratic in the bandwidth. Above a relative bandwidth of about a tenth, the
        outer fringes of the spots have vanished, and the error grows linearly. Interference fringes between
        neighbouring lenslets are finer and vanish sooner. The larger the lenslets, the less light these fringes
        contain. Behind a photographic main lens, pixels larger than the wavelength times the working f-number average
        out the fringes even at zero bandwidth. In a Fourier light-field microscope, the error is linear throughout.
        """
        x = self.width(outlook) / outlook.wavelength_um
        fringes = sum(outlook.fresnel_lenslets) / len(outlook.fresnel_lenslets)
        spots = (0.25 + 0.13 * fringes) * x * x / (1.0 + x * (1.0 + 0.1 * fringes) / 0.12)
        iris = 0.25 * (x / outlook.lenslets) ** 2
        if not outlook.camera.has_lattice:  # the rings of each spot scale with the wavelength
            return Estimate(x, "relative", min(1.0, x * (0.2 + 0.03 * fringes)), "x = dl/l; (0.2 + 0.03 N_F) x")
        pixels = outlook.pixel_um / (outlook.wavelength_um * outlook.f_number)
        seen = 2.2 / (1.0 + (0.45 * pixels) ** 2) if outlook.has_lens else 1.0
        error = min(1.0, seen * (spots + self._between(outlook, x)) + iris)
        formula = "x = dl/l; (0.25 + 0.13 N_F) x²/(1 + 8.3 x (1 + 0.1 N_F)) + fringes"
        if outlook.has_lens:
            formula += ", both times 2.2/(1 + (0.45 p/(l F))²)"
        return Estimate(x, "relative", error, formula)

    def holds(self, outlook: Outlook) -> bool:
        """Return whether the formula is valid: each lenslet receives enough diffraction fringes of the iris.

        This requires a main lens, |v| >= 1.2 (v: virtual depth) and a Fresnel number of the iris's shadow of at least
        12. For a Fourier light-field microscope, the formula is always valid.
        """
        if not outlook.camera.has_lattice:
            return True
        return outlook.regular and abs(outlook.virtual_depth) >= 1.2 and outlook.fresnel_main >= 12.0

    @staticmethod
    def _between(outlook: Outlook, x: float) -> float:
        """Return the light washed out of the interference of neighbouring lenslets: most - most exp(-c x²/most)."""
        n = outlook.lenslets
        share = (11.0 / outlook.camera.pitch_px) ** 2 * min(1.0, 0.08 + (n - 1.0) / 4.0)
        steep, most = 6.0 * share, 0.006 * share
        if not outlook.has_lens:
            more = math.sqrt(max(1.0, n / 17.0))
            steep, most = 9.0 * share * math.sqrt(more), 0.024 * share * more
        return most * -math.expm1(-steep * x * x / most)

    def count(self, outlook: Outlook, least: int = 1) -> int:
        """Return the number of wavelengths: 1 if the bandwidth is 0, otherwise 3 to 9, or ``least`` if that is more."""
        width = self.width(outlook)
        if width == 0:
            return 1
        if not outlook.camera.has_lattice:
            return max(least, 3)
        # number of fringes of the iris that wash out over the spectrum: proportional to Fresnel number times width
        return max(least, min(9, 3 + math.ceil(outlook.fresnel_main * width / outlook.wavelength_um / 4)))

    def spread(self, samples: tuple[LightSample, ...], outlook: Outlook, least: int = 1) -> tuple[LightSample, ...]:
        """Return, for each of ``samples``, one sample for each of `count` Gauss-Legendre wavelengths of the spectrum.

        ``least`` is passed to `count`. If the bandwidth is 0, ``samples`` are returned unchanged.
        """
        width = self.width(outlook)
        if width == 0:
            return samples
        nodes, weights = np.polynomial.legendre.leggauss(self.count(outlook, least))
        return tuple(
            # leggauss integrates over [-1, 1]; its weights sum to 2
            LightSample(s.rows, s.columns, s.wavelength_um + 0.5 * width * float(u), s.weight * float(w) / 2)
            for s in samples
            for u, w in zip(nodes, weights, strict=True)
        )


EFFECTS = (FiniteSource, Bandwidth)
