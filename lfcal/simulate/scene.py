"""Description of one depth plane for an engine: all lengths, flags and windows, with pupil and specimen.

Coordinates
-----------
The sensor's origin is the chief ray of source position (0, 0), which is the centre of a pixel; x to the right, y
downwards (µm). The chief ray of position (iy, ix) is ``iy, ix`` pixels away. The exit pupil is a distance b in front
of the lenslet array (inf: telecentric). With s = 1 + B/b, a chief ray that meets the sensor at x_s met the array at
x_s / s, and Fresnel optics with finite b is exactly the telecentric one with

    B' = B/s,   pixel' = pixel/s,   1/a' = 1/a + 1/b

(the common spherical wave from the pupil only magnifies the sensor by s). Engines work in this reduced frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, array_words, check_choice, check_cutout, check_number, check_wavelength
from lfcal.camera import LensletLattice, Microscope

__all__ = [
    "LAWS",
    "Crossing",
    "Defects",
    "ImageMap",
    "PupilIris",
    "Scene",
    "Specimen",
    "Wavefront",
    "check_wavefront",
    "cone_radius_um",
    "pixel_response",
    "ray_heights",
    "seidel",
]

Wavefront = tuple[tuple[int, int, float], ...]
"""Zernike terms ``(n, m, waves)``."""


@dataclass(frozen=True, slots=True)
class PupilIris:
    """The main lens's iris, with lengths in units of f/(2 N) (focal length f, f-number N) and an area of pi.

    Attributes
    ----------
    blades
        Number of blades; 0 is a circle.
    curvature
        Ratio of apothem to blade radius: 0 for straight edges, 1 for a circle.
    rotation_rad
        Angle of the first vertex from +x towards +y (rad).
    stop
        Centre and radius ``(x, y, radius)`` of a second, circular stop that clips the pupil seen from off axis
        (mechanical vignetting), in the same units. The stop removes light, so that the remaining energy may be less
        than 1. None: no such stop.
    """

    blades: int = 0
    curvature: float = 0.0
    rotation_rad: float = 0.0
    stop: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check every value."""
        check_number("iris blades", self.blades, at_least=0, at_most=64, integer=True)
        if self.blades in (1, 2):
            check_number("iris blades", self.blades, at_least=3, remedy="use 0 for a circular iris")
        check_number("blade curvature", self.curvature, at_least=0, at_most=1)
        check_number("blade rotation (rad)", self.rotation_rad)
        if self.stop is not None:
            object.__setattr__(self, "stop", tuple(float(v) for v in self.stop))
            if len(self.stop) != 3:
                raise InputError.expected("second stop", "(x, y, radius)", self.stop, "give three numbers")
            for value in self.stop:
                check_number("second stop (pupil radii)", value)
            check_number("second stop's radius (pupil radii)", self.stop[2], above=0)

    @property
    def circular(self) -> bool:
        """Whether the iris is a circle and there is no second stop."""
        return (self.blades == 0 or self.curvature == 1) and self.stop is None


MAX_ORDER = 40
"""Largest order n of a Zernike term; above it, the coefficients of its polynomial cancel to rounding."""


def check_wavefront(terms: Iterable[tuple[int, int, float]]) -> None:
    """Raise `InputError` unless each term ``(n, m, waves)`` is a Zernike polynomial with a finite coefficient.

    The order n must be at most 40 (`MAX_ORDER`).
    """
    for n, m, waves in terms:
        check_number("wavefront coefficient (waves)", waves)
        check_number("order of a Zernike term", n, at_least=0, at_most=MAX_ORDER)
        # Zernike radial polynomials exist for these indices only
        if n != int(n) or m != int(m) or n < 0 or abs(m) > n or (n - abs(m)) % 2:
            raise InputError.expected(
                "Zernike term", "n >= |m| >= 0 with n - |m| even", f"n={n:g}, m={m:g}", "correct the indices"
            )


