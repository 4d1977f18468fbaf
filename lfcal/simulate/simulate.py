"""H by simulation: plane by plane, in memory or straight to a file."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera, ScanPlan
from lfcal.errors import InputError
from lfcal.progress import Clock, Progress, Work, drain
from lfcal.psf import PSFMatrix, open_psf
from lfcal.psf.facts import Facts
from lfcal.psf.store import PSFWriter
from lfcal.simulate.accuracy.cost import learn
from lfcal.simulate.accuracy.planner import FOR_EFFECTS, EffectSelection, plan_effects
from lfcal.simulate.effects.base import Effect
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.staging import outlook_of
from lfcal.threads import worker_count
from lfcal.units import format_bytes

__all__ = [
    "Budget",
    "Computed",
    "PlaneTask",
    "Simulation",
    "budgeted",
    "iter_simulate_psf",
    "simulate_psf",
    "tolerance_for",
]

MEMORY_LIMIT = 6 << 30
"""Largest H that is built in memory (bytes); a file has no such limit."""

BLOCK_BYTES = 64 << 20
"""Rows of responses that are computed between two reports of progress are about this large."""

USUAL_TOLERANCE = 0.03
"""Relative L1 error allowed where nothing says another."""

EffectsLike = Iterable[Effect] | EffectSelection | str


@dataclass(frozen=True, slots=True)
class Budget:
    """How a tolerance is split at each depth.

    Attributes
    ----------
    effects
        All that are on at any depth.
    tolerance
        Relative L1 error allowed in all.
    selection
        Which are on at which depth and what they leave out; None: the same effects everywhere, nothing left out.
    """

    effects: tuple[Effect, ...]
    tolerance: float
    selection: EffectSelection | None = None

    def at(self, z_um: float) -> tuple[tuple[Effect, ...], float]:
        """Return the effects at a depth, and the share of the tolerance that they leave to the computation."""
        chosen = self.selection
        if chosen is None:
            return self.effects, self.tolerance
        # a selection made for another tolerance must not use this one up
        left = max(self.tolerance - chosen.left_out[chosen.plane(z_um)], (1 - FOR_EFFECTS) * self.tolerance)
        return chosen.at(z_um), left


def tolerance_for(effects: object, tolerance: float | None) -> float:
    """Return ``tolerance`` where it is given; None: that of a selection of effects, else `USUAL_TOLERANCE`."""
    if tolerance is not None:
        return tolerance
    return effects.tolerance if isinstance(effects, EffectSelection) else USUAL_TOLERANCE


def budgeted(effects: EffectsLike, plan: ScanPlan, tolerance: float | None) -> Budget:
    """Return the budget of effects as given, of those a selection has on, or of those that ``"auto"`` finds necessary.

    Nothing is known to be left out beside effects that are given. ``tolerance`` is as in `tolerance_for`.
    """
    tolerance = tolerance_for(effects, tolerance)
    if isinstance(effects, str):
        if effects != "auto":
            raise InputError.expected("effects", "effects, an EffectSelection or 'auto'", repr(effects), "correct it")
        effects = plan_effects(plan.camera, plan, tolerance)
    if isinstance(effects, EffectSelection):
        return Budget(effects.effects, tolerance, effects)
    chosen = tuple(effects)
    for effect in chosen:
        if not isinstance(effect, Effect):
            raise InputError.expected("effects", "effect objects", type(effect).__name__, "see lfcal.simulate")
    return Budget(chosen, tolerance)


def describe(effects: Iterable[Effect]) -> list[dict[str, Any]]:
    """Return the effects with their magnitudes as plain JSON types, for provenance."""
    return [{"name": e.name, **dataclasses.asdict(e)} for e in effects]  # type: ignore[call-overload]


class Computed(NamedTuple):
    """What is known of a plane that was computed.

    Attributes
    ----------
    error
        Relative L1 error: what is left out, as estimated, and the computation, as measured.
    record
        ``engine``, ``sampling`` and ``seconds`` (elapsed), for provenance.
    """

    error: float
    record: dict[str, Any]


@dataclass(frozen=True)
class PlaneTask:
    """One plane of an H, and all that decides its values.

    Attributes
    ----------
    plan, z
        The plan and the number of the plane.
    effects
        Those that are on at this plane.
    level, sampling
        As in `simulate_psf`.
    tolerance
        Relative L1 error that the computation may have.
    left_out
        The error of effects that are left out, as estimated.
    """

    plan: ScanPlan
    z: int
    effects: tuple[Effect, ...]
    level: str
    tolerance: float
    left_out: float
    sampling: Sampling | None

    def compute(self, out: NDArray[np.float32], workers: int | None) -> Work[Computed]:
        """Compute the plane into ``out`` ``(ny, nx, nt, ns)``, zeroed."""
        begun, cpu = time.perf_counter(), time.process_time()
        response = PlaneResponse(
            self.plan, self.z, self.effects, level=self.level, tolerance=self.tolerance, sampling=self.sampling
        )
        name = f"simulate plane {self.z + 1} of {self.plan.shape[0]}"
        yield from _plane(out, response, name, worker_count(workers))
        outlook, rays = outlook_of(self.plan, self.z), response.level == "geometric"
        lost = sum(e.estimate(outlook).error for e in self.effects if rays and e.needs_waves)
        elapsed, count = time.perf_counter() - begun, worker_count(workers)
        # of the process's time no more than its workers can have taken
        learn(outlook, response.level, self.tolerance, response.runs, min(time.process_time() - cpu, count * elapsed))
        seconds = round(elapsed, 3)
        record = {"engine": response.level, "sampling": response.sampling_used, "seconds": seconds}
        return Computed(response.reached + self.left_out + lost, record)


class Simulation:
    """What computes the planes of one H.

    Parameters
    ----------
    camera, plan, effects, level, tolerance, sampling, workers
        As in `simulate_psf`.
    """

    def __init__(
        self,
        camera: Camera,
        plan: ScanPlan,
        effects: EffectsLike,
        level: str,
        tolerance: float | None,
        sampling: Sampling | None,
        workers: int | None,
    ) -> None:
        _check_plan(camera, plan)
        self.plan, self.level, self.sampling = plan, level, sampling
        self.budget = budgeted(effects, plan, tolerance)
        self.workers = workers

    def plane(self, z: int, out: NDArray[np.float32]) -> Work[Computed]:
        """Compute plane ``z`` into ``out`` ``(ny, nx, nt, ns)``, zeroed."""
        return (yield from self.task(z).compute(out, self.workers))

    def task(self, z: int) -> PlaneTask:
        """Return all that plane ``z`` is computed from."""
        chosen, share = self.budget.at(self.plan.depths_um[z])
        return PlaneTask(self.plan, z, chosen, self.level, share, self.budget.tolerance - share, self.sampling)

    def writer(
        self,
        out: str | os.PathLike[str],
        dtype: str,
        compression: str,
        provenance: Mapping[str, Any] | None,
        store_tolerance: float | None = None,
    ) -> PSFWriter:
        """Return what writes this H to a file, with what it can be simulated again from; not yet entered."""
        plan = self.plan
        return PSFWriter(
            out,
            plan.shape,
            depths=plan.depths_um,
            camera=plan.camera,
            anchor=plan.anchor,
            dtype=dtype,
            compression=compression,
            provenance={**self.provenance(), **(provenance or {})},
            workers=self.workers,
            store_tolerance=store_tolerance,
        )

    def provenance(self) -> dict[str, Any]:
        """Return what H can be simulated again from."""
        plan, budget = self.plan, self.budget
        on = [{e.name for e in budget.at(z_um)[0]} for z_um in plan.depths_um]
        shown = [e for e in budget.effects if e.acts_on.enters_h and any(e.name in names for names in on)]
        details: dict[str, Any] = {"effects": describe(shown)}
        # effects that are not on at every plane name theirs
        planes = {e.name: [z for z, names in enumerate(on) if e.name in names] for e in shown}
        if partly := {name: found for name, found in planes.items() if len(found) < len(on)}:
            details["effect_planes"] = partly
        found: dict[str, Any] = {"simulated": {**details, "level": self.level, "tolerance": budget.tolerance}}
        if plan.resample:
            found["cutout"] = {"scale": list(plan.resample_factors)}
        return found


def iter_simulate_psf(
    camera: Camera,
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
) -> Work[PSFMatrix]:
    """Simulate H as `simulate_psf`; yields progress in rows, and closing it leaves nothing half-written.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import iter_simulate_psf
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(2.0),), anchor=(160, 160))
    >>> for step in iter_simulate_psf(camera, plan, effects=()):
    ...     print(step.stage, step.count)
    simulate plane 1 of 1 0 of 3
    simulate plane 1 of 1 3 of 3
    """
    work = Simulation(camera, plan, effects, level, tolerance, sampling, workers)
    if out is None:
        # Kept with it, so that H can be simulated again.
        details = work.provenance()
        whole = _in_memory(plan)
        computed: list[Computed] = []
        for z in range(len(whole)):
            computed.append((yield from work.plane(z, whole[z])))
        facts = Facts.of(plan.shape[:3], plan.cutout, error=[one.error for one in computed])
        details["simulated"]["planes"] = [one.record for one in computed]
        details |= provenance or {}
        return PSFMatrix(
            whole, depths=plan.depths_um, camera=camera, anchor=plan.anchor, provenance=details, facts=facts
        )
    with work.writer(out, dtype, compression, provenance, store_tolerance) as writer:
        plane = np.empty(plan.shape[1:], np.float32)
        for z in range(plan.shape[0]):
            # The buffer of one plane is used for all: a file of any size takes the memory of one.
            plane[:] = 0
            made = yield from work.plane(z, plane)
            facts = Facts.of(plan.period, plan.cutout, error=made.error)
            writer.write_plane(z, plane, facts=facts, simulated=made.record)
    return open_psf(Path(out))


def _in_memory(plan: ScanPlan) -> NDArray[np.float32]:
    need = int(np.prod(plan.shape, dtype=np.int64)) * 4
    if need > MEMORY_LIMIT:
        limit = f"at most {format_bytes(MEMORY_LIMIT)}"
        raise InputError.expected("H in memory", limit, format_bytes(need), "name a file with out=")
    return np.zeros(plan.shape, np.float32)


def simulate_psf(
    camera: Camera,
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
) -> PSFMatrix:
    """Return H of ``camera`` for a scan plan, by simulation.

    Values are shares of the light that passes the iris towards the lenslets: the sum over an infinite cutout is
    what the lenslets let through. Effects on the motion and on the sensor frame do not enter H: they belong to
    the frames (`SimulatedCamera`), from which assembly makes an H that equals this one up to its noise.

    Parameters
    ----------
    camera
        The camera; the plan's own.
    plan
        Period, cutout, depths and anchor: H has shape ``plan.shape``, axes (z, y, x, t, s). Where the plan resamples
        its frames, pixels of H are those of the resampled frames: light is integrated over their area.
    effects
        A tuple of effects, ``()`` for the ideal camera; an `EffectSelection`; or ``"auto"``: what `plan_effects`
        finds necessary for ``tolerance``.
    level
        ``"geometric"``, ``"wave"``, ``"grid"``, ``"microscope"``, ``"reference"``, or ``"auto"``: rays unless an effect
        calls for waves.
    tolerance
        Relative L1 error allowed, of what is left out and of the computation together; None: that of the selection
        of effects, else `USUAL_TOLERANCE`. What each plane reached, by a probe of a few positions, is stated in its
        facts.
    sampling
        How finely to compute; None: what the tolerance needs.
    out
        H file to write, streamed plane by plane; None keeps H in memory.
    dtype, compression
        As in `PSFWriter`.
    workers
        Threads over source rows; None takes all processors.
    provenance
        Further provenance to keep in the file; plain JSON types.
    store_tolerance
        In a file, in place of ``dtype``: the share (L1) that each pattern may lack beside what was computed; see
        `PSFWriter`.

    Returns
    -------
    PSFMatrix
        In memory, or opened from ``out``.

    Raises
    ------
    InputError
        If plan, camera and effects do not fit, or H is too large for memory.
    EnergyError
        If more light came out of a response than went in: the sampling is too coarse.
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import simulate_psf
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(2.0),), anchor=(160, 160))
    >>> H = simulate_psf(camera, plan, effects=())
    >>> print(H.shape, f"{H.plane(0)[1, 2].sum():.2f} of the light passes the round lenslets")
    (1, 3, 5, 41, 41) 0.84 of the light passes the round lenslets
    """
    return drain(
        iter_simulate_psf(
            camera,
            plan,
            effects,
            level,
            tolerance=tolerance,
            sampling=sampling,
            out=out,
            dtype=dtype,
            compression=compression,
            workers=workers,
            provenance=provenance,
            store_tolerance=store_tolerance,
        )
    )


def _check_plan(camera: Camera, plan: ScanPlan) -> None:
    """Raise `InputError` unless H of ``plan`` can be computed for ``camera``."""
    if camera != plan.camera:
        raise InputError.expected(
            "camera", f"the plan's ({plan.camera.name})", camera.name, "make the plan for this camera"
        )


def _plane(out: NDArray[np.float32], response: PlaneResponse, name: str, workers: int) -> Iterable[Progress]:
    """Compute one plane into ``out`` ``(ny, nx, nt, ns)``, zeroed; yield progress."""
    ny, nx = out.shape[:2]
    # Whatever the number of threads: rows of a block mirror each other, and another block is other rounding. An even
    # number, for they come in pairs.
    block = min(ny, max(2, BLOCK_BYTES // max(1, out[0].nbytes) // 2 * 2))
    clock = Clock(name, ny * response.runs)
    yield clock.at(0)
    for done in response.accumulate(out, np.arange(ny), np.arange(nx), block=block, workers=workers):
        yield clock.at(done)
