"""What pixels do to the light: crosstalk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from lfcal.fit.parameters import Frame, Group, Unknown
from lfcal.fit.setup import Setup
from lfcal.simulate.effects import Crosstalk

__all__ = ["Neighbours"]


class Neighbours(Group):
    """Share of the light that each of the four nearest pixels collects."""

    name = "crosstalk"
    title = "pixel crosstalk"
    rank = 70

    def unknowns(self, setup: Setup, frame: Frame) -> tuple[Unknown, ...]:
        """Return the share."""
        del frame
        own = setup.effect(Crosstalk)
        return (Unknown("crosstalk", self.name, "", 0.0 if own is None else own.share, 0.02, None, 0.0, 0.2),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: Frame) -> Setup:
        """Return the setup with this crosstalk; without it there is no filter."""
        del frame
        if values["crosstalk"] == 0.0:
            return replace(setup, effects=tuple(one for one in setup.effects if not isinstance(one, Crosstalk)))
        return setup.with_effect(Crosstalk(values["crosstalk"]))


GROUPS = Neighbours()