def seidel(*, spherical: float = 0.0, coma: float = 0.0, angle_rad: float = 0.0) -> Wavefront:
    """Return the Zernike terms of the Seidel aberrations W040 rho^4 + W131 rho^3 cos(theta - angle).

    The arguments ``spherical`` and ``coma`` are W040 and W131 in waves.

    rho^4 = (R40 + 3 R20 + 2 R00) / 6 and rho^3 = (R31 + 2 R11) / 3.
    """
    # Zernike terms are 1 at the rim (not orthonormal); piston and defocus of the expansion are kept, so that the
    # wavefront equals the Seidel term exactly
    terms: list[tuple[int, int, float]] = []
    if spherical:
        terms += [(4, 0, spherical / 6), (2, 0, spherical / 2), (0, 0, spherical / 3)]
    if coma:
        for m, part in ((1, math.cos(angle_rad)), (-1, math.sin(angle_rad))):
            terms += [(3, m, coma * part / 3), (1, m, coma * part * 2 / 3)]
    return tuple(terms)


def pixel_response(power: float, sine_y: ArrayLike, sine_x: ArrayLike) -> NDArray[np.float64]:
    """Return cos^``power`` of the angle between each ray and the sensor's normal, from the ray's direction sines.

    If ``power`` is above 0, the result is 0 where no ray has these sines.
    """
    square = np.square(sine_y) + np.square(sine_x)
    response: NDArray[np.float64] = np.clip(1.0 - square, 0.0, None) ** (power / 2)
    return response


F8 = NDArray[np.float64]
C16 = NDArray[np.complex128]

STEEPEST = 0.99
"""Sine in the specimen up to which rays are followed; above it, tangents diverge and carry little light."""
EDGE_RAYS = 64
"""Number of rays over the pupil among which the outermost on the array is searched for."""


class Crossing(NamedTuple):
    """Transmission of plane waves at different angles through an interface; all arrays have the same shape.

    Attributes
    ----------
    axial
        n2 cos t2, with the refractive index n2 of the specimen and the angle t2 in it; positive imaginary for total
        reflection.
    s, p
        Fresnel coefficients of s-polarised and p-polarised waves.
    """

    axial: C16
    s: C16
    p: C16


@dataclass(frozen=True, slots=True)
class Specimen:
    """Media between a microscope's source and its immersion medium.

    Attributes
    ----------
    index
        Refractive index of the specimen.
    depth_um
        Depth of the nominal focal plane below the interface (µm). A source at z has the depth ``depth_um + z``; a
        source with a negative depth is in the immersion medium.
    """

    index: float
    depth_um: float = 0.0

    def __post_init__(self) -> None:
        """Check every value."""
        check_number("index of the specimen", self.index, at_least=1, at_most=4)
        check_number("depth of the focal plane below the interface (µm)", self.depth_um, at_least=0)

    def source_um(self, z_um: float) -> float:
        """Return the depth below the interface (µm) of a source at ``z_um``; negative in front of the interface."""
        return self.depth_um + z_um

    def focus_um(self, z_um: float, medium_index: float) -> float:
        """Return the apparent z (µm) of a source at ``z_um``, seen from the immersion medium by paraxial rays.

        Like ``z_um``, it is relative to the nominal focal plane.
        """
        deep = self.source_um(z_um)
        return z_um if deep < 0 else medium_index * deep / self.index - self.depth_um

    def crossing(self, medium_index: float, theta: F8) -> Crossing:
        """Return the transmission of the interface at angles ``theta`` (rad) in the medium, per solid angle there.

        With the indices n1 (``medium_index``), n2 and the angles t (``theta``), t2 in medium and specimen, n2 sin t2 =
        n1 sin t: s = 2 n1 cos t / (n1 cos t + n2 cos t2), p = 2 n1 cos t / (n2 cos t + n1 cos t2). These are the
        coefficients of a wave from the medium. They equal those of a wave from the specimen times n1 cos t / (n2 cos
        t2). This factor converts plane waves of the specimen into amplitudes per solid angle of the medium
        (reciprocity).
        """
        n1, n2 = medium_index, self.index
        across, first = n1 * np.sin(theta), n1 * np.cos(theta)
        axial: C16 = np.sqrt(((n2 - across) * (n2 + across)).astype(np.complex128))
        return Crossing(axial, 2 * first / (first + axial), 2 * first / (n2 * np.cos(theta) + n1 * axial / n2))


