"""The passes over H in units of a plane each: what is done stays where it is stopped, fails, or is killed.

Units of a pass lie beside the file until that holds the pass. The run's journal says which pass the file holds, so that
one that goes on begins with the next.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from lfcal.h5.file import H5File
from lfcal.progress import Clock, Work
from lfcal.psf import PSFMatrix
from lfcal.psf.facts import Facts
from lfcal.psf.joining import stored_plane
from lfcal.psf.provenance import simulated_planes
from lfcal.psf.store import PSFWriter
from lfcal.simulate.simulate import Simulation
from lfcal.simulate.units import unit_of
from lfcal.work import RunChoice, iter_begun, parts_folder
from lfcal.work.journal import PASS, Journal, read_notes
from lfcal.work.runs import discard
from lfcal.work.unit import stamp_of

__all__ = ["PassUnits", "kept_errors"]


@dataclass(frozen=True)
class PassUnits:
    """How the passes over one H are done in units.

    Attributes
    ----------
    out
        The H file.
    run
        By whom, and what becomes of an earlier run.
    stored
        How H is stored (dtype, compression).
    """

    out: Path
    run: RunChoice
    stored: Mapping[str, str]

    def marks(self, passes: Sequence[Simulation]) -> list[str]:
        """Return what tells each pass, and those before it, from any others."""
        found, before = [], ""
        for work in passes:
            prints = [unit_of(work.task(z), self.stored).fingerprint() for z in range(work.plan.shape[0])]
            before = hashlib.sha256(" ".join((before, *prints)).encode()).hexdigest()[:16]
            found.append(before)
        return found

    def done(self, marks: Sequence[str]) -> int:
        """Return how many of the passes the file holds already, by an earlier run that goes on now."""
        notes = read_notes(parts_folder(self.out), PASS)
        if self.run.begun != "resume" or not notes or not self.out.exists():
            return 0
        last = notes[-1]
        there = last.get("mark") in marks and last.get("stamp") == stamp_of([str(self.out)])
        return marks.index(last["mark"]) + 1 if there else 0

    def iter_pass(
        self, work: Simulation, writing: PSFWriter, before: PSFMatrix | None, mark: str, name: str
    ) -> Work[None]:
        """Write every plane: computed as a unit, or copied from ``before`` where that keeps the tolerance already."""
        errors = kept_errors(before, work.budget.tolerance)
        computed = [z for z in range(work.plan.shape[0]) if z not in errors]
        units = [unit_of(work.task(z), self.stored) for z in computed]
        run = self.run if before is None else replace(self.run, begun="resume")  # the first pass began it
        files = yield from iter_begun(units, self.out, run, title=f"simulate {self.out.name}, {name}")
        parts = dict(zip(computed, files, strict=True))
        clock = Clock("join planes", work.plan.shape[0])
        # the earlier file is closed when the new one takes its name: Windows replaces none that is open
        with writing as writer, nullcontext() if before is None else before:
            yield clock.at(0)
            for z in range(work.plan.shape[0]):
                if z in parts:
                    with H5File(parts[z]) as file:
                        writer.adopt_plane(z, stored_plane(file))
                else:
                    assert before is not None
                    facts = Facts.of(work.plan.period, work.plan.cutout, error=errors[z])
                    record = simulated_planes(before.provenance, len(before))[z]
                    writer.write_plane(z, before.plane(z), facts=facts, simulated=record)
                yield clock.at(z + 1)
        with Journal.open(parts_folder(self.out)) as journal:
            journal.note(PASS, mark=mark, stamp=stamp_of([str(self.out)]))

    def finish(self) -> None:
        """Free what lies beside the file, which holds the last pass."""
        discard(parts_folder(self.out))


def kept_errors(before: PSFMatrix | None, tolerance: float) -> dict[int, float]:
    """Return the planes of an H that keep a tolerance already, with their error."""
    if before is None:
        return {}
    errors = before.facts.known()["error"]
    return {z: float(error) for z, error in enumerate(errors) if float(error) <= tolerance}
