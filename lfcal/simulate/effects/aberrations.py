"""Aberrations of the main lens as wavefronts on its pupil."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from lfcal.simulate.effects.base import Estimate, SceneEffect
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.scene import Scene, Wavefront, check_wavefront, seidel

__all__ = ["Coma", "FieldAberrations", "Spherical", "Zernike"]


def _mean_shift(outlook: Outlook, rim_slope: float) -> float:
    """Return the mean spot shift (pixels) for a wavefront whose slope at the rim is ``rim_slope`` waves per radius.

    A slope of g waves per pupil radius deflects a ray by 2 Nw g lambda at the array's distance a. This moves the spot
    by 2 Nw g lambda / |v| on the sensor.
    """
    shift = 2 * outlook.f_number * rim_slope * outlook.wavelength_um / outlook.depth
    return shift / outlook.pixel_um


class _Aberration(SceneEffect):
    """Base of the aberrations: Zernike terms on the pupil, and a table of the aberrated field for each plane."""

    __slots__ = ()
    deviation: ClassVar[bool] = True
    measured_by: ClassVar[str] = "wavefront"
    needs_waves: ClassVar[bool] = True

    @abstractmethod
    def terms_of(self) -> Wavefront:
        """Return the Zernike terms of the wavefront."""

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with the wavefront added, which only waves show; unchanged without Zernike terms."""
        del outlook
        terms = self.terms_of()
        return replace(scene, wavefront=scene.wavefront + terms, lenslet_diffraction=True) if terms else scene


