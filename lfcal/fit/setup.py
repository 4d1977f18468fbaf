"""Inputs of a fit's model: the camera, its effects, and the actual positions of the source."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, check_number
from lfcal.camera import Camera, ScanPlan
from lfcal.simulate import outlook_of
from lfcal.simulate.effects import (
    CATALOGUE,
    Effect,
    ExactAngles,
    FrameEffect,
    IrisDiffraction,
    IrisShape,
    LensletDiffraction,
    LensTypeDefocus,
    MotionEffect,
    PixelFill,
    Telecentricity,
    VectorialPupil,
)

__all__ = ["RegionPlace", "Setup", "described_effects", "starting_effects", "with_given"]

SHOWN = 1e-3
"""Error of the image without the vector field, as a fraction, above which a fit includes the vector field."""

E = TypeVar("E", bound=Effect)


@dataclass(frozen=True, slots=True)
class RegionPlace:
    """Displacement of the sources of a region from their planned positions.

    Attributes
    ----------
    rows_px, columns_px
        Displacement on the sensor (pixels).
    farther_um
        Displacement of the planes of the region away from the camera, relative to those of the scan (µm).
    """

    rows_px: float = 0.0
    columns_px: float = 0.0
    farther_um: float = 0.0


@dataclass(frozen=True, slots=True)
class Setup:
    """All parameters that determine the light of a pattern, except for the planned positions of the scan.

    Attributes
    ----------
    camera
        The assumed camera.
    effects
        Effects that the simulation includes.
    depth_errors_um
        Displacement of each depth plane from its planned depth (µm), ``nz`` values; positive away from the camera.
    stage_scale
        Relative error of the lateral step of the stage: actual over planned step, minus 1.
    aside_px
        Displacement (rows, columns) of the images of all sources from their planned positions on the sensor (px).
    regions
        Additional displacements, one for each region of the field; empty for a single region.
    hole_um
        Diameter of the holes of a target (µm), if `lfcal.fit.measured.Measured.blur` describes their light. None: the
        effects describe the sources.
    travel_rad
        Tilt of the direction in which the stage moves the source in depth, relative to the optical axis (rad): along y
        (towards higher rows), then along x (towards higher columns).

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.fit import Setup
    >>> from lfcal.simulate.effects import LensletDiffraction
    >>> setup = Setup(preset("bench"), (LensletDiffraction(),), depth_errors_um=(0.0, 0.0))
    >>> print(setup.camera.name, [effect.name for effect in setup.effects])
    bench ['lenslet_diffraction']
    """

    camera: Camera
    effects: tuple[Effect, ...]
    depth_errors_um: tuple[float, ...]
    stage_scale: float = 0.0
    aside_px: tuple[float, float] = (0.0, 0.0)
    regions: tuple[RegionPlace, ...] = ()
    hole_um: float | None = None
    travel_rad: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check every value."""
        check_number("stage scale", self.stage_scale, above=-0.5, below=0.5)

    def of_region(self, k: int) -> Setup:
        """Return the setup of the region with index ``k``, with its displacements applied.

        If `regions` has no such entry, the setup itself is returned.
        """
        if k >= len(self.regions):
            return self
        own = self.regions[k]
        depths = tuple(error + own.farther_um for error in self.depth_errors_um)
        aside = (self.aside_px[0] + own.rows_px, self.aside_px[1] + own.columns_px)
        return replace(self, depth_errors_um=depths, aside_px=aside, regions=())

    def plan(self, planned: ScanPlan) -> ScanPlan:
        """Return a copy of ``planned`` with the camera of this setup; positions on the sensor stay as planned."""
        return replace(planned, camera=self.camera)

    def drift_px(self, z_um: float) -> NDArray[np.float64]:
        """Return the displacement (rows, columns) of the image of a source due to the tilt `travel_rad` (px).

        ``z_um`` is the planned depth from the zero of the stage (µm). The displacement is computed for a telecentric
        camera.
        """
        found: NDArray[np.float64] = np.tan(self.travel_rad) * z_um / self.camera.step_um()
        return found

    def effect(self, kind: type[E]) -> E | None:
        """Return the effect of class ``kind``; None if the setup has none."""
        return next((effect for effect in self.effects if type(effect) is kind), None)

    def with_effect(self, effect: Effect) -> Setup:
        """Return a copy of the setup with ``effect`` added, or replacing the effect of the same class."""
        others = tuple(one for one in self.effects if type(one) is not type(effect))
        return replace(self, effects=(*others, effect))

    def edited(self, change: Callable[[Camera], Camera]) -> Setup:
        """Return a copy of the setup with its camera replaced by ``change(camera)``."""
        return replace(self, camera=change(self.camera))


def described_effects(camera: Camera) -> tuple[Effect, ...]:
    """Return the effects that follow from the description of a camera, whatever their size; a fit starts with them."""
    if not camera.has_lattice:  # waves through single lenslets have all of them
        return (PixelFill(),) if camera.sensor.fill_factor < 1 else ()
    found: tuple[Effect, ...] = (LensTypeDefocus(), LensletDiffraction(), IrisDiffraction(), IrisShape())
    # a microscope's Debye integral has exact angles, and its pupil is at infinity
    if not camera.optics.telecentric:
        found = (*found, Telecentricity(), ExactAngles())
    return (*found, PixelFill()) if camera.sensor.fill_factor < 1 else found


def starting_effects(plan: ScanPlan) -> tuple[Effect, ...]:
    """Return the initial effects of a fit: those of `described_effects`, and the vector field if it is noticeable.

    The vector field is added only for a camera with a periodic array.
    """
    if not plan.camera.has_lattice:
        return described_effects(plan.camera)
    vectorial = VectorialPupil()
    shown = any(vectorial.estimate(outlook_of(plan, z)).error > SHOWN for z in range(plan.shape[0]))
    effects = described_effects(plan.camera)
    return (*effects, vectorial) if shown else effects


def with_given(effects: Sequence[Effect], settings: Mapping[str, str], given: Sequence[Effect]) -> tuple[Effect, ...]:
    """Return ``effects`` after adding those in ``given``, and then switching effects on or off as in ``settings``.

    An effect in ``given`` replaces that of the same name. ``settings`` contains ``"on"`` or ``"off"`` by the name of an
    effect; ``"on"`` adds an effect that is missing.

    Raises
    ------
    InputError
        If an effect does not exist, or acts on whole frames or by moving the source.
    """
    found = {effect.name: effect for effect in effects}
    found |= {effect.name: effect for effect in given}
    for name, setting in settings.items():
        if setting == "off":
            CATALOGUE.get(name)
            found.pop(name, None)
        elif setting == "on" and name not in found:
            found[name] = CATALOGUE.get(name)()
    wrong = next((one for one in found.values() if isinstance(one, FrameEffect | MotionEffect)), None)
    if wrong is not None:
        why = "positions are fitted" if isinstance(wrong, MotionEffect) else "frames are corrected for it"
        raise InputError.expected(
            "effects of a fit", "effects on the light of a point", wrong.name, f"leave it out, because {why}"
        )
    return tuple(found.values())
