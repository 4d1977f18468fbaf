"""H from frames in units of a plane each: what is done stays where it is stopped, fails, or is killed.

What is found from many frames is found once, before the units: damaged frames, which way up they are, the cutout. A
unit is a whole plane, no part of one: the scale of its samples is that of its brightest, and planes are joined as they
are stored.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from lfcal.camera import ScanPlan
from lfcal.errors import InputError
from lfcal.files import require_space
from lfcal.frames.source import FrameSource
from lfcal.plain import plain
from lfcal.progress import Clock, Work
from lfcal.psf.assemble_plan import AssemblySettings, find_plan_cutout, known_of
from lfcal.psf.assembly import Assembly, AssemblyProgress
from lfcal.psf.assembly_report import AssemblyReport
from lfcal.psf.filling import Fill
from lfcal.psf.joining import iter_join
from lfcal.psf.layout import Stored
from lfcal.psf.opening import open_psf
from lfcal.psf.store import PSFWriter, stored_bytes
from lfcal.work import RunChoice, Unit, iter_made
from lfcal.work.held import Held

__all__ = ["AssemblyTool", "do_plane", "iter_assemble_units", "iter_one_plane"]

STORED = ("dtype", "compression", "store_tolerance")
"""Settings of how values are stored."""


@dataclass(frozen=True, eq=False)
class AssemblyTool:
    """What the planes of an H share, made once in each process; ``close`` lets go of its frames."""

    plan: ScanPlan
    assembly: Assembly
    fill: Fill | None
    close: Callable[[], None]


_HELD: Held[AssemblyTool] = Held(lambda tool: tool.close())


def iter_assemble_units(
    source: FrameSource,
    plan: ScanPlan,
    out: str | os.PathLike[str],
    settings: AssemblySettings | None = None,
    *,
    told: Mapping[str, Any],
    run: RunChoice,
    task: str = "",
    provenance: Mapping[str, Any] | None = None,
    fill: Fill | None = None,
) -> Work[AssemblyReport]:
    """Assemble H into a file as `lfcal.psf.assemble_plan.iter_assemble_plan` does, plane by plane.

    Parameters
    ----------
    source, plan, out, settings, provenance, fill
        As there.
    told
        What tells these frames from any others, plain JSON types: where they lie, a stamp of their files
        (`lfcal.work.unit.stamp_of`), their corrections.
    run
        By whom, and what becomes of an earlier run.
    task
        A unit's task in other processes, which opens the frames by what is ``told`` and calls `iter_one_plane`; empty:
        only threads of this one can do them.

    Raises
    ------
    InputError, FileFormatError, StorageError
        As that does, and `lfcal.work.iter_made`; the planes that are done stay for the next run.
    """
    settings, target = settings or AssemblySettings(), Path(out)
    cutout = find_plan_cutout(source, plan, settings)
    assembly = Assembly(source, plan.shape[:3], cutout, strict=settings.strict)
    found = replace(settings, cutout=cutout.shape, keep_pedestal=True, workers=None)
    noise = None if assembly.noise is None else list(assembly.noise)
    shared = {**told, "settings": plain(found), "noise": noise}
    history = assembly.history(known_of(source, plan, provenance))
    stored = {name: shared["settings"][name] for name in STORED}
    writer = assembly.writer(
        target, history, depths=plan.depths_um, camera=plan.camera, workers=settings.workers, **stored
    )
    # before any plane is made: each is a file of its own until all are there
    require_space(target.parent, stored_bytes(writer.shape, Stored(**stored)), what=target.name)
    task = task or f"{__name__}:{do_plane.__name__}"
    units = [Unit(f"plane {z:04d}", task, shared | {"z": z}) for z in range(plan.shape[0])]
    join = partial(iter_join, writer=writer)
    with _HELD.lent(_key(shared), AssemblyTool(plan, assembly, fill, lambda: None)):
        made = iter_made(units, target, run, join, title=f"assemble {target.name}")
        yield from _shown(made, assembly)
    return assembly.report(open_psf(target))


def _shown(work: Work[None], assembly: Assembly) -> Work[None]:
    """Pass on progress with what is there of H, as far as this process makes it."""
    try:
        for record in work:
            at = assembly.filled
            if at is None:
                yield record
                continue
            known = (record.done, record.total, record.stage, record.seconds, record.note, record.per)
            yield AssemblyProgress(*known, plane=at[0], energy=at[1])
    finally:
        work.close()


def do_plane(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Assemble one plane into an H file of its own from frames that this process has open: the task of a unit."""
    return iter_one_plane(arguments, out, workers, _nobody)


def _nobody(shared: Mapping[str, Any], workers: int) -> AssemblyTool:
    raise InputError.expected("executor", "threads of the process that has the frames open", "others", "use threads")


def iter_one_plane(
    arguments: Mapping[str, Any],
    out: Path,
    workers: int,
    make: Callable[[Mapping[str, Any], int], AssemblyTool],
) -> Work[None]:
    """Assemble the plane ``z`` of a unit's arguments into an H file; ``make`` opens the frames where they are not."""
    shared = {key: value for key, value in arguments.items() if key != "z"}
    tool = _HELD.get(_key(shared), lambda: make(shared, workers))
    z, plan, settings = int(arguments["z"]), tool.plan, arguments["settings"]
    clock = Clock(f"assemble plane {z}", tool.assembly.frames_of(z))
    yield clock.at(0)
    made = yield from tool.assembly.iter_plane(z, clock, fill=tool.fill, workers=workers)
    with PSFWriter(
        out,
        (1, *made.values.shape),
        depths=[plan.depths_um[z]],
        workers=workers,
        **{name: settings[name] for name in STORED},
    ) as writer:
        writer.write_plane(0, made.values, facts=made.facts, uncertainty=made.uncertainty)


def _key(shared: Mapping[str, Any]) -> str:
    return json.dumps(shared, sort_keys=True)