def ray_heights(optics: Microscope, z_um: float, specimen: Specimen | None, theta: F8) -> F8:
    """Return the signed distances from the axis (µm) at which rays of a source at ``z_um`` on the axis meet the array.

    ``theta`` contains the signed angles t of the rays in the medium (rad). The distances are M z tan t, with the
    magnification M. Behind an interface, they are M (d tan t2 - D tan t). Here t2 is the angle in the specimen, d the
    depth of the source, and D the depth of the nominal focal plane. They are NaN for rays with total reflection.
    """
    if specimen is None or specimen.source_um(z_um) < 0:
        return optics.magnification * z_um * np.tan(theta)
    across = optics.medium_index / specimen.index * np.sin(theta)
    within = np.where(across < STEEPEST, across, np.nan)
    slope = within / np.sqrt(1 - within * within)
    heights: F8 = optics.magnification * (specimen.source_um(z_um) * slope - specimen.depth_um * np.tan(theta))
    return heights


def cone_radius_um(optics: Microscope, z_um: float, specimen: Specimen | None) -> float:
    """Return the radius of the disc on the array that the rays of a source at ``z_um`` illuminate (µm)."""
    if specimen is None:
        return optics.magnification * abs(z_um) * math.tan(optics.half_angle_rad)
    theta = optics.half_angle_rad * np.arange(1, EDGE_RAYS + 1) / EDGE_RAYS
    return float(np.nanmax(np.abs(ray_heights(optics, z_um, specimen, theta))))


TOUCHING = 1.001
"""Ratio of clear diameter to cell width up to which a lenslet counts as a disc: 1e-4 of its light is outside."""

LAWS = (-0.5, 1.5)
"""Smallest and largest lens law: 0 is the sine condition, 1 the tangent law."""


Defects = tuple[tuple[int, int, float], ...]
"""Lenslets that transmit less light: row and column of the lattice, and the fraction of light that passes."""

