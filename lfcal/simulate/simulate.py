"""Simulate H plane by plane: in memory, into a file, or in units by other processes."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from lfcal.base import InputError, Work, drained, format_bytes, plain
from lfcal.camera import ScanPlan
from lfcal.psf import Facts, Header, Plane, PlaneSource, PSFMatrix, Reopening, Stored, Zeros, iter_make
from lfcal.simulate.accuracy import task_bytes
from lfcal.simulate.effects import CATALOGUE, Effect, effect_from
from lfcal.simulate.engines import Sampling
from lfcal.simulate.plane_task import EffectsLike, PlaneTask, budgeted, describe

if TYPE_CHECKING:
    from lfcal.work import RunChoice

__all__ = ["Simulation", "TaskPlane", "effects_from_records", "effects_to_records", "iter_simulate_psf", "simulate_psf"]

MEMORY_LIMIT = 6 << 30
"""Largest H that is computed in memory (bytes); a file has no such limit."""


class Simulation(PlaneSource):
    """Source that simulates the planes of one H.

    Parameters
    ----------
    plan, effects, level, tolerance, sampling
        As in `simulate_psf`.
    provenance
        Provenance to store with H, in addition to the plan and to `Simulation.provenance`.
    """

    title = "simulate"
    in_order = True

    def __init__(
        self,
        plan: ScanPlan,
        effects: EffectsLike,
        level: str,
        tolerance: float | None,
        sampling: Sampling | None,
        *,
        provenance: Mapping[str, Any] | None = None,
    ) -> None:
        self.plan, self.level, self.sampling = plan, level, sampling
        self.budget = budgeted(effects, plan, tolerance)
        self.header = header_of(plan, {**self.provenance(), **(provenance or {})})

    def iter_plane(self, z: int, zeros: Zeros, workers: int | None, *, alone: bool = False) -> Work[Plane]:
        """Compute and return plane ``z``, yielding the progress in rows; see `PlaneSource.iter_plane`."""
        return (yield from TaskPlane(self.task(z)).iter_plane(z, zeros, workers, alone=alone))

    def reopening(self, z: int, stored: Stored) -> Reopening | None:
        """Return the description from which another process can compute plane ``z``."""
        return TaskPlane(self.task(z)).reopening(z, stored)

    def task(self, z: int) -> PlaneTask:
        """Return the `PlaneTask` with all inputs from which plane ``z`` is computed."""
        chosen, share = self.budget.at(self.plan.depths_um[z])
        return PlaneTask(self.plan, z, chosen, self.level, share, self.budget.tolerance - share, self.sampling)

    def provenance(self) -> dict[str, Any]:
        """Return the effects on H, the level, the tolerance and the factors of resampling, as plain JSON types.

        For effects that are not on in every plane, the indices of their planes are included.
        """
        plan, budget = self.plan, self.budget
        on = [{e.name for e in budget.at(z_um)[0]} for z_um in plan.depths_um]
        shown = [e for e in budget.effects if e.acts_on.enters_h and any(e.name in names for names in on)]
        details: dict[str, Any] = {"effects": describe(shown)}
        # list the planes of effects that are not on everywhere
        planes = {e.name: [z for z, names in enumerate(on) if e.name in names] for e in shown}
        if partly := {name: found for name, found in planes.items() if len(found) < len(on)}:
            details["effect_planes"] = partly
        found: dict[str, Any] = {"simulated": {**details, "level": self.level, "tolerance": budget.tolerance}}
        if plan.resample:
            found["cutout"] = {"scale": list(plan.resample_factors)}
        return found


class TaskPlane(PlaneSource):
    """One plane of an H, in a form that any process can compute."""

    def __init__(self, task: PlaneTask) -> None:
        self.task, self.header = task, header_of(task.plan, {})

    def iter_plane(self, z: int, zeros: Zeros, workers: int | None, *, alone: bool = False) -> Work[Plane]:
        """Compute and return the plane, yielding the progress in rows; see `PlaneSource.iter_plane`."""
        plan, values = self.task.plan, zeros()
        made = yield from self.task.compute(values, workers)
        return Plane(values, Facts.of(plan.period, plan.cutout, error=made.error), simulated=made.record)

    def reopening(self, z: int, stored: Stored) -> Reopening:
        """Return the description from which another process can compute the plane, as plain JSON types."""
        task, stepped = self.task, stored.store_tolerance is not None
        values = {
            "plan": task.plan.to_dict(),
            "z": z,
            "effects": effects_to_records(task.effects),
            "level": task.level,
            "tolerance": task.tolerance,
            "left_out": task.left_out,
            "sampling": None if task.sampling is None else dataclasses.asdict(task.sampling),
        }
        opener = f"{__name__}:{open_plane.__name__}"
        return Reopening(opener, values, concurrent_bytes=task_bytes(task, stepped=stepped))


def open_plane(values: Mapping[str, Any], workers: int) -> TaskPlane:
    """Return the source of a plane, from the values of `TaskPlane.reopening`; ``workers`` is ignored."""
    given = {
        "plan": ScanPlan.from_dict(values["plan"]),
        "effects": effects_from_records(values["effects"]),
        "sampling": None if values["sampling"] is None else Sampling(**values["sampling"]),
    }
    return TaskPlane(PlaneTask(**{**values, **given}))


def header_of(plan: ScanPlan, provenance: Mapping[str, Any]) -> Header:
    """Return the description of an H of ``plan``, without its values."""
    return Header(plan.shape, plan.depths_um, plan.camera, plan.anchor, provenance)


def effects_to_records(effects: Iterable[Effect]) -> list[dict[str, Any]]:
    """Return effects as plain JSON types, from which `effects_from_records` recreates them.

    Raises
    ------
    InputError
        If the class of an effect is not in the catalogue under the effect's name.
    """
    chosen = tuple(effects)
    for effect in chosen:
        if effect.name not in CATALOGUE or CATALOGUE.get(effect.name) is not type(effect):
            raise InputError.expected(
                f"effect {effect.name}", "a known effect", type(effect).__name__, "register it with lfcal.effects"
            )
    found: list[dict[str, Any]] = plain(describe(chosen))
    return found


def effects_from_records(records: Iterable[Mapping[str, Any]]) -> tuple[Effect, ...]:
    """Return the effects in records made by `effects_to_records`."""
    return tuple(
        effect_from(one["name"], {key: value for key, value in one.items() if key != "name"}) for one in records
    )


def iter_simulate_psf(
    plan: ScanPlan,
    effects: EffectsLike = "auto",
    level: str = "auto",
    *,
    tolerance: float | None = None,
    sampling: Sampling | None = None,
    out: str | os.PathLike[str] | None = None,
    dtype: str = "float32",
    compression: str = "gzip",
    workers: int | None = None,
    provenance: Mapping[str, Any] | None = None,
    store_tolerance: float | None = None,
    run: RunChoice | None = None,
) -> Work[PSFMatrix]:
    """Simulate the PSF matrix H of a scan plan with the plan's camera, and return it.

    Values of H are fractions of the light that passes the iris. The sum of a response over an infinite cutout is the
    fraction that the lenslets transmit. Effects on the motion and on the sensor frame are not part of H. They are part
    of the frames (`SimulatedCamera`), from which `assemble` computes an H that agrees with this one except for these
    effects and noise.

    Parameters
    ----------
    plan
        Camera, period, cutout, depths and anchor. H has the shape ``plan.shape`` and the axes (z, y, x, t, s): depth,
        source position (row, column) and pixel of the cutout (row, column). If the plan resamples its frames, the
        pixels of H are those of the resampled frames, over whose area light is integrated.
    effects
        A tuple of effects, ``()`` for the ideal camera; an `EffectSelection`; or ``"auto"``: the effects that
        `plan_effects` finds necessary for ``tolerance``.
    level
        Engine: ``"geometric"``, ``"wave"``, ``"grid"``, ``"microscope"`` or ``"reference"``; ``"auto"`` traces rays
        unless an effect requires wave optics.
    tolerance
        Allowed relative L1 error, from omitted effects and computation together. None: that of the `EffectSelection` if
        one is given, otherwise 0.03 (`USUAL_TOLERANCE`). The error that each plane reached is measured at a few
        positions and stored with the plane.
    sampling
        Sampling of the engine. None: chosen for the tolerance.
    out
        H file to write, plane by plane. None: H is kept in memory.
    dtype, compression
        As in `PSFWriter`.
    workers
        Number of threads, among which the source rows are divided. None: one for each available CPU core.
    provenance
        Additional provenance to store in the file, as plain JSON types.
    store_tolerance
        Only for a file, instead of ``dtype``: relative L1 error that lossy compression may cause in each pattern; see
        `PSFWriter`.
    run
        Settings for computing the planes of a file as separate work units: the executor, and what to do with units left
        by an earlier run. If the run is stopped, finished units are kept. All effects must be from the catalogue. None:
        no units.

    Yields
    ------
    Progress
        Counted in source rows; closing the generator leaves no incomplete file.

    Returns
    -------
    PSFMatrix
        H in memory, or opened from the file ``out``.

    Raises
    ------
    InputError
        If the plan and the effects are incompatible, or H is too large for memory.
    EnergyError
        If a response contains more light than its input, because the sampling is too coarse.
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import iter_simulate_psf
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(2.0),), anchor=(160, 160))
    >>> for step in iter_simulate_psf(plan, effects=()):
    ...     print(step.stage, step.count)
    simulate plane 1 of 1 0 of 3
    simulate plane 1 of 1 3 of 3
    """
    work = Simulation(plan, effects, level, tolerance, sampling, provenance=provenance)
    if out is None:
        _check_memory(plan)
    return (yield from iter_make(work, out, Stored(dtype, compression, store_tolerance), run=run, workers=workers))


simulate_psf = drained(
    iter_simulate_psf,
    """
    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import simulate_psf
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(2.0),), anchor=(160, 160))
    >>> H = simulate_psf(plan, effects=())
    >>> print(H.shape, f"{H.plane(0)[1, 2].sum():.2f} of the light passes the round lenslets")
    (1, 3, 5, 41, 41) 0.84 of the light passes the round lenslets
    """,
)


def _check_memory(plan: ScanPlan) -> None:
    need = int(np.prod(plan.shape, dtype=np.int64)) * 4
    if need > MEMORY_LIMIT:
        limit = f"at most {format_bytes(MEMORY_LIMIT)}"
        raise InputError.expected("memory of H", limit, format_bytes(need), "give a file with out=")
