"""Numbers about one depth plane that are known before the simulation; all estimates use them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from lfcal.camera import Camera, Microscope, PupilLenslets
from lfcal.simulate._pupil_scene import PupilScene

__all__ = ["Outlook", "PupilOutlook", "share_moved", "share_widened"]


def share_moved(shift: float, width: float) -> float:
    """Return the relative L1 change if a Gaussian spot of rms width ``width`` moves by ``shift`` (same unit).

    It is 2 erf(shift / (2 sqrt(2) width)), which is 0.8 shift / width for small shifts.
    """
    return 2.0 * math.erf(abs(shift) / (2.0 * math.sqrt(2.0) * width))


def share_widened(width_a: float, width_b: float) -> float:
    """Return the relative L1 difference of two round Gaussian spots with rms widths ``width_a`` and ``width_b``.

    It is 2 (q^(q/(1-q)) - q^(1/(1-q))) with q = (a/b)², where a is the smaller and b the larger width. If they are
    nearly equal, this is 0.74 (b² - a²)/a².
    """
    small, large = sorted((width_a, width_b))
    q = (small / large) ** 2
    if 1.0 - q < 1e-6:
        return 2.0 / math.e * (1.0 - q)
    log = math.log(q) / (1.0 - q)
    return 2.0 * (math.exp(q * log) - math.exp(log))


@dataclass(frozen=True)
class Outlook:
    """A camera, a depth and a region: the common input for the estimates of all effects.

    Attributes
    ----------
    camera
        The camera.
    z_um
        Object depth (µm, relative to the working plane, positive away from the camera).
    cutout
        Shape ``(rows, columns)`` of the cutout that contains a response (px).
    period
        Number of source positions ``(rows, columns)`` in a period of the lattice.
    field_um
        Middle of the region on the sensor, ``(y, x)`` relative to the optical axis (µm).
    peak_e
        Signal of the brightest pixel of the session (electrons).
    exposure_s
        Exposure time (s).

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> print(f"v = {plane.virtual_depth:.1f}: a shadow of {plane.shadow_px:.0f} px over {plane.lenslets:.0f} lenslets")
    v = 4.0: a shadow of 63 px over 15 lenslets
    """

    camera: Camera
    z_um: float
    cutout: tuple[int, int]
    period: tuple[int, int]
    field_um: tuple[float, float] = (0.0, 0.0)
    peak_e: float = 16e3
    exposure_s: float = 0.05

    # -- optics ----------------------------------------------------------------------------------------
    @property
    def wavelength_um(self) -> float:
        """Design wavelength (µm)."""
        return self.camera.wavelength_um

    @property
    def pixel_um(self) -> float:
        """Pixel pitch (µm)."""
        return self.camera.sensor.pixel_um

    @property
    def gap_um(self) -> float:
        """Distance B from the lenslets to the sensor (µm)."""
        return self.camera.lattice.gap_um

    @property
    def clear_um(self) -> float:
        """Clear diameter d of a lenslet (µm)."""
        return self.camera.lattice.clear_diameter_um

    @property
    def f_number(self) -> float:
        """Working f-number Nw of the main lens or objective at the lenslets."""
        return self.camera.optics.working_f_number

    @cached_property
    def shift_um(self) -> float:
        """Distance a of the main lens's image behind the lenslets (µm), negative if it is in front of them.

        To avoid division by zero, |a| is at least the wavelength.
        """
        a = self.camera.image_shift_um(self.z_um)
        least = self.wavelength_um
        return a if abs(a) >= least else math.copysign(least, a)

    @property
    def virtual_depth(self) -> float:
        """Virtual depth v = a/B, the ratio of `shift_um` to `gap_um`."""
        return self.shift_um / self.gap_um

    @property
    def depth(self) -> float:
        """Ratio of a lateral shift of the main lens's image to the resulting shift on the sensor: |v|, at least 1.2.

        If |v| is smaller, the shift on the sensor depends on the size of the image instead of the lenslets.
        """
        return max(1.2, abs(self.virtual_depth))

    @property
    def regular(self) -> bool:
        """Whether the formulas are valid: the camera has a main lens, and its image is not near the array.

        This requires a virtual depth of at least 0.6 in magnitude, and a `fresnel_main` of at least 3.
        """
        return self.has_lens and abs(self.virtual_depth) >= 0.6 and self.fresnel_main >= 3.0

    @property
    def fresnel_main(self) -> float:
        """Fresnel number |a| / (4 Nw² lambda) of the main iris's shadow.

        Here a is `shift_um`, Nw is `f_number`, and lambda is `wavelength_um`.
        """
        return abs(self.shift_um) / (4.0 * self.f_number**2 * self.wavelength_um)

    @cached_property
    def defocus(self) -> tuple[float, ...]:
        """Signed ratio of blur radius to lenslet radius for each lens type: 1 - B/a - B/f, with the focal length f.

        B is `gap_um`, and a is `shift_um`.
        """
        gap = self.gap_um
        return tuple(1.0 - gap / self.shift_um - gap / t.focal_length_um for t in self.camera.lattice.types)

    # -- patterns, in pixels ---------------------------------------------------------------------------
    @property
    def shadow_px(self) -> float:
        """Radius of the light disc that the main iris forms on the lenslets for one point (px).

        It is the geometric radius and the Airy radius, added in quadrature. lfcal calls this disc the shadow of the
        iris.
        """
        airy = 1.22 * self.wavelength_um * self.f_number
        radius = abs(self.shift_um) / (2.0 * self.f_number)
        if isinstance(self.camera.optics, Microscope):
            radius /= math.cos(self.camera.optics.half_angle_rad)  # M |z| tan(alpha); the image side has sines
        return math.hypot(radius, airy) / self.pixel_um

    @property
    def lit_px(self) -> float:
        """Radius of the illuminated part of a lenslet (px): that of the lenslet, but at most `shadow_px`."""
        return min(0.5 * self.clear_um / self.pixel_um, self.shadow_px)

    @cached_property
    def lenslets(self) -> float:
        """Mean number of lenslets within the shadow of the main iris, at least 1."""
        cell = self.camera.pitch_px * self.camera.lattice.row_step_um / self.pixel_um
        return max(1.0, math.pi * self.shadow_px * self.shadow_px / cell)

    @property
    def pattern_px(self) -> float:
        """Radius of the light pattern on the sensor (px).

        It is `shadow_px` times |1 - 1/v|, with the virtual depth v, plus the largest spot radius and half a lenslet
        pitch.
        """
        shrunk = self.shadow_px * abs(1.0 - 1.0 / self.virtual_depth)
        return shrunk + max(self.geometric_px) + 0.5 * self.camera.pitch_px

    @property
    def geometric_px(self) -> tuple[float, ...]:
        """Radius of the geometric spot on the sensor for each lens type (px): `lit_px` times absolute `defocus`."""
        return tuple(abs(s) * self.lit_px for s in self.defocus)

    @property
    def airy_px(self) -> float:
        """Rms width of the Gaussian approximation to a lenslet's diffraction spot (px).

        It is 0.42 lambda B / d, with the wavelength lambda, the gap B and the illuminated diameter d of a lenslet.
        """
        return 0.42 * self.wavelength_um * self.gap_um / (2.0 * self.lit_px * self.pixel_um) / self.pixel_um

    @cached_property
    def widths_px(self) -> tuple[float, ...]:
        """Rms spot width w along an axis for each lens type (px): w² = (`geometric_px`/2)² + `airy_px`² + 1/12.

        The last term is the variance of a pixel.
        """
        return tuple(math.sqrt(r * r / 4.0 + self.airy_px**2 + 1.0 / 12.0) for r in self.geometric_px)

    @property
    def fresnel_lenslets(self) -> tuple[float, ...]:
        """Fresnel number |sigma| r²/(lambda B) of the spot of each lens type.

        Here sigma is `defocus`, r is `lit_px` converted to µm, lambda is `wavelength_um`, and B is `gap_um`.
        """
        unit = (self.lit_px * self.pixel_um) ** 2 / (self.wavelength_um * self.gap_um)
        return tuple(abs(s) * unit for s in self.defocus)

    @property
    def diffracted(self) -> float:
        """Relative L1 error of spots traced by rays instead of computed by waves.

        It is the mean of 0.65/(1 + N_F)^(1/3) over the lens types, with their Fresnel numbers N_F. In a microscope,
        rays are also paraxial: their shadow has the radius M z sin(alpha) instead of M z tan(alpha). Here M is the
        magnification, z the depth, and alpha the half angle in object space. The resulting error, 2 sin²(alpha), is
        added in quadrature.
        """
        change = sum(0.65 / math.cbrt(1.0 + n) for n in self.fresnel_lenslets) / len(self.defocus)
        if isinstance(self.camera.optics, Microscope):
            change = math.hypot(change, 2.0 * math.sin(self.camera.optics.half_angle_rad) ** 2)
        return min(2.0, change)

    def over_types(self, function: Callable[[float], float]) -> float:
        """Return the mean of ``function(width)`` over the lens types, where ``width`` is the rms spot width (px)."""
        return sum(function(w) for w in self.widths_px) / len(self.widths_px)

    @property
    def resolved(self) -> float:
        """Fraction (0 to 1) of the contrast of the fringes in a defocused spot that remains after pixel integration."""
        return 1.0 / (1.0 + (0.15 / self.airy_px) ** 2)

    @property
    def structure(self) -> tuple[float, ...]:
        """Ratio of spot width to fringe width for each lens type: 1 + 0.45 N_F `resolved`.

        N_F is the Fresnel number in `fresnel_lenslets`. If it is large, changes estimated with a Gaussian of the spot's
        width are too small by this factor.
        """
        return tuple(1.0 + 0.45 * self.resolved * n for n in self.fresnel_lenslets)

    def moved(self, shift_px: float) -> float:
        """Return the relative L1 change of the image if every spot moves by ``shift_px`` (px)."""
        changes = (share_moved(shift_px * k, w) for w, k in zip(self.widths_px, self.structure, strict=True))
        return sum(changes) / len(self.widths_px)

    def blurred(self, rms_px: float, floor_px: float = 0.0) -> float:
        """Return the relative L1 change of the image if every spot is blurred by ``rms_px`` (rms along each axis, px).

        ``floor_px`` is an rms width (px) that is added in quadrature to every spot width, because pixels do not resolve
        narrower spots.
        """
        total = 0.0
        near = abs(self.virtual_depth) < 1  # the fringes of the iris, where one lenslet receives them all
        native = (1.5 if self.has_lens else 4.0) * self.fresnel_main if near else 0.0
        for width, spot in zip(self.widths_px, self.fresnel_lenslets, strict=True):
            w, n = math.hypot(width, floor_px), max(self.resolved * spot, native)
            finer = 1.0 + 0.4 * n + 0.05 * n * n  # a blur depends on the curvature of the fringes
            total += min(2.0, finer * share_widened(w, math.hypot(w, rms_px)))
        return total / len(self.widths_px)

    def array_moved(self, shift_px: float) -> float:
        """Return the relative L1 change of the image if the lenslets move by ``shift_px`` (px) and the source does not.

        Spots move by the fraction 1 - 1/v of the shift, with the virtual depth v, and the lenslet apertures by the full
        shift. In a microscope, the light from neighbouring lenslets interferes. The period of the fringes is
        lambda B/p, with the wavelength lambda, the gap B and the lenslet pitch p. It is finer than a defocused spot.
        """
        shift = shift_px * math.hypot(0.5, 0.75 * (1.0 - 1.0 / self.virtual_depth))
        if self.has_lens:
            return self.moved(shift)
        fringe = 0.9 * self.wavelength_um * self.gap_um / (self.camera.lattice.pitch_um * self.pixel_um)
        return self.over_types(lambda w: share_moved(shift, min(w, fringe)))

    def shadow_moved(self, shift_px: float) -> float:
        """Return the relative L1 change of the image if the iris's shadow moves by ``shift_px`` (px).

        It is 1.27 ``shift_px``/`shadow_px`, but at most 2.
        """
        return min(2.0, 4.0 / math.pi * abs(shift_px) / self.shadow_px)

    def source_moved(self, shift_px: float) -> float:
        """Return the relative L1 change of the image if the source's paraxial image moves by ``shift_px`` (px).

        Spots move by ``shift_px``/`depth`, and the iris's shadow by ``shift_px``. Fringes follow neither exactly. The
        two contributions are therefore added in quadrature, with a measured factor of 0.85 for that of the spots. A
        shadow smaller than a lenslet contributes only where it crosses the border to the next lenslet.
        """
        spots = 0.85 * self.moved(shift_px / self.depth)
        within = min(1.0, 2.0 * self.shadow_px / self.camera.pitch_px)
        return min(2.0, math.hypot(spots, within * self.shadow_moved(shift_px)))

    @property
    def field_rms_px(self) -> float:
        """Rms distance of the illuminated lenslets from the middle of the region, over a period of positions (px)."""
        ny, nx = self.period
        return math.sqrt(self.shadow_px**2 / 2.0 + (ny * ny + nx * nx) / 12.0)

    # -- light -----------------------------------------------------------------------------------------
    @property
    def pixels(self) -> int:
        """Number of pixels of the cutout."""
        return self.cutout[0] * self.cutout[1]

    @cached_property
    def signal_e(self) -> float:
        """Total signal of a frame with one source position (electrons), if the sharpest spot peaks at `peak_e`."""
        return self.peak_e * 2.0 * math.pi * min(self.widths_px) ** 2 * self.lenslets

    @property
    def has_lens(self) -> bool:
        """Whether the camera has a photographic main lens rather than a microscope objective."""
        return not self.camera.optics.telecentric


@dataclass(frozen=True)
class PupilOutlook(Outlook):
    """Input for the estimates of a Fourier light-field microscope, whose lenslets image the source directly.

    No image is formed near the lenslets. The virtual depth, and those quantities of `Outlook` that depend on it and are
    not redefined here, therefore raise `lfcal.camera.NoLatticeError`.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import PupilOutlook
    >>> plane = PupilOutlook(preset("flfm_20x05"), 20.0, cutout=(901, 901), period=(1, 1))
    >>> print(f"{plane.lenslets:.0f} spots of {plane.widths_px[0]:.1f} px (rms)")
    7 spots of 2.2 px (rms)
    """

    @property
    def _lenslets(self) -> PupilLenslets:
        assert isinstance(self.camera.lattice, PupilLenslets)
        return self.camera.lattice

    @cached_property
    def scene(self) -> PupilScene:
        """Scene of the ideal camera, whose source position (0, 0) is on the optical axis."""
        optics, sensor = self.camera.optics, self.camera.sensor
        assert isinstance(optics, Microscope)
        return PupilScene(
            self.wavelength_um, sensor.pixel_um, self._lenslets, optics, self.z_um, self.cutout, self.period
        )

    @property
    def depth(self) -> float:
        """Ratio of a shift of the source's image to the resulting shift of the spots, always 1."""
        return 1.0

    @property
    def regular(self) -> bool:
        """True: the formulas are valid, because spots are separate at every depth."""
        return True

    @property
    def lenslets(self) -> float:
        """Number of lenslets, all of which are illuminated."""
        return float(len(self._lenslets.lens_centres_um))

    @cached_property
    def geometric_px(self) -> tuple[float, ...]:
        """Radius of the geometric spot of each lenslet (px)."""
        spread = self._lenslets.spread(self.scene.objective, self.z_um)
        bend = 1 - self.gap_um / self._lenslets.focal_um + spread
        return tuple((abs(bend) * self.clear_um / 2 / self.pixel_um).tolist())

    @property
    def airy_px(self) -> float:
        """Rms width of the Gaussian approximation to a lenslet's diffraction spot (px).

        It is 0.42 lambda B / d, with the wavelength lambda, the gap B and the clear diameter d of a lenslet.
        """
        return 0.42 * self.wavelength_um * self.gap_um / self.clear_um / self.pixel_um

    @property
    def fresnel_lenslets(self) -> tuple[float, ...]:
        """Fresnel number of the defocused spot of each lenslet, as in `Outlook` with r = `clear_um`/2."""
        unit = self.clear_um / 2 * self.pixel_um / (self.wavelength_um * self.gap_um)
        return tuple(radius * unit for radius in self.geometric_px)

    @property
    def pattern_px(self) -> float:
        """Radius (px) of a disc whose area is that of all spots, with two Airy radii added to the radius of each."""
        reach = (radius + 5.8 * self.airy_px for radius in self.geometric_px)
        return math.sqrt(sum(one * one for one in reach))

    def spread_px(self, step_um: float) -> float:
        """Return the mean absolute shift of the spots (px) if the source moves along the axis by ``step_um`` (µm)."""
        radii = [math.hypot(*one) for one in self._lenslets.lens_centres_um]
        share = abs(self._lenslets.spread(self.scene.objective, step_um))
        return share * sum(radii) / len(radii) / self.pixel_um

    def blurred(self, rms_px: float, floor_px: float = 0.0) -> float:
        """Return the relative L1 change of the image if every spot is blurred by ``rms_px`` (rms along each axis, px).

        ``floor_px`` is an rms width (px) that is added in quadrature to every spot width, because pixels do not resolve
        narrower spots.
        """
        total = 0.0
        for width, fringes in zip(self.widths_px, self.fresnel_lenslets, strict=True):
            w, n = math.hypot(width, floor_px), self.resolved * fringes
            finer = 1.3 + 2.6 * n + 0.35 * n * n  # rings of a coherent spot (measured, n up to 2)
            total += min(2.0, finer * share_widened(w, math.hypot(w, rms_px)))
        return total / len(self.widths_px)

    def source_moved(self, shift_px: float) -> float:
        """Return the relative L1 change if the source's image, and thus every spot, moves by ``shift_px`` (px)."""
        return self.moved(shift_px)

    def shadow_moved(self, shift_px: float) -> float:
        """Return 0, because the light of a point fills the lenslets, which are in the pupil."""
        del shift_px
        return 0.0
