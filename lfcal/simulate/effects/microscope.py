"""Effects of a microscope's objective and specimen: vector fields, and a mismatch of the refractive index."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from lfcal.camera import Microscope
from lfcal.simulate.effects.base import EngineSeconds, Estimate, SceneEffect
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.scene import Scene, Specimen, ray_heights

__all__ = ["IndexMismatch", "VectorialPupil"]

RAYS = 4000
"""Number of rays over the pupil with which the index mismatch is estimated."""


@dataclass(frozen=True, slots=True)
class VectorialPupil(SceneEffect):
    """Vectorial light from a dipole source with random orientation; without this effect, source and light are scalar.

    Averaged over dipole orientations, a bead or dye sends the same light through each part of the pupil as a scalar
    point source. However, the parts interfere differently: the intensities of five mutually incoherent fields add,
    while a scalar point source has a single field.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Outlook, VectorialPupil
    >>> plane = Outlook(preset("lfm_60x12"), 0.0, cutout=(127, 127), period=(15, 15))
    >>> found = VectorialPupil().estimate(plane)
    >>> print(f"at NA 1.2 {found.size:.0%} {found.unit} in other fields than the first")
    at NA 1.2 25% of the light in other fields than the first
    """

    name: ClassVar[str] = "vectorial"
    title: ClassVar[str] = "light as a vector field"
    rank: ClassVar[int] = 62
    changes_work: ClassVar[bool] = True
    needs_waves: ClassVar[bool] = True

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the fraction of light outside the strongest of the five fields, and the relative error.

        The formula for the error was fitted to simulations. In focus, the error grows with sin²(alpha), and with the
        ratio of the focal spot to the lenslets. Here alpha is the half angle of the objective. The error is
        smaller if pixels are wider than the interference fringes between lenslets. It decreases with defocus, because
        only light from neighbouring parts of the pupil then overlaps on the sensor. For images behind the array, light
        from other parts also overlaps, where micro-images do. With a main lens, both results are 0.
        """
        optics, lattice = outlook.camera.optics, outlook.camera.lattice
        if not isinstance(optics, Microscope):
            return Estimate(0.0, "of the light", 0.0, "cones of f/2 and slower: fields keep their direction to 1e-3")
        sine2 = (optics.numerical_aperture / optics.medium_index) ** 2
        cosine = math.sqrt(1 - sine2)
        # a0² = (1 + cos)²/4, averaged over solid angle; 1 minus that without cancellation
        less = sine2 / (1 + cosine)
        share = less / 2 - less * less / 12
        focus = math.sqrt(0.61 * outlook.wavelength_um * outlook.f_number * 2 / lattice.pitch_um)
        fringes = lattice.pitch_um * outlook.pixel_um / (outlook.wavelength_um * outlook.gap_um)
        waves = abs(outlook.z_um) * optics.medium_index * less / outlook.wavelength_um
        apart = (1 + (3.5 * waves) ** 2) ** -0.38
        v = outlook.virtual_depth
        overlap = 1.25 * math.exp(-((v / 1.2) ** 2)) if v > 0 and outlook.z_um < 0 else 0.0
        met = math.sqrt(apart**2 + overlap**2 * (1 - apart**2))
        error = 0.36 * sine2 * (1 + 0.17 * sine2**2) * focus * met / math.hypot(1.0, fringes)
        formula = "0.36 sin²(alpha) (focus/pitch)^½ (1 + (3.5 N)²)^-0.38/(1 + (px p/(lambda B))²)^½"
        return Estimate(share, "of the light", min(2.0, error), formula)

    def holds(self, outlook: Outlook) -> bool:
        """Return True: the formula was fitted to microscopes of all apertures, in focus and out of focus."""
        del outlook
        return True

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with a vector field, and lenslet diffraction switched on; unchanged for a main lens."""
        del outlook
        return scene if scene.objective is None else replace(scene, vectorial=True, lenslet_diffraction=True)

    def seconds(self, outlook: Outlook, engine: EngineSeconds) -> float:
        """Return the CPU time of four additional fields (s); 0 for a main lens.

        Contiguous square lenslets that are aligned with the pixel rows need half of this time.
        """
        if not outlook.camera.optics.telecentric:
            return 0.0
        lattice = outlook.camera.lattice
        shared = lattice.kind == "square" and lattice.edge_to_edge and lattice.rotation_rad == 0
        return (2.0 if shared else 4.0) * engine.waves


@dataclass(frozen=True, slots=True)
class IndexMismatch(SceneEffect):
    """Index mismatch between specimen and immersion medium: focal shift, spherical aberration, reflection loss.

    Attributes
    ----------
    index
        Refractive index of the specimen.
    depth_um
        Depth of the nominal focal plane below the interface (µm). The nominal plane is where the focus would be without
        the specimen. A plane at z is at the depth ``depth_um + z``. At a negative depth, the plane is in the immersion
        medium.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import IndexMismatch, Outlook
    >>> plane = Outlook(preset("lfm_20x05"), 20.0, cutout=(127, 127), period=(15, 15))
    >>> round(IndexMismatch(1.33, depth_um=20.0).estimate(plane).size, 2)  # 40/1.33 - 40 µm
    -9.92
    """

    index: float = 1.33
    depth_um: float = 20.0

    name: ClassVar[str] = "index_mismatch"
    title: ClassVar[str] = "specimen of another index"
    rank: ClassVar[int] = 68
    deviation: ClassVar[bool] = True
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"index": (1.0, 4.0), "depth_um": (0.0, math.inf)}
    units: ClassVar[Mapping[str, str]] = {"index": ""}

    def specimen(self) -> Specimen:
        """Return the `index` and `depth_um` as the `Specimen` of a scene."""
        return Specimen(self.index, self.depth_um)

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the paraxial focal shift (µm), and the relative error, estimated from the displacements of rays.

        A ray that is displaced by X on the lenslets contributes 2 (1 - exp(-2.1 (X/p) / (1 + (v/2)²)^½)), with the
        lenslet pitch p and the virtual depth v. A ray that enters or leaves the cutout contributes 1. Changes of
        radiance are added in quadrature. The formula was fitted to simulations.
        """
        optics, specimen, z = outlook.camera.optics, self.specimen(), outlook.z_um
        formula = "rays of Snell: 2 (1 - exp(-2.1 X/p/(1 + (v/2)²)^½)); Fresnel"
        if not isinstance(optics, Microscope):
            return Estimate(0.0, "µm", 0.0, "a microscope's specimen")
        shift = specimen.focus_um(z, optics.medium_index) - z
        deep = specimen.source_um(z)
        if deep < 0 or self.index == optics.medium_index:
            return Estimate(0.0, "µm", 0.0, "before the interface, or with the same index: no interface is crossed")
        n1, n2 = optics.medium_index, self.index
        least = math.cos(optics.half_angle_rad)
        theta = np.arccos(least + (1 - least) * (np.arange(RAYS) + 0.5) / RAYS)  # equal solid angles
        second, s, p = specimen.crossing(n1, theta)
        across = n1 / n2 * np.sin(theta)
        passed = np.abs(s) ** 2 + np.abs(p) ** 2 * (np.abs(second / n2) ** 2 + across**2)
        passed *= np.exp(-4 * math.pi / outlook.wavelength_um * deep * second.imag)
        bright = passed / passed.mean()
        here, rays = ray_heights(optics, z, None, theta), ray_heights(optics, z, specimen, theta)
        follows = np.isfinite(rays)
        there = np.where(follows, rays, 0.0)
        reach = math.inf
        if abs(outlook.virtual_depth) > 2:  # closer to the array, the cutout contains all the light
            reach = 0.55 * max(outlook.cutout) * outlook.pixel_um
        seen, seen_then = np.abs(here) < reach, follows & (np.abs(there) < reach)
        rate = 2.1 / outlook.camera.lattice.pitch_um / math.hypot(1.0, outlook.virtual_depth / 2)
        moved = 2 * (1 - np.exp(-rate * np.abs(there - here)))
        changed = np.where(seen & seen_then, moved, 1.0) * (seen | seen_then) * np.where(follows, bright, 0.0)
        light = max(float((bright * seen_then).sum()), 1e-9)
        error = math.hypot(float(changed.sum()), float((np.abs(bright - 1) * seen).sum())) / light
        return Estimate(shift, "µm", min(2.0, error), formula)

    def holds(self, outlook: Outlook) -> bool:
        """Return True: the formula was fitted to microscopes of all apertures, in focus and out of focus."""
        del outlook
        return True

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with the specimen, and the source's paraxial image through it; unchanged for a main lens.

        Ray tracing uses only the paraxial image.
        """
        del outlook
        if scene.objective is None:
            return scene
        specimen, optics = self.specimen(), scene.objective
        image = -(optics.magnification**2) * specimen.focus_um(scene.z_um, optics.medium_index) / optics.medium_index
        return replace(scene, specimen=specimen, image_um=image)

    def seconds(self, outlook: Outlook, engine: EngineSeconds) -> float:
        """Return 0: the additional nodes that the Debye integral needs are neglected."""
        del outlook, engine
        return 0.0


EFFECTS = (VectorialPupil, IndexMismatch)
"""The effects that the catalogue uses from this module; the name is the same in every module of effects."""
