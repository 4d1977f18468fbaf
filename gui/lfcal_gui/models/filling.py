"""H as it fills while it is assembled. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Progress
from lfcal_gui.models.words import plane_words

if TYPE_CHECKING:
    from lfcal.psf import AssemblyProgress


@dataclass
class Filling:
    """H as it fills: the plane at work, and the light of the patterns ``(nz, ny, nx)``; not-a-number: not there yet."""

    plane: int | None = None
    energy: NDArray[np.float64] | None = None
    job: int = 0

    def follows(self, job: int, record: Progress | None) -> bool:
        """Return whether a job with such a record is the one that fills H, or now becomes it."""
        if _of_assembly(record) is not None and job != self.job:
            self.job, self.plane, self.energy = job, None, None
        return job == self.job

    def take(self, record: Progress | None) -> bool:
        """Take what a record of the assembly shows; return whether that is news."""
        found = _of_assembly(record)
        if found is None or found.energy is self.energy:
            return False
        self.plane, self.energy = found.plane, found.energy
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

    def short_words(self, z: int) -> str:
        """Return in few words how far plane ``z`` is."""
        energy = self.light(z)
        there = 0 if energy is None else int(np.isfinite(energy).sum())
        return f"H fills: plane {z}, {there} of {0 if energy is None else energy.size}"


def _of_assembly(record: Progress | None) -> AssemblyProgress | None:
    """Return a record of an assembly; None for any other."""
    if record is None or type(record) is Progress:
        return None
    from lfcal.psf import AssemblyProgress

    return record if isinstance(record, AssemblyProgress) else None