ImageMap = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Displacement of images, linear in their position (µm): for dy and dx, the constant and its growth with y and x."""


@dataclass(frozen=True, slots=True)
class Scene:
    """All inputs of an engine for one depth plane; lengths in µm.

    Attributes
    ----------
    wavelength_um, pixel_um
        Wavelength in air; pixel pitch.
    image_um
        Distance a of the source's image behind the lenslet array, signed; 0 is the native plane.
    lattice
        The lenslets on the array itself (not their micro-images), with focal lengths, clear diameter and gap B. Its
        offset is the centre of a type-0 lenslet relative to source position (0, 0).
    cutout, period
        Pixels (nt, ns) around each source position; number of source positions (ny, nx) of a full plane.
    f_number
        Working f-number Nw of the cone that reaches the array.
    iris
        Shape of the pupil.
    aperture
        Lenslet aperture: ``"circle"`` (clear diameter within the lenslet's cell, opaque gaps) or ``"cell"`` (fills the
        lattice).
    pupil_um
        Distance b of the exit pupil in front of the array; inf: telecentric.
    wavefront
        Aberration of the main lens as Zernike terms ``(n, m, waves)``: ``waves`` times R_n^|m|(rho) cos(m theta), or
        sin(|m| theta) for m < 0. R is 1 at the rim, rho = 1, of the disc f/(2N). Empty: none. See `seidel`.
    main_diffraction, lenslet_diffraction
        Whether the fringes of the iris are computed, and whether the diffraction of the lenslets is computed.
    exact_defocus
        Whether the main lens's defocus is a(1 - cos theta) instead of a theta^2 / 2.
    lens_law
        Parameter q of the law u/(2 Nw) = sin theta / (1 - q sin² theta)^½ for a ray from the relative height u in the
        pupil at the angle theta. It is 0 for the sine condition, and 1 for the tangent law. It needs exact angles; the
        pupil is uniformly lit.
    exact_rays
        Whether rays between lenslet and sensor follow tan theta instead of sin theta. The wave level follows them ray
        by ray, away from the native plane. Together with `exact_defocus`, which should have the same value, chief rays
        are straight. A microscope's field is always exact up to the array; of its levels, the grid and the reference
        follow these rays.
    pixel_fill
        Light-sensitive fraction of a pixel's side, in (0, 1].
    objective, z_um
        The microscope and its defocus in object space, for the Debye path; None for a main lens.
    pixel_aspect
        Ratio of a pixel's height to its width ``pixel_um``: not 1 if frames are resampled by unequal factors.
    vectorial
        Whether a microscope's source is a dipole of any orientation with its vector field, instead of a scalar point
        source.
    specimen
        Media between a microscope's source and its immersion medium. None: no specimen.
    offsets_um
        Displacement ``(ny, nx, 2)`` as (dy, dx) of each source position, on the sensor's scale (µm); the pixels do not
        move. None: no displacement.
    image_map
        Displacement of every image from its paraxial position, as a linear function of that position on the sensor,
        after offsets. It contains, for dy and for dx, the constant (µm) and the factors of y and x. None: no
        displacement.
    tilt
        Tilt (y, x) of the array: increase of the gap per µm along y and x. In the middle of the period, the gap is B.
    defects
        Lenslets with lower transmission: tuples of the row r and the column q in ``lattice``, and the fraction of light
        transmitted.
    lenslet_waves
        Spherical aberration W040 of the lenslets (waves), at the rim of the clear diameter.
    type_waves
        Additional aberration of each lens type (waves); empty: none.
    glass
        Thickness t (µm) and index n of a plate between lenslets and sensor, for its aberration at exact angles. The gap
        is the equivalent one in air, B - t (1 - 1/n).
    accept
        Power n of the pixels' response cos^n to the angle of light, 0 for none, and the slope (y, x) of the chief ray.
    colour_rate, dispersion_um2
        Imaging at another wavelength (see `lfcal.simulate.response.at_wavelength`): shift of the image per wavelength,
        and b in f / (1 + b (1/lambda² - 1/wavelength_um²)) of the lenslets.
    """

    wavelength_um: float
    pixel_um: float
    image_um: float
    lattice: LensletLattice
    cutout: tuple[int, int]
    period: tuple[int, int]
    f_number: float
    iris: PupilIris = field(default_factory=PupilIris)
    aperture: str = "circle"
    pupil_um: float = math.inf
    wavefront: Wavefront = ()
    main_diffraction: bool = True
    lenslet_diffraction: bool = True
    exact_defocus: bool = False
    exact_rays: bool = False
    pixel_fill: float = 1.0
    objective: Microscope | None = None
    z_um: float = 0.0
    pixel_aspect: float = 1.0
    vectorial: bool = False
    specimen: Specimen | None = None
    offsets_um: NDArray[np.float64] | None = field(default=None, compare=False)
    image_map: ImageMap | None = None
    tilt: tuple[float, float] = (0.0, 0.0)
    defects: Defects = ()
    lenslet_waves: float = 0.0
    type_waves: tuple[float, ...] = ()
    glass: tuple[float, float] = (0.0, 1.0)
    accept: tuple[float, float, float] = (0.0, 0.0, 0.0)
    colour_rate: float = 0.0
    dispersion_um2: float = 0.0
    lens_law: float = 0.0

    def __post_init__(self) -> None:
        """Check every value."""
        check_wavelength(self.wavelength_um)
        check_number("pixel pitch (µm)", self.pixel_um, above=0)
        check_number("ratio of a pixel's height to its width", self.pixel_aspect, at_least=0.25, at_most=4)
        check_number("image distance behind the array (µm)", self.image_um)
        check_number(
            "working f-number", self.f_number, at_least=0.5, remedy="choose f/0.5 or slower, the limit of a cone in air"
        )
        check_number("light-sensitive fraction of a pixel's side", self.pixel_fill, above=0, at_most=1)
        check_number("depth (µm)", self.z_um)
        check_number("lens law (0 sine, 1 tangent)", self.lens_law, at_least=LAWS[0], at_most=LAWS[1])
        check_choice("lenslet aperture", self.aperture, ("circle", "cell"))
        for name in ("cutout", "period"):
            object.__setattr__(self, name, tuple(int(n) for n in getattr(self, name)))
        check_cutout(*self.cutout)
        for n in self.period:
            check_number("period (positions)", n, at_least=1, integer=True)
        self._check_pupil()
        if self.type_waves and len(self.type_waves) != len(self.lattice.types):
            wanted, got = f"{len(self.lattice.types)} values, one for each lens type", len(self.type_waves)
            raise InputError.expected(
                "spherical aberrations of lenslets", wanted, got, "repeat the value if it is the same for all types"
            )
        check_wavefront(self.wavefront)
        object.__setattr__(self, "wavefront", tuple((int(n), int(m), float(w)) for n, m, w in self.wavefront))
        if self.offsets_um is not None:
            self._check_offsets(np.array(self.offsets_um, np.float64))

    def _check_pupil(self) -> None:
        b = self.pupil_um
        # 1 + a/b > 0: the image lies behind the pupil
        if not (b > 0 and 1.0 + self.image_um / b > 0):
            limit = f"above {max(0.0, -self.image_um):g} µm, or inf for a telecentric lens"
            raise InputError.expected("distance of the exit pupil (µm)", limit, b, "correct the pupil or the depth")

    def _check_offsets(self, offsets: NDArray[np.float64]) -> None:
        wanted = (*self.period, 2)
        if offsets.shape != wanted or not np.isfinite(offsets).all():
            raise InputError.expected(
                "source offsets",
                f"finite numbers of shape {wanted}",
                array_words(offsets),
                "give one offset (y, x) for each source",
            )
        # a scene is immutable, including its arrays
        offsets.flags.writeable = False
        object.__setattr__(self, "offsets_um", offsets)

    @property
    def row_um(self) -> float:
        """Height of a pixel (µm); ``pixel_um`` is its width."""
        return self.pixel_um * self.pixel_aspect

    # -- derived lengths of the reduced, telecentric frame ------------------------------------------------
    @property
    def scale(self) -> float:
        """Ratio s = 1 + B/b of the pitch of the micro-images to that of the lenslets, with B and b as in `Scene`."""
        return 1.0 + self.gap_um / self.pupil_um

    @property
    def gap_um(self) -> float:
        """Distance B from lenslets to sensor (µm)."""
        return self.lattice.gap_um

    @property
    def reduced_gap_um(self) -> float:
        """Gap in the reduced frame, B' = B/s (µm), with the `scale` s."""
        return self.gap_um / self.scale

    @property
    def reduced_pixel_um(self) -> float:
        """Pixel pitch in the reduced frame: the pitch divided by the `scale` s (µm)."""
        return self.pixel_um / self.scale

    @property
    def reduced_image_um(self) -> float:
        """Image distance in the reduced frame, a' = a / (1 + a/b) (µm), with a and b as in `Scene`; 0: native plane."""
        return self.image_um / (1.0 + self.image_um / self.pupil_um)

    @property
    def shadow_radius_um(self) -> float:
        """Radius of the disc that the cone of light illuminates on the array (µm).

        It is |a'| / (2 Nw), with the `reduced_image_um` a' and the f-number Nw. For a microscope, rays are traced.
        """
        if self.objective is not None:
            return cone_radius_um(self.objective, self.z_um, self.specimen)
        return abs(self.reduced_image_um) / (2 * self.f_number)

    @property
    def clear_radius_um(self) -> float:
        """Radius of a circular lenslet's clear aperture (µm)."""
        return self.lattice.clear_diameter_um / 2

    @property
    def gapless(self) -> bool:
        """Whether the lenslets fill their cells."""
        # without a clear diameter, "circle" means discs with the pitch as diameter, also in a square lattice
        return self.aperture == "cell" or (self.lattice.clear_um is not None and self.lattice.gapless)

    @property
    def round_lenslets(self) -> bool:
        """Whether a lenslet's aperture is a disc that does not extend beyond its cell."""
        return not self.gapless and self.lattice.clear_diameter_um <= TOUCHING * self.lattice.cell_um[0]

    @property
    def rim_f_number(self) -> float:
        """f-number 1/(2 sin theta) of the ray from the pupil's rim at the angle theta: Nw for the sine condition."""
        return math.sqrt(self.f_number**2 + self.lens_law / 4)

    @property
    def fresnel_number(self) -> float:
        """Fresnel number |a'| / (4 Nw^2 lambda) of the iris's shadow, with the `reduced_image_um` a'."""
        return abs(self.reduced_image_um) / (4 * self.f_number**2 * self.wavelength_um)

    @property
    def virtual_depth(self) -> float:
        """Virtual depth v = a/B: the image distance divided by the gap."""
        return self.image_um / self.gap_um

    @property
    def anchor_px(self) -> tuple[float, float]:
        """Point (y, x) on the sensor onto which source position (0, 0) is imaged.

        It is in pixels relative to the centre of a type-0 micro-image.
        """
        x, y = self.lattice.offset_um
        # the anchor is relative to a lenslet, the lattice's offset to the anchor: hence the sign
        return -y * self.scale / self.row_um, -x * self.scale / self.pixel_um

    @property
    def fill_factor(self) -> float:
        """Fraction of light that a uniformly lit array transmits."""
        if self.gapless:
            return 1.0
        return replace(self.lattice, clear_um=self.lattice.clear_diameter_um).fill_factor

    def quartic(self, kind: int) -> float:
        """Return the quartic phase coefficient of the spherical aberration of lenslets of type ``kind`` (rad/µm^4)."""
        waves = self.lenslet_waves + (self.type_waves[kind] if self.type_waves else 0.0)
        return 2 * math.pi * waves / self.clear_radius_um**4

    @property
    def lenslet_quartic(self) -> float:
        """The `quartic` of largest magnitude among the lens types, which determines the largest deflection of light."""
        return max((self.quartic(kind) for kind in range(len(self.lattice.types))), key=abs)

    def lens_curvature(self, kind: int) -> float:
        """Return the ratio B'/f of the `reduced_gap_um` to the focal length of lenslets of type ``kind``."""
        return self.reduced_gap_um / self.lattice.types[kind].focal_length_um

    def sigma(self, kind: int) -> float:
        """Return the signed ratio of spot size to lenslet size, 1 - B'/a' - B'/f; infinite at the native plane.

        ``kind`` is the lens type, B'/f is `lens_curvature`, and a' is `reduced_image_um`.
        """
        # with the image on the array, the whole cone falls on one lenslet, and sigma has a pole
        near = self.reduced_image_um
        return math.inf if near == 0 else 1.0 - self.reduced_gap_um / near - self.lens_curvature(kind)

    def nearest_pixel(self, y_um: float, x_um: float) -> tuple[int, int]:
        """Return the pixel (row, column) that contains the sensor point (``y_um``, ``x_um``), in µm.

        The pixel and the point are relative to source position (0, 0).
        """
        # floor(v + 0.5) instead of round(), so that halves are always rounded up
        return math.floor(y_um / self.row_um + 0.5), math.floor(x_um / self.pixel_um + 0.5)

    def source_um(self, y: int, x: int) -> tuple[float, float]:
        """Return the sensor point (y, x) (µm) that the chief ray of position (``y``, ``x``) meets.

        The point includes the offset of the position, which repeats with the period, and `image_map`.
        """
        dy, dx = (0.0, 0.0) if self.offsets_um is None else self.offsets_um[y % self.period[0], x % self.period[1]]
        return self.imaged_um(y * self.row_um + float(dy), x * self.pixel_um + float(dx))

    def imaged_um(self, y_um: float, x_um: float) -> tuple[float, float]:
        """Return the sensor point (y, x) (µm) to which `image_map` moves the paraxial point (``y_um``, ``x_um``)."""
        if self.image_map is None:
            return y_um, x_um
        dy, dx = (c + gy * y_um + gx * x_um for c, gy, gx in self.image_map)
        return y_um + dy, x_um + dx

    @property
    def farthest_um(self) -> float:
        """Upper limit of the distance on the sensor of a source's chief ray from the middle of its cutout (µm)."""
        far = 0.0 if self.offsets_um is None else float(np.hypot(*np.moveaxis(self.offsets_um, -1, 0)).max())
        if self.image_map is None:
            return far
        height, width = ((n - 1) * px for n, px in zip(self.period, (self.row_um, self.pixel_um), strict=True))
        corners = [(y, x) for y in (0.0, height) for x in (0.0, width)]
        # linear, so the maximum is at a corner
        return far + max(math.hypot(*np.subtract(self.imaged_um(*at), at)) for at in corners)

    def farther_at(self, y: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the increase of the array's distance from the sensor, due to the tilt, at points of the array (µm).

        ``y`` and ``x`` are the points' coordinates on the array (µm), relative to source position (0, 0).
        """
        sides = zip(self.period, (self.row_um, self.pixel_um), strict=True)
        middle_y, middle_x = ((n - 1) / 2 * px / self.scale for n, px in sides)
        farther: NDArray[np.float64] = self.tilt[0] * (y - middle_y) + self.tilt[1] * (x - middle_x)
        return farther

    def farther_um(self, centres_um: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the increase of distance (µm), as in `farther_at`, for lenslets at ``centres_um``.

        ``centres_um`` is ``(n, 2)`` as (x, y).
        """
        return self.farther_at(centres_um[:, 1], centres_um[:, 0])

    def passed(self, centres_um: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the fraction of light that each lenslet transmits: 1, except for those among `defects`.

        ``centres_um`` is ``(n, 2)`` as (x, y).
        """
        share = np.ones(len(centres_um))
        if self.defects and len(centres_um):
            index = np.rint(self.lattice.lenslet_at(centres_um))
            for row, column, passed in self.defects:
                share[(index == (column, row)).all(axis=1)] *= passed
        return share

    def tilted(self, centres_um: NDArray[np.float64], kinds: NDArray[np.intp]) -> tuple[NDArray[np.float64], ...]:
        """Return the changes, due to the tilt, of spot positions and of sigma for lenslets at ``centres_um``.

        ``centres_um`` is ``(n, 2)`` as (x, y), and ``kinds`` ``(n,)`` contains the lens types. The chief ray meets the
        sensor at X0. Let c be the centre of a lenslet that is farther from the sensor by d. A ray through c meets the
        sensor at c + (B' + d)/(a' + d) (X0 - c). The first result is the change of the factor of X0 - c. Sigma becomes
        1 - (B' + d)/(a' + d) - (B' + d)/f. Both changes, ``(n,)``, are of first order in d. They are 0 near the native
        plane, where the radius of the lit disc is less than half a pitch.
        """
        a, none = self.reduced_image_um, np.zeros(len(centres_um))
        # near the native plane, the lit lenslets are next to each other, and 1/a' has no meaning
        if self.tilt == (0.0, 0.0) or self.shadow_radius_um < 0.5 * self.lattice.pitch_um:
            return none, none
        moved = self.farther_um(centres_um) * (1 - self.reduced_gap_um / a) / a
        focal = np.array([kind.focal_length_um for kind in self.lattice.types])[kinds]
        return moved, -moved - self.farther_um(centres_um) / focal

    def refocused(self, by_um: float) -> Scene:
        """Return the scene with the source's image ``by_um`` farther behind the array.

        For a microscope, ``z_um`` changes accordingly.
        """
        optics = self.objective
        # a = -M² z / n
        deeper = 0.0 if optics is None else -by_um * optics.medium_index / optics.magnification**2
        return replace(self, image_um=self.image_um + by_um, z_um=self.z_um + deeper)
