"""Glass between lenslets and sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from lfcal.base import InputError
from lfcal.simulate.effects.base import Estimate, SceneEffect
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.scene import Scene

__all__ = ["CoverGlass"]


@dataclass(frozen=True, slots=True)
class CoverGlass(SceneEffect):
    """A plane-parallel plate between lenslets and sensor: it shifts the focus by t (1 - 1/n), and more for steep rays.

    Ray tracing includes only the paraxial shift. The additional shift of steep rays requires wave optics with
    non-paraxial angles.

    Attributes
    ----------
    thickness_um, index
        Thickness t (µm) and refractive index n of the plate.
    in_gap
        Fraction of t (1 - 1/n) that is already included in the described gap. It is 0 if the described gap is the
        distance between lenslets and sensor. It is 1 for the equivalent distance in air, as found by focusing on the
        sensor.

    Examples
    --------
    >>> from lfcal.simulate.effects import CoverGlass
    >>> round(CoverGlass(thickness_um=90.0, index=1.5).shorter_um(), 3)  # t (1 - 1/n) in µm
    30.0
    """

    thickness_um: float = 100.0
    index: float = 1.52
    in_gap: float = 0.0

    name: ClassVar[str] = "cover_glass"
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {
        "thickness_um": (0.0, math.inf),
        "index": (1.0, 4.0),
        "in_gap": (0.0, 1.0),
    }
    units: ClassVar[Mapping[str, str]] = {"index": "", "in_gap": "share"}
    title: ClassVar[str] = "cover glass"
    rank: ClassVar[int] = 85
    deviation: ClassVar[bool] = True
    measured_by: ClassVar[str] = "geometry"

    def shorter_um(self) -> float:
        """Return the described gap minus the equivalent gap in air (µm)."""
        return self.thickness_um * (1.0 - 1.0 / self.index) * (1.0 - self.in_gap)

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return `shorter_um`, and the relative error due to the mean spot shift and the plate's aberration."""
        cone = 1.0 / (2.0 * outlook.f_number)
        rim = self.shorter_um() * cone
        # of B tan, t (1/n - 1/n³)/2 s³ is missing; the mean is 0.4 of the rim's value
        steep = self.thickness_um * (1.0 / self.index - self.index**-3.0) / 2.0 * cone**3
        shift = (2 / 3 * rim + 0.4 * steep) / outlook.pixel_um
        formula = "t (1 - 1/n)/(2 Nw) at the rim, 2/3 of it on average, 0.2 t (1/n - 1/n³)/(2 Nw)³"
        return Estimate(self.shorter_um(), "µm", outlook.moved(shift), formula)

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with the equivalent gap in air and the plate.

        Raises
        ------
        InputError
            If the plate does not fit into the gap, or ``scene`` already has a plate.
        """
        del outlook
        if not self.thickness_um or self.index == 1.0:
            return scene
        gap = scene.gap_um - self.shorter_um()
        # distance that remains between lenslets and sensor without the plate
        if scene.glass[0] or gap - self.thickness_um / self.index < 0:
            wanted = f"a plate that fits into the gap of {scene.gap_um:.4g} µm"
            raise InputError.expected(self.title, wanted, f"{self.thickness_um:.4g} µm", "give a thinner plate")
        return replace(scene, lattice=replace(scene.lattice, gap_um=gap), glass=(self.thickness_um, float(self.index)))


EFFECTS = (CoverGlass,)
