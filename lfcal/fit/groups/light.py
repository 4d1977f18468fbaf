"""Size of the source, and width of its spectrum."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from lfcal.fit.parameters import Group, ScanScales, Unknown
from lfcal.fit.setup import Setup
from lfcal.simulate.effects import Bandwidth, FiniteSource

__all__ = ["Holes", "SourceSize", "Spectrum"]


MOST_PX = 6.0
"""Largest image of a source (pixels); larger ones need hundreds of source points."""


class SourceSize(Group):
    """Diameter of the source; the squared width of the blur is proportional to the squared diameter."""

    name = "source"
    title = "diameter of the source"
    rank = 60
    late = True

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknown: the diameter of the source (µm).

        A quarter of the diameter of the source's image adds in quadrature to the rms width of spots along each axis.
        """
        del frame
        own, camera = setup.effect(FiniteSource), setup.camera
        start = 0.0 if own is None else float(own.magnitude("diameter_um", camera))
        step = camera.step_um(0.0)
        most = max(MOST_PX * step, 1.5 * start)
        return (Unknown("source_um", self.name, "µm", start, 2.0 * step, None, 0.0, most, squared=True),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the diameter of the source in ``values``; a diameter of 0 is a point source."""
        del frame
        size = values["source_um"]
        if size == 0.0:
            return without(setup, FiniteSource)
        return setup.with_effect(FiniteSource(size))


class Holes(Group):
    """Diameter of the holes of a target; the squared width of the blur is proportional to the squared diameter."""

    name = "hole"
    title = "diameter of the target's holes"
    rank = 61
    late = True
    needs = "frames of a target"

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknown: the common diameter of all holes (µm); empty if there is no target."""
        del frame
        if setup.hole_um is None:
            return ()
        step = setup.camera.step_um(0.0)
        most = max(MOST_PX * step, 2.0 * setup.hole_um)
        return (Unknown("hole_um", self.name, "µm", setup.hole_um, step, None, 0.0, most, squared=True),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the diameter of the holes in ``values``."""
        del frame
        return replace(setup, hole_um=values["hole_um"])


class Spectrum(Group):
    """Full width of the spectrum of the light; the contrast of fringes decreases with the square of the width."""

    name = "bandwidth"
    title = "width of the spectrum"
    rank = 62
    late = True

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknown: the full width of the spectrum (µm)."""
        del frame
        own, camera = setup.effect(Bandwidth), setup.camera
        start = 0.0 if own is None else float(own.magnitude("width_um", camera))
        wave = camera.wavelength_um
        return (Unknown("bandwidth_um", self.name, "µm", start, 0.1 * wave, None, 0.0, 0.5 * wave, squared=True),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the width of the spectrum in ``values``; a width of 0 is monochromatic light."""
        del frame
        width = values["bandwidth_um"]
        if math.isclose(width, 0.0):
            return without(setup, Bandwidth)
        return setup.with_effect(Bandwidth(width))


def without(setup: Setup, kind: type) -> Setup:
    """Return the setup without its effects of class ``kind``."""
    return replace(setup, effects=tuple(one for one in setup.effects if type(one) is not kind))


GROUPS = (SourceSize(), Holes(), Spectrum())
