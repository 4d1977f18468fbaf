"""Focal length and spherical aberration of each lens type."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from lfcal.camera import Camera, PupilLenslets
from lfcal.fit.groups.array import NEEDS
from lfcal.fit.groups.pupil import lenslets_of
from lfcal.fit.parameters import Group, ScanScales, Unknown
from lfcal.fit.setup import Setup
from lfcal.simulate.effects import LensletSpherical

__all__ = ["FocalLengths", "LensletAberration"]


class FocalLengths(Group):
    """Focal length of each lens type, or of the lenslets in a pupil plane."""

    name = "focal_lengths"
    title = "focal length of each lens type, or of lenslets in a pupil plane"
    rank = 20
    core = True

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: the focal length of each lens type (µm).

        For lenslets in a pupil plane, there is a common focal length, or one for each lenslet.
        """
        del frame
        lenslets = lenslets_of(setup)
        if lenslets is not None:
            named = [("focal_um", f) for f in lenslets.focal_lengths_um]
            named = named if len(named) == 1 else [(f"focal_{k}_um", f) for k, (_, f) in enumerate(named)]
            return tuple(Unknown(name, self.name, "µm", f, 0.003 * f, None, 0.3 * f, 3.0 * f) for name, f in named)
        return tuple(
            Unknown(f"focal_{k}_um", self.name, "µm", f, 0.005 * f, None, 0.3 * f, 3.0 * f)
            for k, f in enumerate(kind.focal_length_um for kind in setup.camera.lattice.types)
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup whose lenslets have the focal lengths in ``values``."""
        del frame

        def ground(camera: Camera) -> Camera:
            if isinstance(camera.lattice, PupilLenslets):
                return replace(camera, lattice=replace(camera.lattice, focal_lengths_um=tuple(values.values())))
            lattice = camera.periodic
            types = tuple(replace(t, focal_length_um=values[f"focal_{k}_um"]) for k, t in enumerate(lattice.types))
            return replace(camera, lattice=replace(lattice, types=types))

        return setup.edited(ground)


class LensletAberration(Group):
    """Spherical aberration of each lens type, which differs in effect from that of the main lens."""

    name = "lenslet_spherical"
    title = "spherical aberration of each lens type"
    rank = 22
    needs = NEEDS

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: the coefficient W040 at the rim of the clear diameter for each lens type (waves).

        The result is empty without a periodic array.
        """
        del frame
        if not setup.camera.has_lattice:
            return ()
        types = len(setup.camera.lattice.types)
        own = setup.effect(LensletSpherical)
        start = [0.0] * types if own is None else [own.waves + more for more in own.of_types(types)]
        return tuple(
            Unknown(f"lenslet_waves_{k}", self.name, "waves", w, 0.1, None, -5.0, 5.0) for k, w in enumerate(start)
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup whose lenslets have the spherical aberration in ``values``."""
        del frame
        own = {f"type_{k}": value for k, value in enumerate(values.values())}
        return setup.with_effect(LensletSpherical(0.0, **own))


GROUPS = (FocalLengths(), LensletAberration())
