"""Effects that depend on the wavelength; monochromatic light does not show them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from lfcal.base import InputError
from lfcal.simulate.effects.base import EngineSeconds, Estimate, SceneEffect
from lfcal.simulate.effects.image import refocus_px
from lfcal.simulate.effects.light import Bandwidth
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.scene import Scene

__all__ = ["ChromaticFocus", "LensletDispersion"]

LINE_F, LINE_D, LINE_C = 0.4861, 0.5876, 0.6563
"""Wavelengths by which glass is described (µm)."""


class _Chromatic(SceneEffect):
    """Base of chromatic effects: the spectrum's width, and a run of the engine for each wavelength."""

    __slots__ = ()
    width_um: float | None
    deviation: ClassVar[bool] = True
    by_wavelength: ClassVar[bool] = True
    described: ClassVar[Mapping[str, str]] = {"width_um": "bandwidth_um"}

    def spectrum_um(self) -> float | None:
        """Return the spectrum's full width, if it is stated (µm)."""
        return self.width_um

    def width(self, outlook: Outlook) -> float:
        """Return the spectrum's full width (µm)."""
        return outlook.camera.bandwidth_um if self.width_um is None else self.width_um

    def seconds(self, outlook: Outlook, engine: EngineSeconds) -> float:
        """Return the computing time of the engine for further wavelengths (s)."""
        least = self.wavelengths(outlook)
        runs = Bandwidth(self.width(outlook)).count(outlook, least) if least > 1 else 1
        return engine.waves * (runs - 1)


def _wavelengths(reach_px: float, outlook: Outlook) -> int:
    """Return the number of wavelengths for an even blur of spots that move by up to ``reach_px`` in each direction."""
    return 1 if reach_px == 0 else min(25, 3 + math.ceil(1.5 * reach_px / min(outlook.widths_px)))


def _fringes(rms_px: float, outlook: Outlook) -> float:
    """Return the fraction of light that moves within spots whose fringes move by s = ``rms_px``: 0.09 (s/w)^1.5.

    Here w is the rms width of a sharp spot. The formula was fitted to measurements, for sharp and for wide spots.
    """
    airy = 0.42 * outlook.wavelength_um * outlook.gap_um / outlook.clear_um / outlook.pixel_um
    return min(1.0, 0.09 * math.pow(rms_px / math.hypot(airy, math.sqrt(1 / 12)), 1.5))


@dataclass(frozen=True, slots=True)
class ChromaticFocus(_Chromatic):
    """Longitudinal chromatic aberration of the main lens: each wavelength is imaged at a different distance.

    Attributes
    ----------
    rate
        Shift of the image away from the main lens per change of the wavelength (µm/µm). The shift is zero at the design
        wavelength.
    width_um
        Full width of the spectrum (µm). None: that of the camera.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import ChromaticFocus, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> ChromaticFocus(rate=500.0, width_um=0.1).estimate(plane).size  # µm between both ends of the spectrum
    50.0
    """

    rate: float = 500.0
    width_um: float | None = None

    name: ClassVar[str] = "chromatic_focus"
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"width_um": (0.0, math.inf)}
    units: ClassVar[Mapping[str, str]] = {"rate": "µm/µm"}
    title: ClassVar[str] = "longitudinal colour"
    rank: ClassVar[int] = 75

    def wavelengths(self, outlook: Outlook) -> int:
        """Return the number of wavelengths needed to sample the chromatic blur of the spots."""
        return _wavelengths(refocus_px(outlook, self.rate * self.width(outlook) / 2), outlook)

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the shift of the image over the full spectrum (µm), and the relative error due to the blur."""
        shift = abs(self.rate) * self.width(outlook)
        # along an axis, the rms of the pupil's coordinate is half a radius
        rms = refocus_px(outlook, shift / math.sqrt(12)) / 2
        error = max(outlook.blurred(rms), _fringes(1.2 * rms, outlook))
        return Estimate(shift, "µm", error, "da = rate dl; blur s = da/sqrt(12)/(4 Nw v), or 0.09 (1.2 s/w)^1.5")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with an image distance that depends on the wavelength.

        Raise `InputError` if the image would be in front of the main lens at one end of the spectrum.
        """
        shift = self.rate * self.width(outlook)
        if not shift:
            return scene
        for end in (-shift / 2, shift / 2):
            if not 1.0 + (scene.image_um + end) / scene.pupil_um > 0:
                wanted = "an image behind the main lens over the whole spectrum"
                raise InputError.expected(
                    self.title, wanted, f"an image in front of it, shifted by {shift:.4g} µm", "reduce the rate"
                )
        return replace(scene, colour_rate=scene.colour_rate + self.rate)


@dataclass(frozen=True, slots=True)
class LensletDispersion(_Chromatic):
    """Dispersion of the lenslets' glass: their focal lengths are as described only at the design wavelength.

    The power 1/f of a lenslet is proportional to n - 1, where the refractive index n follows Cauchy's formula A +
    B/lambda², fitted to the Abbe number. The value of n itself cancels.

    Attributes
    ----------
    abbe
        Abbe number of the glass, (n_d - 1)/(n_F - n_C).
    width_um
        Full width of the spectrum (µm). None: that of the camera.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import LensletDispersion, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = LensletDispersion(abbe=55.0, width_um=0.1).estimate(plane)
    >>> print(f"{found.size:.2%} {found.unit} over 0.1 µm of the spectrum")
    1.14% of f over 0.1 µm of the spectrum
    """

    abbe: float = 55.0
    width_um: float | None = None

    name: ClassVar[str] = "lenslet_dispersion"
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"abbe": (5.0, math.inf), "width_um": (0.0, math.inf)}
    units: ClassVar[Mapping[str, str]] = {"abbe": ""}
    title: ClassVar[str] = "lenslets' dispersion"
    rank: ClassVar[int] = 76

    def strength(self, wavelength_um: float) -> float:
        """Return b (µm²) in f(lambda) = f_0 / (1 + b (1/lambda² - 1/lambda_0²)).

        lambda_0 is ``wavelength_um``, and f_0 the focal length at this wavelength.
        """
        # for a glass whose power is 1 at the d line
        b = 1.0 / (self.abbe * (LINE_F**-2 - LINE_C**-2))
        return b / (1.0 + b * (wavelength_um**-2 - LINE_D**-2))

    def _share(self, outlook: Outlook) -> float:
        """Return the relative change of the focal length over the spectrum."""
        lam = outlook.wavelength_um
        return 2 * self.strength(lam) / lam**3 * self.width(outlook)

    def wavelengths(self, outlook: Outlook) -> int:
        """Return the number of wavelengths needed to sample the chromatic blur of the spots."""
        steep = max(outlook.gap_um / kind.focal_length_um for kind in outlook.camera.lattice.types)
        return _wavelengths(outlook.lit_px * steep * self._share(outlook) / 2, outlook)

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the relative change of the focal length over the spectrum, and the relative error due to the blur."""
        share, radius = self._share(outlook), 0.5 * outlook.clear_um / outlook.pixel_um
        steep = outlook.gap_um / outlook.camera.lattice.types[0].focal_length_um
        error = 1.5 * _fringes(radius * steep * share / math.sqrt(12), outlook)
        return Estimate(share, "of f", error, "df/f = 2 b dl/l³; 0.14 (s/w)^1.5, s = R B/f df/f/sqrt(12)")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with lenslets whose power depends on the wavelength."""
        if not self.width(outlook):
            return scene
        return replace(scene, dispersion_um2=scene.dispersion_um2 + self.strength(scene.wavelength_um))


EFFECTS = (ChromaticFocus, LensletDispersion)
