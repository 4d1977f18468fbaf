"""Simulate H in passes: it is complete after the first, and more accurate after each further pass."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base import Progress, Work, check_number
from lfcal.camera import ScanPlan
from lfcal.psf import (
    Facts,
    Plane,
    PlaneSource,
    PSFMatrix,
    Reopening,
    Stored,
    Zeros,
    iter_write,
    open_psf,
    simulated_planes,
    units_of,
)
from lfcal.simulate.plane_task import EffectsLike, tolerance_for
from lfcal.simulate.simulate import Simulation
from lfcal.work import PASS, Journal, RunChoice, discard, parts_folder, read_notes, stamp_of

__all__ = ["Pass", "iter_refine_psf", "passes_for"]

STEPS = (10.0, 10 / 3)
"""Tolerances of the passes between that with rays and the last one, as multiples of the last tolerance.

Each pass costs three times as much as the one before.
"""

COARSEST = 0.35
"""Tolerance above which a pass by waves is no better than rays."""

EffectsFor = Callable[[float], EffectsLike]
"""Chooses the effects for a tolerance."""


@dataclass(frozen=True, slots=True)
class Pass:
    """One pass over all planes.

    Attributes
    ----------
    level
        As in `simulate_psf`.
    tolerance
        Largest relative L1 error allowed; planes already within it are not computed again.
    """

    level: str
    tolerance: float


def passes_for(tolerance: float, level: str = "auto") -> tuple[Pass, ...]:
    """Return the passes for a tolerance: one with rays, then passes whose tolerances decrease by factors of about 3.

    The last pass has the given tolerance. Intermediate passes with tolerances of 0.35 or more are omitted. For the
    level ``"geometric"``, there is only one pass.
    """
    check_number("tolerance", tolerance, above=0, at_most=4, remedy="0.03 is usual")
    if level == "geometric":
        return (Pass(level, tolerance),)
    steps = [factor * tolerance for factor in STEPS if factor * tolerance < COARSEST]
    return (Pass("geometric", 1.0), *(Pass(level, step) for step in steps), Pass(level, tolerance))


def iter_refine_psf(
    plan: ScanPlan,
    effects: EffectsLike | EffectsFor = "auto",
    level: str = "auto",
    *,
    tolerance: float | None = None,
    out: str | os.PathLike[str],
    dtype: str = "float32",
    compression: str = "gzip",
    workers: int | None = None,
    provenance: Mapping[str, Any] | None = None,
    on_pass: Callable[[PSFMatrix], None] | None = None,
    run: RunChoice | None = None,
) -> Work[PSFMatrix]:
    """Simulate H with increasing accuracy in several passes, write each result to a file, and return the last H.

    After each pass, a complete H replaces the previous one atomically. The file states the error that each plane
    reached. Progress is counted in source rows. Closing the generator stops the simulation; the result of the last
    complete pass remains.

    Parameters
    ----------
    plan, level, tolerance, dtype, compression, workers, provenance
        As in `simulate_psf`.
    effects
        As in `simulate_psf`, or a function that returns them for the tolerance of a pass.
    out
        H file to write.
    on_pass
        Function that is called with the H of each pass, opened from the file; this H is closed when the next pass is
        complete.
    run
        Settings for computing the planes as separate work units: the executor, and what to do with units left by an
        earlier run. If the run is stopped, finished units are kept. All effects must be from the catalogue. None: if
        the simulation is stopped, the unfinished pass is discarded.

    Returns
    -------
    PSFMatrix
        H of the last pass, opened from ``out``.

    Raises
    ------
    InputError, EnergyError, StorageError
        As in `simulate_psf`; the result of the last complete pass is kept.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.base import drain
    >>> from lfcal.simulate import iter_refine_psf
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (1, 3), cutout=(41, 41), depths_um=(camera.depth_of(4.0),), anchor=(160, 160))
    >>> passes = []
    >>> with drain(iter_refine_psf(plan, out="refined.h5", on_pass=passes.append)) as H:
    ...     print(len(passes), "passes to", f"{H.facts.known()['error'].max():.0%}")
    4 passes to 1%
    """
    path = Path(out)
    chosen = effects if callable(effects) else lambda _: effects
    passes = passes_for(tolerance_for(effects, tolerance), level)
    works = [Simulation(plan, chosen(p.tolerance), p.level, p.tolerance, None, provenance=provenance) for p in passes]
    stored = Stored(dtype, compression)
    units = None if run is None else _PassUnits(path, run, stored)
    marks = [""] * len(works) if units is None else units.marks(works)
    there = 0 if units is None else units.done(marks)
    held: PSFMatrix | None = None
    try:
        held = open_psf(path) if there else None
        for number in range(there + 1, len(works) + 1):
            name = f"pass {number} of {len(works)}"
            planes = _PassPlanes(works[number - 1], held, name)
            if units is None:
                yield from _noted(iter_write(planes, path, stored, workers=workers), name, _note(held))
            else:
                yield from _noted(units.iter_pass(planes, marks[number - 1]), name, _note(held))
            if held is not None:
                held.close()
            held = open_psf(path)
            if on_pass is not None:
                on_pass(held)
        if units is not None:
            discard(parts_folder(path))  # the file contains the last pass
    except BaseException:
        if held is not None:
            held.close()
        raise
    assert held is not None  # there is at least one pass
    return held


def _note(held: PSFMatrix | None) -> str:
    return "" if held is None else f"H so far within {100 * float(np.max(held.facts.known()['error'])):.2g} %"


def errors_within(before: PSFMatrix | None, tolerance: float) -> dict[int, float]:
    """Return the errors of the planes of an H that are already within a tolerance, by plane index.

    ``before`` is the H; None returns an empty dictionary.
    """
    if before is None:
        return {}
    errors = before.facts.known()["error"]
    return {z: float(error) for z, error in enumerate(errors) if float(error) <= tolerance}


class _PassPlanes(PlaneSource):
    """Planes of a pass. Planes of the previous pass that already meet the tolerance are kept."""

    def __init__(self, work: Simulation, before: PSFMatrix | None, name: str) -> None:
        self.work, self.before, self._name = work, before, name
        self.header, self.title = work.header, work.title
        self._errors = errors_within(before, work.budget.tolerance)

    def iter_plane(self, z: int, zeros: Zeros, workers: int | None, *, alone: bool = False) -> Work[Plane]:
        """Return plane ``z``: computed, or read from the previous pass if it already meets the tolerance."""
        before = self.before
        if before is None or z not in self._errors:
            return (yield from self.work.iter_plane(z, zeros, workers, alone=alone))
        facts = Facts.of(self.work.plan.period, self.work.plan.cutout, error=self._errors[z])
        record = simulated_planes(before.provenance, len(before))[z]
        return Plane(before.plane(z), facts, simulated=record)

    def reopening(self, z: int, stored: Stored) -> Reopening | None:
        """Return how another process computes plane ``z``; a plane that is kept is read here."""
        return None if z in self._errors else self.work.reopening(z, stored)

    def named(self, out: Path) -> str:
        """Return the title of a run that writes ``out`` in this pass, for messages."""
        return f"{super().named(out)}, {self._name}"

    def close(self) -> None:
        """Close the file of the previous pass, because Windows does not replace an open file."""
        if self.before is not None:
            self.before.close()


@dataclass(frozen=True)
class _PassUnits:
    """Division of the passes over one H into units.

    Units of a pass are next to the file until the file contains the pass. The run's journal states which pass the file
    contains, so that a resumed run begins with the next pass.
    """

    out: Path
    run: RunChoice
    stored: Stored

    def marks(self, passes: Sequence[Simulation]) -> list[str]:
        """Return the identity of each pass, including the passes before it."""
        found, before = [], ""
        for work in passes:
            prints = [unit.fingerprint() for unit in units_of(work, self.stored).values()]
            before = hashlib.sha256(" ".join((before, *prints)).encode()).hexdigest()[:16]
            found.append(before)
        return found

    def done(self, marks: Sequence[str]) -> int:
        """Return the number of passes that the file already contains, from an earlier run that is now resumed."""
        notes = read_notes(parts_folder(self.out), PASS)
        if self.run.begun != "resume" or not notes or not self.out.exists():
            return 0
        last = notes[-1]
        there = last.get("mark") in marks and last.get("stamp") == stamp_of([str(self.out)])
        return marks.index(last["mark"]) + 1 if there else 0

    def iter_pass(self, planes: _PassPlanes, mark: str) -> Work[None]:
        """Write the planes of a pass, and record that the file contains it."""
        run = self.run if planes.before is None else replace(self.run, begun="resume")  # begun by the first pass
        yield from iter_write(planes, self.out, self.stored, run=run, keep=True)
        with Journal.open(parts_folder(self.out)) as journal:
            journal.note(PASS, mark=mark, stamp=stamp_of([str(self.out)]))


def _noted(work: Work[Any], stage: str, note: str) -> Work[None]:
    """Pass on the progress of a pass under its name."""
    try:
        while True:
            record: Progress = next(work)
            yield replace(record, stage=f"{stage}, {record.stage}", note="; ".join(filter(None, (note, record.note))))
    except StopIteration:
        return
    finally:
        work.close()
