"""Effects of the lenslets and of the main iris: lens types, diffraction, the iris's shape."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import ClassVar

from lfcal.base import check_number
from lfcal.camera import Camera
from lfcal.simulate.effects.base import EngineSeconds, Estimate, SceneEffect
from lfcal.simulate.effects.outlook import Outlook, share_widened
from lfcal.simulate.scene import LAWS, PupilIris, Scene

__all__ = ["ExactAngles", "IrisDiffraction", "IrisShape", "LensLaw", "LensTypeDefocus", "LensletDiffraction"]


INSEPARABLE = 8.0
"""Fresnel number of the shadow below which it is computed with its fringes or not at all, whatever the angles."""

OF_RIM, SMALL = 0.2, 0.01
"""Fraction of light moved per pixel of displacement of a microscope's steepest ray behind the lenslets, an upper
estimate (measured: 0.06 to 0.26), and the limit of its use. Running the effect takes longer than most simulations."""

FRINGED, SHOWN = 20.0, 0.5
"""Fresnel number of the iris, and rms width of spots (px), below which a shift does not describe exact angles."""


@dataclass(frozen=True, slots=True)
class LensTypeDefocus(SceneEffect):
    """Defocus of each lens type; without this effect, all lenslets have the type that is sharpest at the depth.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import LensTypeDefocus, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = LensTypeDefocus().estimate(plane)
    >>> print(f"largest spot {found.size:.2f} {found.unit}")  # 31 px |1/2 - 1/4|
    largest spot 7.75 px
    """

    name: ClassVar[str] = "lens_types"
    title: ClassVar[str] = "lens types and defocus"
    rank: ClassVar[int] = 10

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the diameter of the largest spot (px), and the relative error if all types were as sharp as the best.

        With increasing Fresnel number, spots change from Gaussians to uniform discs. The relative L1 difference of two
        concentric discs of equal energy is twice the fraction of the larger disc's energy outside the smaller one.
        """
        sharp = min(outlook.widths_px)
        error = 0.0
        for width, n in zip(outlook.widths_px, outlook.fresnel_lenslets, strict=True):
            gauss, disc = share_widened(sharp, width), 2.0 * (1.0 - (sharp / width) ** 2)
            error += gauss + (disc - gauss) * n / (n + 4.0)
        error /= len(outlook.widths_px)
        return Estimate(2 * max(outlook.geometric_px), "px", error, "d |1/vf - 1/v|; mean width change over the types")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with all lens types of the camera of ``outlook``."""
        return replace(scene, lattice=replace(scene.lattice, types=outlook.camera.lattice.types))


@dataclass(frozen=True, slots=True)
class LensletDiffraction(SceneEffect):
    """Diffraction by the lenslets; without this effect, rays are traced.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import LensletDiffraction, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = LensletDiffraction().estimate(plane)
    >>> print(f"Airy radius {found.size:.2f} {found.unit}; rays alone miss {found.error:.0%} of the image")
    Airy radius 0.62 px; rays alone miss 47% of the image
    """

    name: ClassVar[str] = "lenslet_diffraction"
    title: ClassVar[str] = "lenslet diffraction"
    rank: ClassVar[int] = 20
    needs_waves: ClassVar[bool] = True

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the radius of the Airy disc (px), and the relative error `Outlook.diffracted`."""
        airy = 1.22 * outlook.wavelength_um * outlook.gap_um / (2 * outlook.lit_px * outlook.pixel_um**2)
        return Estimate(airy, "px", outlook.diffracted, "1.22 lambda B/d; 0.65/(1 + N_F)^(1/3) per type")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with lenslet diffraction switched on."""
        del outlook
        return replace(scene, lenslet_diffraction=True)

    def seconds(self, outlook: Outlook, engine: EngineSeconds) -> float:
        """Return the additional CPU time of wave optics compared with ray tracing (s)."""
        del outlook
        return max(0.0, engine.waves - engine.rays)


@dataclass(frozen=True, slots=True)
class IrisDiffraction(SceneEffect):
    """Fresnel fringes of the main iris on the lenslets; without this effect, the iris casts a sharp shadow.

    Fringes and shadow cannot be computed separately in the Debye integral of a microscope, or within the depth of
    focus. Within the depth of focus, the Fresnel number of the shadow is below 12, or below 8 with `ExactAngles`. In
    these cases, lenslet diffraction always includes the fringes, even if this effect is off.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import IrisDiffraction, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = IrisDiffraction().estimate(plane)
    >>> print(f"{found.unit} = {found.size:.1f}: {found.error:.1%} of the image")
    N_F = 63.4: 7.5% of the image
    """

    name: ClassVar[str] = "iris_diffraction"
    title: ClassVar[str] = "main-iris diffraction"
    rank: ClassVar[int] = 30

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the Fresnel number N_F of the iris's shadow, and the relative error 0.6 / sqrt(N_F), at most 1.5.

        The error is 0 for a microscope, and for N_F below 8 at any distance of the pupil, because the fringes are
        included there.
        """
        number = outlook.fresnel_main
        if not outlook.has_lens:
            return Estimate(number, "N_F", 0.0, "in the Debye integral")
        # a pupil at its actual distance b turns a into a/(1 + a/b), which may exceed the limit (see `Telecentricity`)
        of_pupil = abs(1 + outlook.shift_um / outlook.camera.optics.image_distance_um)
        if number < INSEPARABLE * min(1.0, of_pupil):
            return Estimate(number, "N_F", 0.0, "one with the shadow at this depth")
        return Estimate(number, "N_F", min(1.5, 0.6 / math.sqrt(number)), "|a|/(4 Nw² lambda); 0.6/N_F^(1/2)")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with diffraction by the main iris switched on."""
        del outlook
        return replace(scene, main_diffraction=True)


@dataclass(frozen=True, slots=True)
class IrisShape(SceneEffect):
    """Polygonal shape of an iris with straight or curved blades; without this effect, it is a circle of the same area.

    Attributes
    ----------
    blades, curvature, rotation_rad
        Number of blades (0: circular iris), their curvature (0: straight, 1: circular) and the rotation of the iris
        (rad), as in `MainLens`. None: the camera's value; for a microscope, a circle.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import IrisShape, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> print(*(f"{IrisShape(blades).estimate(plane).error:.1%}" for blades in (5, 9, 0)))  # 0: a circle
    15.8% 4.9% 0.0%
    """

    blades: int | None = None
    curvature: float | None = None
    rotation_rad: float | None = None

    name: ClassVar[str] = "iris_shape"
    changes_work: ClassVar[bool] = True
    units: ClassVar[Mapping[str, str]] = {"blades": "", "curvature": ""}
    titles: ClassVar[Mapping[str, str]] = {"curvature": "curvature of blades", "rotation_rad": "turn of blades"}
    described: ClassVar[Mapping[str, str]] = {
        "blades": "optics.blades",
        "curvature": "optics.blade_curvature",
        "rotation_rad": "optics.blade_rotation_rad",
    }
    # a microscope's pupil is round unless blades are given.
    typical_sizes: ClassVar[Mapping[str, tuple[float, float]]] = {
        "blades": (0, 0),
        "curvature": (0.0, 0.0),
        "rotation_rad": (0.0, 0.0),
    }
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"blades": (0, 64), "curvature": (0.0, 1.0)}
    title: ClassVar[str] = "iris blades"
    rank: ClassVar[int] = 40

    def __post_init__(self) -> None:
        """Check every value, and that the blades enclose an area."""
        SceneEffect.__post_init__(self)  # a plain super() does not know a class with slots
        if self.blades is not None:
            check_number(f"{self.title}: blades", self.blades, at_least=0, integer=True)
            if self.blades in (1, 2):
                check_number(f"{self.title}: blades", self.blades, at_least=3, remedy="use 0 for a circular iris")

    def iris(self, camera: Camera) -> PupilIris:
        """Return the iris of ``camera``, in which the values given to this effect replace those of the camera."""
        blades, curvature, rotation = (self.magnitude(f.name, camera) for f in fields(self))
        return PupilIris(int(blades), float(curvature), float(rotation))

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the number of blades, and the relative error due to the difference between the iris and a circle.

        A regular polygon with n sides and the circle of the same area differ by 0.257 (pi/n)² of their area. The error
        is 0.4 (pi/n)², because of diffraction at the edges. For curved blades, it is proportional to 1 - curvature.
        """
        iris = self.iris(outlook.camera)
        if iris.circular:
            return Estimate(0.0, "blades", 0.0, "circular iris")
        error = 0.4 * (math.pi / iris.blades) ** 2 * (1.0 - iris.curvature)
        return Estimate(float(iris.blades), "blades", error, "0.4 (pi/n)² (1 - curvature)")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with this iris; a second stop of ``scene`` is kept."""
        # mechanical vignetting may have been applied before
        return replace(scene, iris=replace(self.iris(outlook.camera), stop=scene.iris.stop))


@dataclass(frozen=True, slots=True)
class ExactAngles(SceneEffect):
    """Non-paraxial angles: defocus of the main lens as a (1 - cos theta), and rays behind the lenslets along tan theta.

    Here a is the distance of the main lens's image behind the array, and theta the angle to the axis. Each of the two
    changes alone would displace the rays through the lenslet centres. The displacement at the rim of the pupil is
    B/(2 (2 Nw)³), with the gap B and the working f-number Nw. With both, these rays meet the sensor at their paraxial
    positions, because their path to the image is a straight line. Two effects remain: the coma of lenslets with a
    parabolic phase, and a shadow that is larger by the fraction 1/(8 Nw²).

    The Debye integral of a microscope is always exact up to the array. With this effect, the angles behind the array
    are exact too. Each response of a microscope is then computed on one two-dimensional grid instead of separately for
    rows and columns.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import ExactAngles, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = ExactAngles().estimate(plane)
    >>> print(f"{found.size:.3f} {found.unit} at the rim of f/{plane.f_number:.0f}")
    0.079 px at the rim of f/5
    """

    name: ClassVar[str] = "exact_angles"
    title: ClassVar[str] = "non-paraxial angles"
    rank: ClassVar[int] = 60
    changes_work: ClassVar[bool] = True

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the displacement of the marginal ray (px), and the relative error due to the mean displacement.

        For a microscope, it is the displacement of the steepest ray behind the lenslets, with an upper bound of the
        error.
        """
        if not outlook.has_lens:
            return self._behind_lenslets(outlook)
        rim = outlook.gap_um / (2 * (2 * outlook.f_number) ** 3) / outlook.pixel_um
        near = min(1.0, abs(outlook.virtual_depth) / 1.2)  # the cone covers less than one lenslet
        share = 0.56 if outlook.shift_um > 0 else 0.65  # in front of the array, rays diverge
        return Estimate(rim, "px", outlook.moved(share * rim * near), "B/(2 (2 Nw)³); a shift of 0.56 to 0.65 of it")

    @staticmethod
    def _behind_lenslets(outlook: Outlook) -> Estimate:
        """Return the displacement of a microscope's steepest ray, B s³/2, s by the cone and the edge of a lenslet."""
        focal = min(abs(kind.focal_length_um) for kind in outlook.camera.lattice.types)
        steepest = min(1.0, 1 / (2 * outlook.f_number) + 0.5 * outlook.clear_um / focal)
        rim = outlook.gap_um * steepest**3 / 2 / outlook.pixel_um
        return Estimate(
            rim, "px", min(2.0, OF_RIM * rim), "B s³/2, s of cone and lenslet; an upper bound found by simulation"
        )

    def holds(self, outlook: Outlook) -> bool:
        """Return whether the formula is valid: the image is away from the array, and the spots are wide enough.

        The virtual depth must be at least 1.2 in magnitude, the Fresnel number of the iris's shadow at least 20, and
        the mean rms width of the spots at least 0.5 px. For a microscope, only the estimated error must be below 0.01.
        """
        if not outlook.has_lens:
            return self._behind_lenslets(outlook).error < SMALL
        width = sum(outlook.widths_px) / len(outlook.widths_px)
        spread = abs(outlook.virtual_depth) >= 1.2 and outlook.fresnel_main >= FRINGED and width >= SHOWN
        return outlook.regular and spread

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with exact rays and exact defocus; a microscope's Debye integral already has the latter."""
        if outlook.has_lens:
            return replace(scene, exact_defocus=True, exact_rays=True)
        return replace(scene, exact_rays=True)

    def seconds(self, outlook: Outlook, engine: EngineSeconds) -> float:
        """Return the CPU time of one additional phase per response (s), a tenth of that of the wave engine (measured).

        For a microscope with unrotated, contiguous square lenslets, it is the additional time of a two-dimensional grid
        compared with separate rows and columns. Other arrays of a microscope use such a grid in any case.
        """
        if outlook.has_lens:
            return 0.1 * engine.waves
        lattice = outlook.camera.lattice
        return 4.0 * engine.waves if lattice.edge_to_edge and lattice.rotation_rad == 0 else 0.0


