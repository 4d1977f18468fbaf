"""The stage: its zero and the length of its steps; displacements of single sources are not in these groups."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from lfcal.fit.groups.array import NEEDS
from lfcal.fit.parameters import Group, ScanScales, Unknown
from lfcal.fit.setup import Setup

__all__ = ["StageScale", "StageZero"]

BESIDE_PX = 2.0
"""Prior uncertainty of the zero of a stage (pixels)."""


class StageZero(Group):
    """Common lateral displacement of all sources.

    A tilt of the wavefront of the main lens has exactly the same effect. Seidel coma, W131 rho^3 cos(theta) at the
    pupil radius rho and azimuth theta, contains such a tilt.
    """

    name = "stage_zero"
    title = "lateral displacement of all sources"
    rank = 38
    needs = NEEDS

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: displacement (y, x) on the sensor (px); empty for a Fourier light-field microscope."""
        del frame
        if not setup.camera.has_lattice:
            return ()
        held = "tilt of the wavefront is included in the displacement of all sources"
        return tuple(
            Unknown(f"zero_{axis}_px", self.name, "px", start, 0.1, BESIDE_PX, -20.0, 20.0, gauge=held)
            for axis, start in zip("yx", setup.aside_px, strict=True)
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the sources displaced by the values in ``values``."""
        del frame
        return replace(setup, aside_px=(values["zero_y_px"], values["zero_x_px"]))


class StageScale(Group):
    """Length of the steps of the stage relative to the planned length."""

    name = "stage_scale"
    title = "length of the stage steps"
    rank = 80
    needs = NEEDS

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknown: the step length relative to the planned one, minus 1.

        The prior standard deviation of 2 % allows for the pitch of the stage's screw. The result is empty without a
        periodic array.
        """
        if not setup.camera.has_lattice:  # it has one position
            return ()
        return (Unknown("stage_scale", self.name, "", setup.stage_scale, 0.1 / frame.reach_px, 0.02, -0.3, 0.3),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the step length in ``values``."""
        del frame
        return replace(setup, stage_scale=values["stage_scale"])


GROUPS = (StageScale(), StageZero())
