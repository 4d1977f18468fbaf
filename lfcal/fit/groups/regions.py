"""Several regions of the field: changes of the wavefront between them, and positions of their sources."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from lfcal.fit.groups.depths import depth_scale
from lfcal.fit.parameters import Group, ScanScales, Unknown
from lfcal.fit.setup import RegionPlace, Setup
from lfcal.simulate.effects import FieldAberrations, FieldCurvature

__all__ = ["Curvature", "FieldWavefront", "Places", "RegionDepthsGroup", "TargetTiltGroup"]

NEEDS = "patterns of several regions of the field"
BESIDE_PX = 1.0
"""Prior uncertainty of the position of the stage in another region (pixels)."""

SHOWS_UM = 20.0
"""Noticeable change of the image distance in the farthest region (µm)."""


def farthest_um(frame: ScanScales) -> float:
    """Return the distance of the farthest region from the middle of the sensor (µm), at least 10 µm."""
    return max([10.0, *(math.hypot(*at) for at in frame.fields_um)])


class FieldWavefront(Group):
    """Variation of coma, astigmatism and spherical aberration over the field, as in `FieldAberrations`.

    An objective is simulated only with terms that are symmetric about the chief ray of each source, that is, spherical
    aberration.
    """

    name = "field_wavefront"
    title = "variation of the wavefront over the field"
    rank = 51
    needs = NEEDS

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: coefficients in the farthest region (waves); empty for a single region.

        Astigmatism that is linear in the field needs three regions. For telecentric optics, only spherical aberration
        is an unknown.
        """
        if len(frame.fields_um) < 2:
            return ()
        start, names = self._start(setup, frame), ["spherical"]
        if not setup.camera.optics.telecentric:
            names = ["coma", "astigmatism", *names]
            names += ["astigmatism_y", "astigmatism_x"] if len(frame.fields_um) > 2 else []
        held = "the other terms of the wavefront are as on the axis"
        return tuple(
            Unknown(f"field_{name}", self.name, "waves", getattr(start, name), 0.1, None, -20.0, 20.0, gauge=held)
            for name in names
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the coefficients in ``values``; if all are 0, the effect is removed."""
        found = {name.removeprefix("field_"): value for name, value in values.items()}
        if not any(found.values()):
            return replace(setup, effects=tuple(e for e in setup.effects if not isinstance(e, FieldAberrations)))
        return setup.with_effect(replace(self._start(setup, frame), **found))

    def _start(self, setup: Setup, frame: ScanScales) -> FieldAberrations:
        """Return the present values of the setup at the distance of the farthest region."""
        own, radius = setup.effect(FieldAberrations), farthest_um(frame)
        if own is None:
            return FieldAberrations(0.0, 0.0, radius_um=radius)
        by = radius / own.radius_um
        return FieldAberrations(
            own.coma * by,
            own.astigmatism * by**2,
            own.astigmatism_y * by,
            own.astigmatism_x * by,
            own.spherical * by**2,
            radius,
        )


class Curvature(Group):
    """Field curvature: the image of a plane is a curved surface."""

    name = "field_curvature"
    title = "curvature of the field"
    rank = 44
    needs = NEEDS

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknown: the additional distance of the image in the farthest region (µm).

        The result is empty for a single region.
        """
        if len(frame.fields_um) < 2:
            return ()
        own, far = setup.effect(FieldCurvature), farthest_um(frame)
        start = 0.0 if own is None else far**2 / (2 * own.radius_um)
        scale = min(SHOWS_UM, 0.02 * setup.camera.lattice.gap_um)
        return (Unknown("field_sag_um", self.name, "µm", start, scale, None, -1e4, 1e4),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the field curvature in ``values``; for a flat field, the effect is removed."""
        sag = values["field_sag_um"]
        if sag == 0:
            return replace(setup, effects=tuple(e for e in setup.effects if not isinstance(e, FieldCurvature)))
        return setup.with_effect(FieldCurvature(farthest_um(frame) ** 2 / (2 * sag)))


class Places(Group):
    """Displacement of the sources in each further region, relative to the first region."""

    name = "region_places"
    title = "positions of the sources of the regions"
    rank = 16
    needs = NEEDS

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: the sensor displacement (y, x) of the sources of every region but the first (px)."""
        del setup
        held = "the sources of the first region are at their planned positions"
        return tuple(
            Unknown(f"region_{k}_{axis}_px", self.name, "px", 0.0, 0.2, BESIDE_PX, -20.0, 20.0, gauge=held)
            for k in range(1, len(frame.fields_um))
            for axis in "yx"
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the sources of each region displaced by the values in ``values``."""
        found = [
            replace(own, rows_px=values.get(f"region_{k}_y_px", 0.0), columns_px=values.get(f"region_{k}_x_px", 0.0))
            for k, own in enumerate(_regions(setup, frame))
        ]
        return replace(setup, regions=tuple(found))


class RegionDepthsGroup(Group):
    """Displacement in depth of the planes of each further region, relative to the first region."""

    name = "region_depths"
    title = "distances of the planes of the regions"
    rank = 46
    needs = NEEDS

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: the depth change (µm) of each region but the first, due to non-orthogonal axes."""
        scale = depth_scale(setup.camera)
        return tuple(
            Unknown(f"region_{k}_farther_um", self.name, "µm", 0.0, scale) for k in range(1, len(frame.fields_um))
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the planes of each region displaced in depth by its value in ``values``."""
        found = [
            replace(own, farther_um=values.get(f"region_{k}_farther_um", 0.0))
            for k, own in enumerate(_regions(setup, frame))
        ]
        return replace(setup, regions=tuple(found))


class TargetTiltGroup(Group):
    """Tilt of the plane of a target relative to the sensor, in addition to the known tilt."""

    name = "plane_tilt"
    title = "tilt of the plane of the target"
    rank = 47
    needs = "parts of the field at different depths, as with a target"

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: the slopes (y, x) of the plane, each as the depth (µm) added at the farthest part.

        "Farthest" refers to the distance from the middle of the sensor. The result is empty for fewer than three parts.
        """
        if not setup.regions or len(frame.fields_um) < 3:
            return ()
        scale = depth_scale(setup.camera)
        return tuple(Unknown(f"plane_tilt_{axis}_um", self.name, "µm", 0.0, scale) for axis in "yx")

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the plane of each part displaced according to the tilt in ``values``."""
        down, right = values["plane_tilt_y_um"], values["plane_tilt_x_um"]
        far, found = farthest_um(frame), []
        for own, (x, y) in zip(_regions(setup, frame), frame.fields_um, strict=True):
            aside = x - frame.middle_um[0], y - frame.middle_um[1]
            found.append(replace(own, farther_um=own.farther_um + (down * aside[1] + right * aside[0]) / far))
        return replace(setup, regions=tuple(found))


def _regions(setup: Setup, frame: ScanScales) -> tuple[RegionPlace, ...]:
    return setup.regions or (RegionPlace(),) * len(frame.fields_um)


GROUPS = (Curvature(), FieldWavefront(), Places(), RegionDepthsGroup(), TargetTiltGroup())
