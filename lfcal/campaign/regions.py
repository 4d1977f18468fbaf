"""Record several regions of the field as one session: a folder with a session per region.

Each region is read out on its part of the sensor, with separate dark frames, and is stored as safely as any session.
Together they have one plan, one command and one H file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from lfcal.acquire import (
    NAME,
    Control,
    Observer,
    Options,
    Outcome,
    Preview,
    SessionForecast,
    check_new,
    forecast,
    iter_record,
    keep_task,
)
from lfcal.base import InputError, Work, read_text, storage_errors, sync_folder, write_text
from lfcal.camera import RegionPlan
from lfcal.devices import Rig
from lfcal.psf import PSFMatrix, open_psf, save_regions

__all__ = [
    "REGIONS_FILE",
    "first_begun",
    "forecast_regions",
    "is_regions",
    "iter_record_regions",
    "read_regions",
    "region_sessions",
    "save_parts",
    "temporary_parts",
]

REGIONS_FILE = "regions.json"
"""Name of the file with the plan in the folder of a session of several regions."""


def is_regions(folder: Path) -> bool:
    """Return whether ``folder`` contains a session of several regions."""
    return (folder / REGIONS_FILE).is_file()


def read_regions(folder: Path) -> RegionPlan:
    """Read the plan of the regions recorded in ``folder``.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from lfcal.acquire import Options
    >>> from lfcal.camera import RegionPlan, ScanPlan, preset
    >>> from lfcal.campaign import iter_record_regions, read_regions
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.base import drain
    >>> scan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(1, 2))
    >>> rig, options = simulated_rig(scan), Options(darks=0, reference_every=0)
    >>> _ = drain(iter_record_regions(Path("recorded there"), RegionPlan.spread(scan, (1, 2)), rig, options))
    >>> read_regions(Path("recorded there")).names  # by row and column; that nearest to the sensor's middle first
    ('r1c2', 'r1c1')
    """
    return RegionPlan.from_json(read_text(folder / REGIONS_FILE))


def first_begun(folder: Path) -> Path | None:
    """Return the folder of the first region of the session in ``folder`` that has a recording; None if none has."""
    return next((folder / n for n in read_regions(folder).names if (folder / n / NAME).exists()), None)


def forecast_regions(
    plan: RegionPlan, rig: Rig, options: Options, folder: Path, *, frames_per_s: float | None = None
) -> SessionForecast:
    """Return the forecast for all regions together, after checking each as in `lfcal.acquire.forecast`.

    Positions, frames, times and bytes are summed; other values are those of the first region. ``folder`` is the folder
    for all regions, and ``rig``, ``options`` and ``frames_per_s`` are as in `lfcal.acquire.forecast`.
    """
    names = enumerate(plan.names)
    found = [forecast(plan.plan(k), rig, options, folder / name, frames_per_s=frames_per_s) for k, name in names]
    summed = ["positions", "other_frames", "seconds", "recording_bytes"]
    summed += [] if frames_per_s is None else ["readout_seconds"]
    return replace(found[0], **{name: sum(getattr(one, name) for one in found) for name in summed})


def iter_record_regions(
    folder: Path,
    plan: RegionPlan,
    rig: Rig,
    options: Options | None = None,
    *,
    resume: bool = False,
    control: Control | None = None,
    preview: Preview | None = None,
    observers: Callable[[int], tuple[Observer, ...]] = lambda _: (),
    task: Mapping[str, Any] | None = None,
) -> Work[Outcome]:
    """Record every region of ``plan`` as a separate session in ``folder``, and return the combined outcome.

    If a region remains incomplete, the regions after it are not recorded.

    Parameters
    ----------
    folder
        A new or empty folder; with ``resume``, the folder of an earlier session.
    plan
        Regions to record.
    rig, options, control, preview, task
        As in `lfcal.acquire.iter_record`, which raises the same errors.
    resume
        Whether to continue with the first incomplete region, after a check of all regions.
    observers
        Function that takes the index of a region and returns the observers of its frames.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from lfcal.acquire import Options
    >>> from lfcal.camera import RegionPlan, ScanPlan, preset
    >>> from lfcal.campaign import iter_record_regions
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.base import drain
    >>> scan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(1, 2))
    >>> plan = RegionPlan.spread(scan, (1, 2))
    >>> done = drain(iter_record_regions(Path("new"), plan, simulated_rig(scan), Options(darks=0, reference_every=0)))
    >>> print(done.acknowledged, "positions in", len(plan), "regions")
    4 positions in 2 regions
    """
    control = control or Control()
    _begin(folder, plan, resume=resume)
    if task is not None:
        if not resume:
            keep_task(folder, task)
        task = {**task, "out": ".."}
    count, done, seconds, damaged = plan.scan.n_positions, 0, 0.0, 0
    notes: tuple[str, ...] = ()
    for k, name in enumerate(plan.names):
        own, there = folder / name, (folder / name / NAME).exists()
        how = options if options is not None or there else Options()
        seen: dict[str, Any] = {"control": control, "preview": preview, "observers": observers(k), "task": task}
        work = iter_record(own, plan.plan(k), rig, how, resume=there, **seen)
        outcome = yield from _shown(work, name, k * count, len(plan) * count)
        done, seconds, damaged = done + outcome.acknowledged, seconds + outcome.seconds, damaged + outcome.damaged
        notes = tuple(dict.fromkeys((*notes, *outcome.notes)))
        if outcome.how != "complete":
            break
    return Outcome(outcome.how, done, len(plan) * count, seconds, damaged, notes)


def _begin(folder: Path, plan: RegionPlan, *, resume: bool) -> None:
    """Create the session's folder with its plan, or compare the plan with the existing one."""
    if resume:
        if not is_regions(folder):
            raise InputError.expected(str(folder), f"a session of regions ({REGIONS_FILE})", "none", "check the path")
        if read_regions(folder) != plan:
            raise InputError.expected(
                str(folder),
                "the plan of the recorded session",
                "a plan that differs from it",
                "resume with the plan in this folder",
            )
        return
    check_new(folder)
    if is_regions(folder):
        raise InputError.expected(
            str(folder), "a new folder", "one with a session", "choose another folder, or resume this session"
        )
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / REGIONS_FILE, plan.to_json())
        sync_folder(folder)


