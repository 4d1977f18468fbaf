"""Gap, rotation, offset, pitch and tilt of the lenslet array."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lfcal.camera import Camera, LensletLattice
from lfcal.fit.parameters import Group, ScanScales, Unknown
from lfcal.fit.setup import Setup
from lfcal.simulate.effects import ArrayTilt

__all__ = ["ArrayTiltGroup", "Geometry", "Pitch"]

NEEDS = "a periodic lenslet array"

STEP_PX = 0.05
"""Noticeable displacement of lenslets at the edge of the cutout (pixels)."""

STEP_GAP = 0.002
"""Noticeable change of the gap at the edge of the cutout, as a fraction of the gap."""


def about(lattice: LensletLattice, point_um: tuple[float, float], turn_rad: float, grow: float) -> LensletLattice:
    """Return the lattice rotated and scaled about ``point_um``, so that a lenslet there does not move.

    The point is (x, y) relative to the centre of the sensor (µm). ``turn_rad`` is the rotation from x to y, and
    ``grow`` the relative increase of the pitch. If the lattice were rotated and scaled about the centre of the sensor,
    an error of rotation or pitch would also cause an error of the offset at the point.
    """
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    away = np.array(lattice.offset_um) - point_um
    x, y = (1.0 + grow) * np.array([c * away[0] - s * away[1], s * away[0] + c * away[1]]) + point_um
    rows = None if lattice.row_pitch_um is None else lattice.row_pitch_um * (1.0 + grow)
    return replace(
        lattice,
        pitch_um=lattice.pitch_um * (1.0 + grow),
        row_pitch_um=rows,
        rotation_rad=lattice.rotation_rad + turn_rad,
        offset_um=(float(x), float(y)),
    )


class Geometry(Group):
    """Gap, rotation and offset of the array."""

    name = "geometry"
    title = "gap, rotation and offset of the array"
    rank = 10
    core = True
    needs = NEEDS

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: gap (µm), rotation about the middle of the region (rad), offset change (y, x) (µm).

        The result is empty without a periodic array.
        """
        if not setup.camera.has_lattice:
            return ()
        lattice, pixel = setup.camera.lattice, setup.camera.sensor.pixel_um
        gap, aside = lattice.gap_um, 0.5 * lattice.pitch_um
        held = "the wavefront's tilt is fixed at 0"
        return (
            Unknown("gap_um", self.name, "µm", gap, 0.01 * gap, None, 0.2 * gap, 3 * gap),
            Unknown("rotation_rad", self.name, "rad", lattice.rotation_rad, STEP_PX / frame.reach_px),
            Unknown("offset_y_um", self.name, "µm", 0.0, 0.2 * pixel, None, -aside, aside, gauge=held),
            Unknown("offset_x_um", self.name, "µm", 0.0, 0.2 * pixel, None, -aside, aside, gauge=held),
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with gap, rotation and change of the offset of the array as in ``values``."""

        def placed(camera: Camera) -> Camera:
            lattice = about(camera.periodic, frame.middle_um, values["rotation_rad"] - camera.lattice.rotation_rad, 0.0)
            x, y = lattice.offset_um
            moved = (x + values["offset_x_um"], y + values["offset_y_um"])
            return replace(camera, lattice=replace(lattice, gap_um=values["gap_um"], offset_um=moved))

        return setup.edited(placed)


class Pitch(Group):
    """Pitch of the array."""

    name = "pitch"
    title = "pitch of the array"
    rank = 12
    needs = NEEDS

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknown: the pitch of the array (µm); empty without a periodic array."""
        if not setup.camera.has_lattice:
            return ()
        pitch = setup.camera.lattice.pitch_um
        scale = STEP_PX / frame.reach_px * pitch
        return (Unknown("pitch_um", self.name, "µm", pitch, scale, None, 0.8 * pitch, 1.25 * pitch),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the array scaled to the pitch in ``values`` about the middle of the region.

        A clear diameter of the lenslets that is given in the setup remains unchanged.
        """

        def grown(camera: Camera) -> Camera:
            grow = values["pitch_um"] / camera.lattice.pitch_um - 1.0
            return replace(camera, lattice=about(camera.periodic, frame.middle_um, 0.0, grow))

        return setup.edited(grown)


class ArrayTiltGroup(Group):
    """Tilt of the array relative to the sensor."""

    name = "array_tilt"
    title = "tilt of the array relative to the sensor"
    rank = 14
    late = True
    needs = NEEDS

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: the slopes of the gap in y and in x (rad); empty without a periodic array."""
        if not setup.camera.has_lattice:
            return ()
        own, camera = setup.effect(ArrayTilt), setup.camera
        start = (0.0, 0.0) if own is None else (own.rows_rad, own.columns_rad)
        scale = min(0.02, STEP_GAP * camera.lattice.gap_um / (frame.reach_px * camera.sensor.pixel_um))
        held = "the array is tilted about the optical axis"
        return tuple(
            Unknown(name, self.name, "rad", value, scale, None, -0.2, 0.2, gauge=held)
            for name, value in zip(("tilt_rows_rad", "tilt_columns_rad"), start, strict=True)
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the tilt of the array in ``values``; with a tilt of 0, the effect is removed."""
        del frame
        tilt = ArrayTilt(values["tilt_rows_rad"], values["tilt_columns_rad"])
        if tilt == ArrayTilt(0.0, 0.0):
            return replace(setup, effects=tuple(one for one in setup.effects if not isinstance(one, ArrayTilt)))
        return setup.with_effect(tilt)


GROUPS = (Geometry(), Pitch(), ArrayTiltGroup())
