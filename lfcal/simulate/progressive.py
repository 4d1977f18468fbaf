"""H in passes: whole after the first, more accurate after each, and stopped whenever it is good enough."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.camera import Camera, ScanPlan
from lfcal.checks import check_number
from lfcal.progress import Progress, Work
from lfcal.psf import PSFMatrix, open_psf
from lfcal.psf.facts import Facts
from lfcal.psf.provenance import simulated_planes
from lfcal.psf.store import PSFWriter
from lfcal.simulate.pass_units import PassUnits, kept_errors
from lfcal.simulate.simulate import EffectsLike, Simulation, tolerance_for
from lfcal.work import RunChoice

__all__ = ["Pass", "iter_refine_psf", "passes_for"]

STEPS = (10.0, 10 / 3)
"""Tolerances of the passes between rays and the last one, in units of the last: a step costs three times as much."""

COARSEST = 0.35
"""Tolerance beyond which a pass by waves says no more than rays do."""

EffectsFor = Callable[[float], EffectsLike]
"""Chooses effects for a tolerance."""


@dataclass(frozen=True, slots=True)
class Pass:
    """One time over all planes.

    Attributes
    ----------
    level
        As in `simulate_psf`.
    tolerance
        Relative L1 error that planes have to keep; those that keep it already are not computed again.
    """

    level: str
    tolerance: float


def passes_for(tolerance: float, level: str = "auto") -> tuple[Pass, ...]:
    """Return the passes that lead to a tolerance: rays, then steps of about three; all but the last are cheap."""
    check_number("tolerance", tolerance, above=0, at_most=4, remedy="0.03 is usual")
    if level == "geometric":
        return (Pass(level, tolerance),)
    steps = [factor * tolerance for factor in STEPS if factor * tolerance < COARSEST]
    return (Pass("geometric", 1.0), *(Pass(level, step) for step in steps), Pass(level, tolerance))


def iter_refine_psf(
    camera: Camera,
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
    """Simulate H into a file in passes; yields progress in rows.

    After each pass the file holds a whole H, each plane labelled with the error that it reached; it takes the place of
    the one before at once. Closing the generator stops: what the last whole pass wrote stays.

    Parameters
    ----------
    camera, plan, level, tolerance, dtype, compression, workers, provenance
        As in `simulate_psf`.
    effects
        As in `simulate_psf`, or a function that chooses them for the tolerance of a pass.
    out
        H file to write.
    on_pass
        Called with the H of each pass, opened from the file; it is closed when the next pass has its own.
    run
        Do each pass in units of a plane: those that are done stay where it is stopped, and the next run goes on with
        them. Effects are those of the catalogue then. None: what was begun after a whole pass is dropped.

    Returns
    -------
    PSFMatrix
        The last pass's, opened from ``out``.

    Raises
    ------
    InputError, EnergyError, StorageError
        As `simulate_psf`; what earlier passes wrote stays.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.progress import drain
    >>> from lfcal.simulate import iter_refine_psf
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (1, 3), cutout=(41, 41), depths_um=(camera.depth_of(4.0),), anchor=(160, 160))
    >>> passes = []
    >>> with drain(iter_refine_psf(camera, plan, out="refined.h5", on_pass=passes.append)) as H:
    ...     print(len(passes), "passes to", f"{H.facts.known()['error'].max():.0%}")
    4 passes to 2%
    """
    path = Path(out)
    chosen = effects if callable(effects) else lambda _: effects
    passes = passes_for(tolerance_for(effects, tolerance), level)
    works = [Simulation(camera, plan, chosen(p.tolerance), p.level, p.tolerance, None, workers) for p in passes]
    units = None if run is None else PassUnits(path, run, {"dtype": dtype, "compression": compression})
    marks = [""] * len(works) if units is None else units.marks(works)
    there = 0 if units is None else units.done(marks)
    held: PSFMatrix | None = None
    try:
        held = open_psf(path) if there else None
        for number in range(there + 1, len(works) + 1):
            work, mark = works[number - 1], marks[number - 1]
            name, writing = f"pass {number} of {len(works)}", work.writer(path, dtype, compression, provenance)
            steps = _pass(work, writing, held) if units is None else units.iter_pass(work, writing, held, mark, name)
            yield from _noted(steps, name, _note(held))
            if held is not None:
                held.close()
            held = open_psf(path)
            if on_pass is not None:
                on_pass(held)
        if units is not None:
            units.finish()
    except BaseException:
        if held is not None:
            held.close()
        raise
    assert held is not None  # there is a pass at least
    return held


def _note(held: PSFMatrix | None) -> str:
    return "" if held is None else f"H so far within {100 * float(np.max(held.facts.known()['error'])):.2g} %"


def _pass(work: Simulation, writing: PSFWriter, before: PSFMatrix | None) -> Work[None]:
    """Write every plane: computed, or copied from ``before`` where that keeps the tolerance already."""
    plan, errors = work.plan, kept_errors(before, work.budget.tolerance)
    # the earlier file is closed when the new one takes its name: Windows replaces none that is open
    with writing as writer, nullcontext() if before is None else before:
        plane = np.empty(plan.shape[1:], np.float32)
        for z in range(plan.shape[0]):
            if z in errors and before is not None:
                plane[:] = before.plane(z)
                error, record = errors[z], simulated_planes(before.provenance, len(before))[z]
            else:
                plane[:] = 0
                error, record = yield from work.plane(z, plane)
            writer.write_plane(z, plane, facts=Facts.of(plan.period, plan.cutout, error=error), simulated=record)


def _noted(work: Work[None], stage: str, note: str) -> Work[None]:
    """Pass on the progress of a pass under its name."""
    try:
        while True:
            record: Progress = next(work)
            yield replace(record, stage=f"{stage}, {record.stage}", note="; ".join(filter(None, (note, record.note))))
    except StopIteration:
        return
    finally:
        work.close()
