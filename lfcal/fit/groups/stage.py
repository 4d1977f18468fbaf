"""The stage: the length of its steps; offsets of single positions belong to the patterns, not to the camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from lfcal.fit.parameters import Frame, Group, Unknown
from lfcal.fit.setup import Setup

__all__ = ["StageScale"]


class StageScale(Group):
    """Length of the stage's steps over the planned ones."""

    name = "stage_scale"
    title = "length of the stage's steps"
    rank = 80

    def unknowns(self, setup: Setup, frame: Frame) -> tuple[Unknown, ...]:
        """Return the scale minus 1; a screw's error of 2 % is beyond what is known beforehand."""
        return (Unknown("stage_scale", self.name, "", setup.stage_scale, 0.1 / frame.reach_px, 0.02, -0.3, 0.3),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: Frame) -> Setup:
        """Return the setup with such steps."""
        del frame
        return replace(setup, stage_scale=values["stage_scale"])


GROUPS = StageScale()