@dataclass(frozen=True, slots=True)
class Spherical(_Aberration):
    """Third-order spherical aberration W040 rho^4, with the pupil radius rho (1 at the rim).

    Attributes
    ----------
    waves
        Coefficient W040 (wavelengths).

    Examples
    --------
    >>> from lfcal.simulate.effects import Spherical
    >>> [(n, m, round(waves, 3)) for n, m, waves in Spherical(0.6).terms_of()]  # rho^4 is (R40 + 3 R20 + 2)/6
    [(4, 0, 0.1), (2, 0, 0.3), (0, 0, 0.2)]
    """

    waves: float = 0.25

    name: ClassVar[str] = "spherical"
    changes_work: ClassVar[bool] = True
    units: ClassVar[Mapping[str, str]] = {"waves": "waves"}
    titles: ClassVar[Mapping[str, str]] = {"waves": "size W040"}
    title: ClassVar[str] = "spherical aberration"
    rank: ClassVar[int] = 70

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return |W040| (waves), and the relative error due to the mean spot shift (0.4 of the marginal ray's)."""
        shift = 0.4 * _mean_shift(outlook, 4 * abs(self.waves))
        return Estimate(abs(self.waves), "waves", outlook.moved(shift), "shift 0.4 * 8 Nw W lambda/v")

    def terms_of(self) -> Wavefront:
        """Return W040 rho^4 as a sum of Zernike terms (waves)."""
        return seidel(spherical=self.waves)


@dataclass(frozen=True, slots=True)
class Coma(_Aberration):
    """Third-order coma W131 rho^3 cos(theta - angle), with the pupil coordinates rho (1 at the rim) and theta.

    Attributes
    ----------
    waves
        Coefficient W131 in the simulated region (wavelengths).
    angle_rad
        Azimuth of the field point, from +x towards +y (rad).

    Examples
    --------
    >>> from lfcal.simulate.effects import Coma
    >>> [(n, m, round(waves, 3)) for n, m, waves in Coma(0.3).terms_of() if waves]  # rho^3 cos is (R31 + 2 R11)/3
    [(3, 1, 0.1), (1, 1, 0.2)]
    """

    waves: float = 0.25
    angle_rad: float = 0.0

    name: ClassVar[str] = "coma"
    changes_work: ClassVar[bool] = True
    units: ClassVar[Mapping[str, str]] = {"waves": "waves"}
    titles: ClassVar[Mapping[str, str]] = {"waves": "size W131", "angle_rad": "direction"}
    title: ClassVar[str] = "coma"
    rank: ClassVar[int] = 71

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return |W131| (waves), and the relative error due to the mean spot shift.

        The shift is estimated from the rms slope of the wavefront.
        """
        shift = _mean_shift(outlook, 0.75 * 1.29 * abs(self.waves))
        return Estimate(abs(self.waves), "waves", outlook.moved(shift), "shift 2 Nw * 0.97 W lambda/v")

    def terms_of(self) -> Wavefront:
        """Return W131 rho^3 cos(theta - angle) as a sum of Zernike terms (waves)."""
        return seidel(coma=self.waves, angle_rad=self.angle_rad)


@dataclass(frozen=True, slots=True)
class Zernike(_Aberration):
    """Aberration of the main lens or objective, given as Zernike terms.

    Attributes
    ----------
    terms
        Tuples of radial order n, azimuthal order m and coefficient ``waves`` (wavelengths). Each adds ``waves`` times
        R_n^|m|(rho) cos(m theta), or R_n^|m|(rho) sin(|m| theta) for m < 0. The radial polynomial R is 1 at the rim
        (rho is 1).

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Outlook, Zernike
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> astigmatism = Zernike(((2, 2, 0.5),))
    >>> round(astigmatism.estimate(plane).size, 3)  # 0.5/sqrt(6) waves rms
    0.204
    """

    terms: Wavefront = ()

    name: ClassVar[str] = "zernike"
    changes_work: ClassVar[bool] = True
    units: ClassVar[Mapping[str, str]] = {"terms": "waves"}
    title: ClassVar[str] = "measured wavefront"
    rank: ClassVar[int] = 72

    def __post_init__(self) -> None:
        """Check that every term is a Zernike polynomial with a finite coefficient."""
        SceneEffect.__post_init__(self)  # a plain super() does not know a class with slots
        check_wavefront(self.terms)

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the rms wavefront error (waves), and the relative error due to the mean spot shift.

        The shift is estimated from the rms slope of the wavefront.
        """
        rms, slope = wavefront_rms(self.terms)
        return Estimate(
            rms, "waves rms", outlook.moved(_mean_shift(outlook, 0.75 * slope)), "shift 2 Nw * 0.75 |grad W| lambda/v"
        )

    def terms_of(self) -> Wavefront:
        """Return `terms`, the given Zernike terms (waves)."""
        return self.terms


@dataclass(frozen=True, slots=True)
class FieldAberrations(SceneEffect):
    """Third-order field dependence of the wavefront, for a lens whose elements may be decentred or tilted.

    For the normalised field point h = (x + i y)/``radius_um``, coma is ``coma`` h. Astigmatism is ``astigmatism`` h²
    plus the contribution of decentred elements, (``astigmatism_x`` + i ``astigmatism_y``) h. Spherical aberration is
    ``spherical`` |h|². In each case, the real part is the coefficient of the cosine Zernike term, and the imaginary
    part that of the sine term (Thompson 2005, eqs. 13 and 27). The effect `Zernike` adds the wavefront on the axis, and
    `FieldCurvature` the variation of focus.

    Attributes
    ----------
    coma
        Coefficient of the Zernike term with the radial polynomial R_3^1, at ``radius_um`` (wavelengths); R is 1 at the
        rim of the pupil.
    astigmatism
        Coefficient of the term with R_2^2 at ``radius_um``, quadratic in the field (wavelengths).
    astigmatism_y, astigmatism_x
        Coefficients of the terms with R_2^2 at ``radius_um`` that are linear in the field (wavelengths).
    spherical
        Coefficient of R_4^0 at ``radius_um``, in addition to its value on the axis (wavelengths).
    radius_um
        Distance from the axis on the sensor to which the coefficients refer (µm).

    Examples
    --------
    >>> from lfcal.simulate.effects import FieldAberrations
    >>> effect = FieldAberrations(coma=0.1, astigmatism=0.1, radius_um=10e3)
    >>> effect.terms_at((0.0, 5e3))  # half-way out half the coma, a quarter of the astigmatism (waves)
    ((2, 2, 0.025), (3, 1, 0.05))
    """

    coma: float = 0.1
    astigmatism: float = 0.1
    astigmatism_y: float = 0.0
    astigmatism_x: float = 0.0
    spherical: float = 0.0
    radius_um: float = 10e3

    name: ClassVar[str] = "field_aberrations"
    changes_work: ClassVar[bool] = True
    units: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("coma", "astigmatism", "astigmatism_y", "astigmatism_x", "spherical"), "waves"
    )
    titles: ClassVar[Mapping[str, str]] = {
        "astigmatism_y": "linear astigmatism, sine",
        "astigmatism_x": "linear astigmatism, cosine",
        "radius_um": "from the axis",
    }
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"radius_um": (1.0, 1e9)}
    title: ClassVar[str] = "aberrations over the field"
    rank: ClassVar[int] = 73
    deviation: ClassVar[bool] = True
    needs_waves: ClassVar[bool] = True

    def terms_at(self, field_um: tuple[float, float]) -> Wavefront:
        """Return the nonzero Zernike terms (waves) at the sensor point ``field_um``, (y, x) from the axis (µm)."""
        y, x = field_um
        at = complex(x, y) / self.radius_um
        coma = self.coma * at
        astigmatism = self.astigmatism * at**2 + complex(self.astigmatism_x, self.astigmatism_y) * at
        found = (
            (2, 2, astigmatism.real),
            (2, -2, astigmatism.imag),
            (3, 1, coma.real),
            (3, -1, coma.imag),
            (4, 0, self.spherical * abs(at) ** 2),
        )
        return tuple(term for term in found if term[2])

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the rms wavefront error in the middle of the region (waves), and the resulting relative error."""
        rms, slope = wavefront_rms(self.terms_at(outlook.field_um))
        return Estimate(
            rms, "waves rms", outlook.moved(_mean_shift(outlook, 0.75 * slope)), "shift 2 Nw * 0.75 |grad W| lambda/v"
        )

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with the wavefront of its field position added, or unchanged if that is zero."""
        terms = self.terms_at(outlook.field_um)
        if not terms:
            return scene
        # one term of each order, because the steepness of a wavefront is estimated term by term
        total = {(n, m): waves for n, m, waves in terms}
        for n, m, waves in scene.wavefront:
            total[n, m] = total.get((n, m), 0.0) + waves
        found = tuple((n, m, waves) for (n, m), waves in total.items())
        return replace(scene, wavefront=found, lenslet_diffraction=True)