def _shown(work: Work[Outcome], name: str, before: int, total: int) -> Work[Outcome]:
    """Yield the progress of one region as a part of the progress of all regions."""
    while True:
        try:
            record = next(work)
        except StopIteration as stop:
            outcome: Outcome = stop.value
            return outcome
        if record.stage == "record":
            record = replace(record, done=before + record.done, total=total, stage=f"record {name}")
        yield record


def region_sessions(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield the name and the folder of each region of a session.

    Raises
    ------
    InputError
        If the recording of a region was not started.
    """
    for name in read_regions(folder).names:
        if not (folder / name / NAME).exists():
            raise InputError.expected(f"{folder}: region {name}", "a recording", "none", "resume the session")
        yield name, folder / name


@contextmanager
def temporary_parts(out: Path, names: Sequence[str]) -> Iterator[dict[str, Path]]:
    """Provide, as a context manager, a temporary path for the H of each region, by its name.

    The paths are in a folder next to ``out`` that is removed when the context ends.
    """
    with storage_errors(out), TemporaryDirectory(prefix=f".{out.name}.regions-", dir=out.parent) as place:
        yield {name: Path(place) / f"{name}.h5" for name in names}


def save_parts(parts: dict[str, Path], out: Path, **settings: Any) -> Path:
    """Combine the H of several regions, given by name in ``parts``, into the file ``out`` and return its path.

    ``settings`` are further arguments of `lfcal.psf.save_regions`.
    """
    with ExitStack() as stack:
        matrices: dict[str, PSFMatrix] = {name: stack.enter_context(open_psf(path)) for name, path in parts.items()}
        return save_regions(matrices, out, **settings)
