"""Depth to which a microscope is focused in a specimen of another refractive index."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from lfcal.fit.parameters import Group, ScanScales, Unknown
from lfcal.fit.setup import Setup
from lfcal.simulate.effects import IndexMismatch

__all__ = ["SpecimenGroup"]


class SpecimenGroup(Group):
    """Depth of the nominal focal plane below the interface; the refractive index of the specimen must be known."""

    name = "specimen"
    title = "depth in a specimen of another index"
    rank = 56
    needs = "the effect index_mismatch"

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknown: the depth (µm); empty unless the fit starts with an index mismatch."""
        del frame
        own = setup.effect(IndexMismatch)
        if own is None:
            return ()
        held = f"the specimen's index is fixed at {own.index:g}"
        return (Unknown("specimen_depth_um", self.name, "µm", own.depth_um, 2.0, None, 0.0, 1e4, gauge=held),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the depth in ``values``."""
        del frame
        own = setup.effect(IndexMismatch)
        assert own is not None
        return setup.with_effect(replace(own, depth_um=values["specimen_depth_um"]))


GROUPS = SpecimenGroup()
