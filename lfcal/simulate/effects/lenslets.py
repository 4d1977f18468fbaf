"""Effects of the lenslets themselves: spherical aberration and defects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from lfcal.base import InputError, check_number, check_tuple
from lfcal.camera import nearest_lens
from lfcal.simulate.effects.base import WHITE_IMAGE, Effect, Estimate, SceneEffect
from lfcal.simulate.effects.field import overlap
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.scene import Defects, Scene

__all__ = ["LensletSpherical", "MissingLenslets"]

OF_TYPES = ("type_0", "type_1", "type_2")

PLACES = 7
"""Number of source positions along each axis over which the light behind a lenslet is averaged."""


@dataclass(frozen=True, slots=True)
class MissingLenslets(SceneEffect):
    """Individual lenslets that transmit less light than the others, or none.

    Attributes
    ----------
    lenslets
        Tuples ``(row, column, transmission)``. Row and column are lattice indices relative to the type-0 lenslet
        nearest to the first source position of the region. They are r and q of `LensletLattice.centres_um`: in a
        hexagonal array, (1, 0) is the right one of the two lenslets below (0, 0). Transmission is the fraction of light
        that passes, 0 to 1. If a lenslet is listed twice, the last entry counts.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import MissingLenslets, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = MissingLenslets(((0, 0, 0.0), (0, 1, 0.5))).estimate(plane)
    >>> print(f"{found.size} {found.unit} of {plane.lenslets:.0f} lit: error {found.error:.0%}")
    1.5 lenslets of 15 lit: error 7%
    """

    lenslets: Defects = ((0, 0, 0.0),)

    name: ClassVar[str] = "missing_lenslets"
    title: ClassVar[str] = "defective lenslets"
    rank: ClassVar[int] = 84
    changes_work: ClassVar[bool] = True
    deviation: ClassVar[bool] = True
    measured_by: ClassVar[str] = WHITE_IMAGE

    def __post_init__(self) -> None:
        """Check every lenslet; of entries for the same lenslet, keep the last."""
        Effect.__post_init__(self)
        known: dict[tuple[int, int], float] = {}
        for one in self.lenslets:
            check_tuple(f"{self.title}: row, column, transmission", one, 3)
            row, column, passed = one
            for number in (row, column):
                check_number(f"{self.title}: row, column", number, at_least=-1e6, at_most=1e6, integer=True)
            check_number(f"{self.title}: transmission", passed, at_least=0, at_most=1)
            known[int(row), int(column)] = float(passed)
        object.__setattr__(self, "lenslets", tuple((r, q, t) for (r, q), t in known.items()))

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the sum of 1 - transmission over the listed lenslets, and the ratio of lost to remaining light.

        The lost light is the mean over the source positions of a period.
        """
        lattice, px = outlook.camera.lattice, outlook.pixel_um
        first = [
            c + f / px - (n - 1) / 2
            for c, f, n in zip(outlook.camera.sensor.centre_px, outlook.field_um, outlook.period, strict=True)
        ]
        row, column = nearest_lens(outlook.camera, (first[0], first[1]))
        places = [np.linspace(0, n - 1, PLACES) + f for n, f in zip(outlook.period, first, strict=True)]
        lens, shadow = 0.5 * outlook.clear_um / px, outlook.shadow_px
        lost = 0.0
        for r, q, passed in self.lenslets:
            x, y = np.array([q, r]) @ lattice.basis_um() / px
            from_lens = np.hypot(*np.meshgrid(places[0] - row - y, places[1] - column - x))
            seen = [overlap(float(d) / shadow, lens / shadow) for d in from_lens.ravel()]
            lost += (1.0 - passed) * sum(seen) / len(seen)
        share = min(1.0, lost / lattice.fill_factor)
        missing = sum(1.0 - t for _, _, t in self.lenslets)
        return Estimate(
            missing, "lenslets", min(2.0, share / max(1e-9, 1.0 - share)), "lost light relative to the remaining light"
        )

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with these lenslets added to its defects, except those that transmit all light."""
        del outlook
        found = tuple(one for one in self.lenslets if one[2] != 1.0)
        return replace(scene, defects=scene.defects + found) if found else scene


@dataclass(frozen=True, slots=True)
class LensletSpherical(SceneEffect):
    """Spherical aberration of every lenslet: the phase 2 pi W (r/R)^4 at radius r; ray tracing does not include it.

    Attributes
    ----------
    waves
        Aberration W (W040) at the rim r = R of the clear aperture, in waves at the design wavelength. Positive values
        mean that the rim focuses farther from the lenslet. In the corners of contiguous square lenslets, the aberration
        is four times as large.
    type_0, type_1, type_2
        Additional aberration of lens types 0, 1 and 2 (waves).

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import LensletSpherical, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = LensletSpherical(0.25, type_2=0.3).estimate(plane)
    >>> print(f"{found.size:.2f} {found.unit} in the mean of three types")
    0.35 waves in the mean of three types
    """

    waves: float = 0.25
    type_0: float = 0.0
    type_1: float = 0.0
    type_2: float = 0.0

    name: ClassVar[str] = "lenslet_spherical"
    changes_work: ClassVar[bool] = True
    limits: ClassVar[Mapping[str, tuple[float, float]]] = dict.fromkeys(("waves", *OF_TYPES), (-10.0, 10.0))
    title: ClassVar[str] = "lenslets' spherical aberration"
    rank: ClassVar[int] = 25
    deviation: ClassVar[bool] = True
    measured_by: ClassVar[str] = "lenslet_spherical"
    needs_waves: ClassVar[bool] = True
    units: ClassVar[Mapping[str, str]] = dict.fromkeys(("waves", *OF_TYPES), "waves")
    titles: ClassVar[Mapping[str, str]] = {name: f"more in lens type {k}" for k, name in enumerate(OF_TYPES)}

    def of_types(self, types: int) -> tuple[float, ...]:
        """Return the additional aberration of each lens type (waves), to be added to `waves`.

        ``types`` is the number of lens types of the camera.

        Raises
        ------
        InputError
            If an aberration is given for a lens type that the camera does not have.
        """
        by_type = self.type_0, self.type_1, self.type_2
        if any(by_type[types:]):
            missing = next(k for k in range(types, len(by_type)) if by_type[k])
            raise InputError.expected(
                f"{self.title}: lens type", f"a number below {types}", missing, "leave this type out"
            )
        return by_type[:types]

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the mean of |W| over the lens types (waves), and the relative error due to the mean spot shift.

        W includes the additional aberration of each type.
        """
        radius = 0.5 * outlook.clear_um
        # moved light is proportional to the size: all types count equally
        sizes = [abs(self.waves + more) for more in self.of_types(len(outlook.camera.lattice.types))]
        size = sum(sizes) / len(sizes)
        shift = 4 * size * outlook.wavelength_um * outlook.gap_um / (radius * outlook.pixel_um)
        error = 0.6 * outlook.moved(0.4 * shift)
        return Estimate(size, "waves", error, "0.6 of a shift 0.4 * 4 W lambda B/R")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with aberrated lenslets."""
        del outlook
        by_type = self.of_types(len(scene.lattice.types))
        more = tuple(a + b for a, b in zip(scene.type_waves or (0.0,) * len(by_type), by_type, strict=True))
        waves = scene.lenslet_waves + self.waves
        if not (self.waves or any(more)):
            return scene
        return replace(scene, lenslet_waves=waves, type_waves=more if any(more) else ())


EFFECTS = (LensletSpherical, MissingLenslets)
