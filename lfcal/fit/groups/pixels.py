"""Crosstalk between pixels, and a free filter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from lfcal.fit.parameters import Group, ScanScales, Unknown
from lfcal.fit.setup import Setup
from lfcal.simulate.effects import NEIGHBOURS, Crosstalk, PixelKernel

__all__ = ["CrosstalkGroup", "Filter"]


class CrosstalkGroup(Group):
    """Fraction of a pixel's light that each of its two neighbours along an axis receives (`Crosstalk`)."""

    name = "crosstalk"
    title = "pixel crosstalk"
    rank = 70

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknown: the fraction of a pixel's light that either neighbour along an axis receives."""
        del frame
        own = setup.effect(Crosstalk)
        return (Unknown("crosstalk", self.name, "", 0.0 if own is None else own.share, 0.02, None, 0.0, 0.2),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the crosstalk in ``values``; with a fraction of 0, the effect is removed."""
        del frame
        if values["crosstalk"] == 0.0:
            return replace(setup, effects=tuple(one for one in setup.effects if not isinstance(one, Crosstalk)))
        return setup.with_effect(Crosstalk(values["crosstalk"]))


class Filter(Group):
    """A free filter of 3 x 3 pixels for the remaining smear, charge transfer and blur."""

    name = "pixel_kernel"
    title = "arbitrary filter of 3 x 3 pixels"
    rank = 72
    late = True

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: the fraction of a pixel's light that each of the eight neighbours receives."""
        del frame
        own = setup.effect(PixelKernel) or PixelKernel()
        return tuple(
            Unknown(f"kernel_{name}", self.name, "", getattr(own, name), 0.01, None, -0.1, 0.1) for name in NEIGHBOURS
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the pixel kernel in ``values``; if all fractions are 0, the effect is removed."""
        del frame
        found = PixelKernel(**{name: values[f"kernel_{name}"] for name in NEIGHBOURS})
        if found == PixelKernel():
            return replace(setup, effects=tuple(one for one in setup.effects if not isinstance(one, PixelKernel)))
        return setup.with_effect(found)


GROUPS = (CrosstalkGroup(), Filter())
