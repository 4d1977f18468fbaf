"""H by simulation in units of a plane each: many at a time, and whole after a kill."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.camera import Camera, ScanPlan
from lfcal.errors import InputError
from lfcal.files import require_space
from lfcal.plain import plain
from lfcal.progress import Work
from lfcal.psf import PSFMatrix, open_psf
from lfcal.psf.facts import Facts
from lfcal.psf.joining import iter_join
from lfcal.psf.layout import Stored
from lfcal.psf.store import PSFWriter, stored_bytes
from lfcal.simulate.accuracy.memory import task_bytes
from lfcal.simulate.effects import CATALOGUE
from lfcal.simulate.effects.base import Effect
from lfcal.simulate.effects.described import effect_from
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.simulate import EffectsLike, PlaneTask, Simulation, describe
from lfcal.work import RunChoice, Unit, iter_made

__all__ = ["do_plane", "effects_told", "iter_simulate_units", "told_effects", "unit_of"]


def iter_simulate_units(
    camera: Camera,
    plan: ScanPlan,
    effects: EffectsLike = "auto",
    level: str = "auto",
    *,
    run: RunChoice,
    tolerance: float | None = None,
    sampling: Sampling | None = None,
    out: str | os.PathLike[str],
    dtype: str = "float32",
    compression: str = "gzip",
    provenance: Mapping[str, Any] | None = None,
    store_tolerance: float | None = None,
) -> Work[PSFMatrix]:
    """Simulate H into a file, each plane in a file of its own until all are there; values as of `simulate_psf`.

    Parameters
    ----------
    camera, plan, effects, level, tolerance, sampling, out, dtype, compression, provenance, store_tolerance
        As in `simulate_psf`; effects are those of the catalogue.
    run
        By whom, and what becomes of an earlier run.

    Raises
    ------
    InputError, EnergyError, StorageError
        As `simulate_psf` and `lfcal.work.iter_made`; the planes that are done stay for the next run.
    """
    work = Simulation(camera, plan, effects, level, tolerance, sampling, run.workers)
    target = Path(out)
    require_space(
        target.parent, stored_bytes(plan.shape, Stored(dtype, compression, store_tolerance)), what=target.name
    )
    stored = {"dtype": dtype, "compression": compression, "store_tolerance": store_tolerance}
    units = [unit_of(work.task(z), stored) for z in range(plan.shape[0])]
    writer = work.writer(target, dtype, compression, provenance, store_tolerance)
    join, title = partial(iter_join, writer=writer), f"simulate {target.name}"
    yield from iter_made(units, target, run, join, title=title, in_order=True)
    return open_psf(target)


def unit_of(task: PlaneTask, stored: Mapping[str, Any]) -> Unit:
    """Return the unit that computes a plane, stored as ``stored`` says (dtype, compression, store_tolerance)."""
    sampling = None if task.sampling is None else dataclasses.asdict(task.sampling)
    arguments = {
        "plan": task.plan.to_dict(),
        "z": task.z,
        "effects": told_effects(task.effects),
        "level": task.level,
        "tolerance": task.tolerance,
        "left_out": task.left_out,
        "sampling": sampling,
        **stored,
    }
    stepped = stored.get("store_tolerance") is not None
    # plain lists and numbers, as they are on the other side of a file or a network
    return Unit(
        f"plane {task.z:04d}",
        f"{__name__}:{do_plane.__name__}",
        plain(arguments),
        beside_bytes=task_bytes(task, stepped=stepped),
    )


def told_effects(effects: Iterable[Effect]) -> list[dict[str, Any]]:
    """Return effects as text that another process finds them by.

    Raises
    ------
    InputError
        For one that is not found again by its name.
    """
    chosen = tuple(effects)
    for effect in chosen:
        if effect.name not in CATALOGUE or CATALOGUE.get(effect.name) is not type(effect):
            raise InputError.expected(
                f"effect {effect.name}", "one of the catalogue", type(effect).__name__, "register it (lfcal.effects)"
            )
    found: list[dict[str, Any]] = plain(describe(chosen))
    return found


def effects_told(said: Iterable[Mapping[str, Any]]) -> tuple[Effect, ...]:
    """Return the effects of which `told_effects` told."""
    return tuple(effect_from(one["name"], {key: value for key, value in one.items() if key != "name"}) for one in said)


def do_plane(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Compute one plane and write it to an H file of its own: the task of a unit."""
    values = dict(arguments)
    plan = ScanPlan.from_dict(values["plan"])
    stored = {key: values[key] for key in ("dtype", "compression", "store_tolerance") if key in values}
    effects = effects_told(values["effects"])
    sampling = None if values["sampling"] is None else Sampling(**values["sampling"])
    task = PlaneTask(plan, values["z"], effects, values["level"], values["tolerance"], values["left_out"], sampling)
    plane = np.zeros(plan.shape[1:], np.float32)
    made = yield from task.compute(plane, workers)
    with PSFWriter(
        out, (1, *plan.shape[1:]), depths=[plan.depths_um[task.z]], camera=plan.camera, workers=workers, **stored
    ) as writer:
        facts = Facts.of(plan.period, plan.cutout, error=made.error)
        writer.write_plane(0, plane, facts=facts, simulated=made.record)
