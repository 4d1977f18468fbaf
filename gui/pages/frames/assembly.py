"""H from the frames of a project, as ``lfcal assemble`` makes it. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gui.models.words import plane_words
from gui.pages.frames.model import Opened
from lfcal.frames.corrections.recipe import check_turned_colours
from lfcal.frames.oriented import oriented
from lfcal.progress import Progress, Work
from lfcal.psf.upright import iter_upright

if TYPE_CHECKING:
    from lfcal.psf import AssemblyReport

__all__ = ["Filling", "iter_assembly", "notes_of"]


def iter_assembly(opened: Opened, path: str) -> Work[AssemblyReport]:
    """Hold the frames against the plan's path, and assemble H from them, corrected and upright.

    Raises
    ------
    InputError
        As `lfcal.psf.upright.iter_upright` and `lfcal.psf.iter_assemble_plan`.
    """
    from lfcal.psf import AssemblySettings, iter_assemble_plan

    given = opened.delivered
    metadata = given.frames.metadata
    known = {"intake": list(metadata["notes"])} if "notes" in metadata else {}
    turn, lie = yield from iter_upright(given.corrected, opened.plan, given.orientation)
    upright = oriented(given.corrected, turn, opened.plan.camera.sensor.shape)
    check_turned_colours(given.frames, given.scan, given.recipe, lie["orientation"]["applied"])
    settings = AssemblySettings(interpolation=opened.interpolation)
    return (yield from iter_assemble_plan(upright, opened.plan, path, settings, provenance=known | lie))


def notes_of(report: AssemblyReport) -> tuple[str, ...]:
    """Return what a user should know of an H that was assembled, a line each."""
    told = report.matrix.provenance.get("orientation", {}).get("note")
    notes = (*([told] if told else []), *report.notes)
    return notes or ("complete: every position once, no saturated pixel",)


@dataclass
class Filling:
    """H as it fills: the plane at work, and the light of the patterns ``(nz, ny, nx)``; not-a-number: not there yet."""

    plane: int | None = None
    energy: NDArray[np.float64] | None = None

    def take(self, record: Progress | None) -> bool:
        """Take what a record of the assembly shows; return whether that is news."""
        energy = getattr(record, "energy", None)
        if energy is None or energy is self.energy:
            return False
        self.plane, self.energy = int(record.plane), energy  # type: ignore[union-attr]
        return True

    def light(self, z: int) -> NDArray[np.float64] | None:
        """Return the light of the patterns of plane ``z``; None: nothing of it is there."""
        found = None if self.energy is None else self.energy[z]
        return found if found is not None and np.isfinite(found).any() else None

    def words(self, z: int, count: int, *, under_way: bool) -> str:
        """Return how far plane ``z`` of ``count`` planes is; empty where nothing is known."""
        energy = self.light(z)
        if energy is None:
            return ""
        there = int(np.isfinite(energy).sum())
        state = "fills" if under_way else "holds"
        return f"{plane_words(z, count)} of H {state}: light of {there} of {energy.size} positions"
