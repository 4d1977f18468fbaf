"""The iris: its size and rotation, the curvature of its blades, and the second stop of cat's-eye vignetting."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from lfcal.camera import Camera, MainLens, Microscope, PupilLenslets
from lfcal.fit.parameters import Group, ScanScales, Unknown
from lfcal.fit.setup import Setup
from lfcal.simulate import LAWS
from lfcal.simulate.effects import ExactAngles, LensLaw, MechanicalVignetting

__all__ = ["ApertureGroup", "BladeCurvature", "Law", "SecondStop"]

NEAR_EDGE = 0.1
"""Largest distance, in radii of the pupil, at which its described edge counts as cutting a lenslet."""

LAW = 0.5
"""Prior uncertainty of the lens law: the tangent law is two standard deviations from the sine condition."""


def _optics(setup: Setup, **values: Any) -> Setup:
    def changed(camera: Camera) -> Camera:
        return replace(camera, optics=replace(camera.optics, **values))

    return setup.edited(changed)


def _law_held(setup: Setup) -> str:
    """Return the lens law that relates the f-number to the size of the iris, as text; empty without exact angles."""
    if setup.effect(ExactAngles) is None:
        return ""
    own = setup.effect(LensLaw)
    law = 0.0 if own is None else own.tangent
    words = {0.0: "the main lens obeys the sine condition", 1.0: "the main lens obeys the tangent law"}
    return words.get(law, f"the lens law is fixed at {law:g}")


def _cuts(camera: Camera) -> bool:
    """Return whether patterns show the edge of the pupil; with lenslets in a pupil plane, it must cut one of them."""
    lattice, optics = camera.lattice, camera.optics
    if not isinstance(lattice, PupilLenslets) or not isinstance(optics, Microscope):
        return True
    reach = max(math.hypot(*c) for c in lattice.lens_centres_um) + lattice.clear_um / 2
    return reach > (1 - NEAR_EDGE) * lattice.pupil_um(optics) / 2


class ApertureGroup(Group):
    """Size of the pupil, and rotation of the blades of the iris."""

    name = "iris"
    title = "size and rotation of the iris"
    rank = 30
    core = True
    needs = "lenslets that the edge of the pupil cuts"

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: f-number and rotation (rad) of the iris, or the numerical aperture of a microscope.

        A round iris has no rotation. The result is empty if the edge of the pupil of a microscope cuts no lenslet.
        """
        del frame
        optics = setup.camera.optics
        if isinstance(optics, Microscope):
            na, most = optics.numerical_aperture, 0.999 * optics.medium_index
            if not _cuts(setup.camera):
                return ()
            return (Unknown("numerical_aperture", self.name, "", na, 0.02 * na, None, 0.3 * na, min(most, 2 * na)),)
        n = optics.f_number
        size = Unknown("f_number", self.name, "", n, 0.025 * n, None, 0.4 * n, 2.5 * n, gauge=_law_held(setup))
        if optics.blades == 0 or optics.blade_curvature == 1:
            return (size,)
        # a rotation by more than half the angle between blades gives an iris that is already covered
        half = math.pi / optics.blades
        turn = optics.blade_rotation_rad
        return size, Unknown("iris_rotation_rad", self.name, "rad", turn, 0.05, None, turn - half, turn + half)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the size and rotation of the iris in ``values``."""
        del frame
        names = {"iris_rotation_rad": "blade_rotation_rad"}
        return _optics(setup, **{names.get(name, name): value for name, value in values.items()})


class BladeCurvature(Group):
    """Curvature of the blades of the iris."""

    name = "blades"
    title = "curvature of the iris's blades"
    rank = 32
    needs = "an iris with blades"

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknown: the curvature of the blades (0 to 1); empty without an iris that has blades."""
        del frame
        optics = setup.camera.optics
        if not isinstance(optics, MainLens) or optics.blades == 0:
            return ()
        return (Unknown("iris_curvature", self.name, "", optics.blade_curvature, 0.2, None, 0.0, 1.0),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the curvature of the blades in ``values``."""
        del frame
        return _optics(setup, blade_curvature=values["iris_curvature"])


class Law(Group):
    """Lens law of the main lens; scans hardly distinguish a different law from a different size of the iris."""

    name = "lens_law"
    title = "lens law of the main lens: sine condition or tangent law"
    rank = 36
    held = True
    assumed = True
    needs = "a main lens and the effect exact_angles"

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknown: the parameter of the lens law, 0 for the sine condition and 1 for the tangent law.

        The result is empty for telecentric optics, or if the setup does not have the effect `ExactAngles`.
        """
        del frame
        if setup.camera.optics.telecentric or setup.effect(ExactAngles) is None:
            return ()
        own = setup.effect(LensLaw)
        return (Unknown("lens_law", self.name, "", 0.0 if own is None else own.tangent, LAW, LAW, *LAWS),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the lens law in ``values``; for the sine condition, the effect is removed."""
        del frame
        if values["lens_law"] == 0:
            return replace(setup, effects=tuple(one for one in setup.effects if not isinstance(one, LensLaw)))
        return setup.with_effect(LensLaw(values["lens_law"]))


class SecondStop(Group):
    """Rim that vignettes the pupil away from the axis, if the setup has one."""

    name = "cats_eye"
    title = "position and radius of the rim that limits the pupil"
    rank = 34
    needs = "the effect vignetting, and points off the axis"

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: distance (µm) and radius (pupil radii) of the rim.

        The result is empty without a main lens or the effect `MechanicalVignetting`, or if all regions are within 100
        pixels of the axis.
        """
        own = setup.effect(MechanicalVignetting)
        seen = frame.fields_um or (frame.middle_um,)
        off = max(math.hypot(*field) for field in seen) > 100.0 * setup.camera.sensor.pixel_um
        if own is None or not isinstance(setup.camera.optics, MainLens) or not off:
            return ()
        away = abs(own.distance_um) or setup.camera.optics.focal_length_um
        return (
            Unknown("rim_distance_um", self.name, "µm", own.distance_um, 0.05 * away),
            Unknown("rim_radius", self.name, "pupil radii", own.radius, 0.02, None, 0.1, 3.0),
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the distance and radius of the rim in ``values``."""
        del frame
        return setup.with_effect(MechanicalVignetting(values["rim_distance_um"], values["rim_radius"]))


GROUPS = (ApertureGroup(), BladeCurvature(), Law(), SecondStop())
