"""H in passes: whole after the first, more accurate after each, and stopped whenever it is good enough."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.camera import Camera, ScanPlan
from lfcal.checks import check_number
from lfcal.progress import Progress, Work
from lfcal.psf import PSFMatrix, open_psf
from lfcal.psf.facts import Facts
from lfcal.psf.store import PSFWriter
from lfcal.simulate.simulate import EffectsLike, Simulation

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
    tolerance: float = 0.03,
    out: str | os.PathLike[str],
    dtype: str = "float32",
    compression: str = "gzip",
    workers: int | None = None,
    provenance: Mapping[str, Any] | None = None,
    on_pass: Callable[[PSFMatrix], None] | None = None,
) -> Work[PSFMatrix]:
    """Simulate H into a file in passes; yields progress in rows.

    After each pass the file holds a whole H, each plane labelled with the error that it reached; it takes the place of
    the one before at once. Closing the generator stops: what the last whole pass wrote stays, and what was begun after
    it is dropped.

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

    Returns
    -------
    PSFMatrix
        The last pass's, opened from ``out``.

    Raises
    ------
    InputError, EnergyError, StorageError
        As `simulate_psf`; what earlier passes wrote stays.
    """
    path = Path(out)
    chosen = effects if callable(effects) else lambda _: effects
    passes = passes_for(tolerance, level)
    held: PSFMatrix | None = None
    try:
        for number, one in enumerate(passes, 1):
            work = Simulation(camera, plan, chosen(one.tolerance), one.level, one.tolerance, None, workers)
            writing = work.writer(path, dtype, compression, provenance)
            yield from _pass(work, writing, held, f"pass {number} of {len(passes)}")
            if held is not None:
                held.close()
            held = open_psf(path)
            if on_pass is not None:
                on_pass(held)
    except BaseException:
        if held is not None:
            held.close()
        raise
    assert held is not None  # there is a pass at least
    return held


def _pass(work: Simulation, writing: PSFWriter, before: PSFMatrix | None, stage: str) -> Work[None]:
    """Write every plane: computed, or copied from ``before`` where that keeps the tolerance already."""
    plan, tolerance = work.plan, work.budget.tolerance
    errors = None if before is None else before.facts.known()["error"]
    note = "" if errors is None else f"H so far within {100 * float(np.max(errors)):.2g} %"
    with writing as writer:
        plane = np.empty(plan.shape[1:], np.float32)
        for z in range(plan.shape[0]):
            if before is not None and errors is not None and float(errors[z]) <= tolerance:
                plane[:] = before.plane(z)
                error = float(errors[z])
            else:
                plane[:] = 0
                error = yield from _noted(work.plane(z, plane), stage, note)
            writer.write_plane(z, plane, facts=Facts.of(plan.period, plan.cutout, error=error))


def _noted(work: Work[float], stage: str, note: str) -> Work[float]:
    """Pass on the progress of one plane under the pass's name."""
    try:
        while True:
            record: Progress = next(work)
            yield replace(record, stage=f"{stage}, {record.stage}", note=record.note or note)
    except StopIteration as stop:
        error: float = stop.value
        return error
    finally:
        work.close()