def wavefront_rms(terms: Wavefront) -> tuple[float, float]:
    """Return the rms of a wavefront about its mean (waves), and that of its gradient (waves per pupil radius).

    ``terms`` contains Zernike terms ``(n, m, waves)``, as in `Zernike`.
    """
    nodes, weights = np.polynomial.legendre.leggauss(24)
    rho = (nodes + 1) / 2
    area = weights * rho  # sums to 1: the mean over the disc is twice the integral over rho d rho
    theta = 2 * math.pi * np.arange(128) / 128
    value, radial, turning = (np.zeros((24, 128)) for _ in range(3))
    for n, m, waves in terms:
        poly = _radial(n, abs(m))
        r, slope = poly(rho)[:, None], poly.deriv()(rho)[:, None]
        wave, turned = (np.cos, -np.sin(m * theta)) if m >= 0 else (np.sin, np.cos(m * theta))
        value += waves * r * wave(abs(m) * theta)
        radial += waves * slope * wave(abs(m) * theta)
        turning += waves * r / rho[:, None] * abs(m) * turned
    mean = float(area @ value.mean(1))
    variance = float(area @ (value**2).mean(1)) - mean**2
    return math.sqrt(max(0.0, variance)), math.sqrt(float(area @ (radial**2 + turning**2).mean(1)))


def _radial(n: int, m: int) -> np.polynomial.Polynomial:
    """Return the radial polynomial R_n^m (Born & Wolf 9.2.1, eq. 5)."""
    coefficients = np.zeros(n + 1)
    for k in range((n - m) // 2 + 1):
        down = math.factorial(k) * math.factorial((n + m) // 2 - k) * math.factorial((n - m) // 2 - k)
        coefficients[n - 2 * k] = (-1) ** k * math.factorial(n - k) / down
    return np.polynomial.Polynomial(coefficients)


EFFECTS = (Spherical, Coma, Zernike, FieldAberrations)
"""The effects that the catalogue uses from this module; the name is the same in every module of effects."""
