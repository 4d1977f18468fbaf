"""Effects of the lenslets themselves: defective ones."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from lfcal.camera.lens_centre import nearest_lens
from lfcal.checks import check_number, check_tuple
from lfcal.simulate.effects.base import Effect, Estimate, SceneEffect
from lfcal.simulate.effects.field import overlap
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.scene import Defects, Scene

__all__ = ["MissingLenslets"]

PLACES = 7
"""Source positions per axis over which the light behind a lenslet is averaged."""


@dataclass(frozen=True, slots=True)
class MissingLenslets(SceneEffect):
    """Single lenslets that pass less light than the others, or none.

    Attributes
    ----------
    lenslets
        ``(row, column, transmission)``: row and column of the lattice, counted from the lenslet of type 0 nearest to
        the region's first position; the column runs along the lattice's own vectors (`LensletLattice.centres_um`, r
        and q), so that in a hexagonal array column 0 of the next row is the right one of the two below. Transmission
        is the share of light that passes, 0 to 1.
    """

    lenslets: Defects = ((0, 0, 0.0),)

    name: ClassVar[str] = "missing_lenslets"
    title: ClassVar[str] = "defective lenslets"
    rank: ClassVar[int] = 84
    deviation: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check every lenslet; of one given twice the last counts."""
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
        """Return the light lost, 1 - t of what the lenslets' shares of the shadow are, averaged over the positions."""
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
        cell = lattice.pitch_um * lattice.row_step_um
        whole = 1.0 if lattice.edge_to_edge else min(1.0, math.pi * (0.5 * outlook.clear_um) ** 2 / cell)
        share = min(1.0, lost / whole)
        missing = sum(1.0 - t for _, _, t in self.lenslets)
        return Estimate(missing, "lenslets", min(2.0, share / max(1e-9, 1.0 - share)), "light lost over light left")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return the scene with these lenslets."""
        del outlook
        found = tuple(one for one in self.lenslets if one[2] != 1.0)
        return replace(scene, defects=scene.defects + found) if found else scene


EFFECTS = (MissingLenslets,)