@dataclass(frozen=True, slots=True)
class LensLaw(SceneEffect):
    """Departure of the main lens from the sine condition, for non-paraxial angles.

    Without this effect, rays reach the array as in a lens free of coma. A ray from the height u in the pupil (1 at the
    rim) then has the angle theta to the axis, with sin theta = u/(2 Nw). Nw is the working f-number. In a thin lens
    with a stop of diameter f/N, tan theta = u/(2 Nw). Compared with the sine condition, this has nearly the same effect
    as an iris that is smaller by the fraction 1/(8 Nw²). A microscope objective obeys the sine condition.

    Attributes
    ----------
    tangent
        Parameter q in sin theta = x / (1 + q x²)^½ with x = u/(2 Nw): 0 for the sine condition, 1 for the tangent law.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import LensLaw, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> print(f"{LensLaw().estimate(plane).error:.1%} of the image at f/{plane.f_number:.0f}")
    2.0% of the image at f/5
    """

    tangent: float = 1.0

    name: ClassVar[str] = "lens_law"
    changes_work: ClassVar[bool] = True
    units: ClassVar[Mapping[str, str]] = {"tangent": ""}
    titles: ClassVar[Mapping[str, str]] = {"tangent": "0 sine condition, 1 tangent law"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"tangent": LAWS}
    title: ClassVar[str] = "lens law of the main lens"
    rank: ClassVar[int] = 61
    deviation: ClassVar[bool] = True
    needs_waves: ClassVar[bool] = True

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the magnitude of the relative change of the marginal ray's sine, and the relative error.

        The error is due to the changed size of the iris's shadow. For a microscope, both results are 0.
        """
        if not outlook.has_lens:
            return Estimate(0.0, "of the rim's sine", 0.0, "an objective obeys the sine condition")
        square = abs(self.tangent) / (2 * outlook.f_number) ** 2
        return Estimate(0.5 * square, "of the rim's sine", 2 * square, "q/(8 Nw²) at the rim; q/(2 Nw²) of the light")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with this law, non-paraxial angles and lenslet diffraction; unchanged for a microscope."""
        if not outlook.has_lens or self.tangent == 0:
            return scene
        return replace(scene, lens_law=self.tangent, exact_defocus=True, exact_rays=True, lenslet_diffraction=True)


EFFECTS = (LensTypeDefocus, LensletDiffraction, IrisDiffraction, IrisShape, ExactAngles, LensLaw)
