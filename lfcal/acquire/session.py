"""Record a session, resume it, record positions of it again."""

from __future__ import annotations

import datetime
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.control import Control
from lfcal.acquire.errors import AcquisitionStopped
from lfcal.acquire.known import known_around
from lfcal.acquire.options import Options
from lfcal.acquire.origin import check_origin
from lfcal.acquire.preview import Preview
from lfcal.acquire.recording.durable import DiskGuard, FolderLock
from lfcal.acquire.recording.records import Kind, file_name
from lfcal.acquire.recording.slots import read_layout
from lfcal.acquire.recording.store import Store
from lfcal.acquire.runner import Observer, Outcome, Runner
from lfcal.acquire.schedule import Schedule
from lfcal.acquire.session_file import Devices, Run, SessionFile
from lfcal.camera import ScanPlan
from lfcal.devices.protocols import Rig
from lfcal.errors import InputError, LfcalError, StorageError
from lfcal.files import storage_errors
from lfcal.frames.source import Position
from lfcal.progress import Work, drain

__all__ = ["check_devices", "frame_dtype", "iter_record", "record"]


def iter_record(
    folder: Path,
    plan: ScanPlan,
    rig: Rig,
    options: Options | None = None,
    *,
    resume: bool = False,
    redo: Sequence[Position] | None = None,
    control: Control | None = None,
    preview: Preview | None = None,
    observers: tuple[Observer, ...] = (),
) -> Work[Outcome]:
    """Record ``plan`` into the session ``folder``; yields progress, returns how it ended.

    Parameters
    ----------
    folder
        A new or empty folder; with ``resume`` or ``redo`` that of an earlier session.
    plan, rig, options
        What, with which devices, how; by default the options of the session that goes on, or `Options()`.
    resume
        Go on where an earlier run was interrupted, after checking that plan, options, devices and the
        stage's origin are the same.
    redo
        Record these positions of a finished session again, into a file of their own; the later frame counts.
    control, preview, observers
        See `Runner`.

    Raises
    ------
    InputError, StorageError
        Before anything moves, and with nothing left behind.
    AcquisitionStopped
        When the session had to end early; it can be resumed.
    """
    control = control or Control()
    devices = check_devices(plan, rig)
    goes_on = resume or redo is not None
    _check_folder(folder, new=not goes_on)
    earlier = SessionFile.read(folder) if goes_on else None
    options = options or (earlier.options if earlier else Options())
    if earlier:
        earlier.check_same(plan, options, devices)  # before the lock, for the clearer message
    with _locked(folder):
        new = SessionFile(uuid.uuid4().hex, plan, options, devices)
        file, first = _prepare(folder, rig, new, resume=resume, redo=redo)
        outcome = Outcome("complete", 0, 0, 0.0)
        for run in range(first, len(file.recordings)):
            watching = _Watching(control, preview, observers)
            file, outcome = yield from _record_one(folder, file, run, rig, options, watching, check=resume)
            if outcome.how != "complete":
                break
        return outcome


def record(
    folder: Path,
    plan: ScanPlan,
    rig: Rig,
    options: Options | None = None,
    *,
    resume: bool = False,
    redo: Sequence[Position] | None = None,
    control: Control | None = None,
    observers: tuple[Observer, ...] = (),
) -> Outcome:
    """Record ``plan`` into the session ``folder``; see `iter_record`."""
    return drain(
        iter_record(folder, plan, rig, options, resume=resume, redo=redo, control=control, observers=observers)
    )


def check_devices(plan: ScanPlan, rig: Rig) -> Devices:
    """Return what the devices say of themselves; raise `InputError` if the camera is not the plan's."""
    devices = Devices.of(rig)
    if tuple(devices.sensor_shape) != tuple(plan.camera.sensor.shape):
        raise InputError.expected(
            f"sensor of {devices.camera}",
            f"{plan.camera.sensor.shape} pixels as in the plan",
            tuple(devices.sensor_shape),
            "correct the plan's camera, or choose the right one",
        )
    return devices


def frame_dtype(plan: ScanPlan, options: Options, devices: Devices) -> np.dtype[Any]:
    """Return the sample type of recorded frames: the camera's, or float32 where several exposures make one."""
    if not options.plain or plan.frames_averaged > 1:
        return np.dtype(np.float32)
    return np.dtype(np.uint8 if devices.bit_depth <= 8 else np.uint16)


def _check_folder(folder: Path, *, new: bool) -> None:
    if new and (folder / "session.json").exists():
        raise InputError.expected(
            str(folder), "a new folder", "a session", "choose another folder, or resume this session"
        )


def _prepare(
    folder: Path, rig: Rig, new: SessionFile, *, resume: bool, redo: Sequence[Position] | None
) -> tuple[SessionFile, int]:
    """Return the session, begun as ``new`` if there is none, and the first recording that is to be worked on."""
    if not resume and redo is None:
        _create(folder, new, 0, rig, new.options)
        return new, 0
    file = SessionFile.read(folder)
    file.check_same(new.plan, new.options, new.devices)  # again: another program may have been at it before the lock
    if redo is not None:
        positions = tuple(tuple(map(int, p)) for p in redo)
        name = file_name(Kind.POSITION, len(file.recordings))
        file = replace(file, recordings=(*file.recordings, name), redo=(*file.redo, positions))
        _create(folder, file, len(file.recordings) - 1, rig, new.options)
        return file, len(file.recordings) - 1
    return file, 0


def _create(folder: Path, file: SessionFile, run: int, rig: Rig, options: Options) -> None:
    """Lay out recording ``run`` and enter it in ``session.json``, or leave nothing."""
    schedule = _schedule(file, run)
    # limits and light are checked before anything is made
    Runner(rig, file.plan, options, schedule, _Nowhere(), np.ones(len(schedule), np.bool_))
    # the region is needed to place dark frames on the sensor
    attributes = {"session": file.identity, "roi": list(_roi_list(schedule)), "run": run}
    Store.create(folder, run, schedule, frame_dtype(file.plan, file.options, file.devices), attributes).close()
    try:
        file.write(folder)
    except BaseException:
        # files that no session.json names would stand in the way of the next attempt
        for kind in Kind:
            (folder / file_name(kind, run)).unlink(missing_ok=True)
        raise


class _Watching(NamedTuple):
    """Who steers a run and who sees its frames."""

    control: Control
    preview: Preview | None
    observers: tuple[Observer, ...]


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Make the session's folder and keep other programs out of it; a refused session leaves nothing behind."""
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    lock = FolderLock(folder)
    try:
        yield
    finally:
        lock.release()
        if not (folder / "session.json").exists():
            with suppress(OSError):
                lock.path.unlink(missing_ok=True)
                folder.rmdir()


def _record_one(
    folder: Path, file: SessionFile, run: int, rig: Rig, options: Options, watching: _Watching, *, check: bool
) -> Work[tuple[SessionFile, Outcome]]:
    """Record what recording ``run`` lacks, and note the stretch in ``session.json``."""
    schedule = _schedule(file, run)
    if not read_layout(folder / file.recordings[run]).in_place:  # packed, so it was complete
        count = schedule.count(Kind.POSITION)
        return file, Outcome("complete", count, count, 0.0)
    store = Store.open(folder, run, schedule, frame_dtype(file.plan, file.options, file.devices), file.identity)
    try:
        todo = store.todo()
        runner = Runner(
            rig,
            file.plan,
            options,
            schedule,
            store,
            todo,
            **watching._asdict(),
            low_space=DiskGuard(folder, options.keep_free_bytes),
            elapsed_s=store.elapsed_s,
            known=known_around(folder, _open_positions(file.plan, schedule, todo)) if not todo.all() or run else (),
            recorded={crc: _position(file.plan, flat) for crc, flat in store.checksums().items()},
        )
        latest = store.latest()
        if check and latest is not None and todo.any() and options.origin_tolerance_px is not None:
            check_origin(rig, file.plan, options, schedule, latest, watching.control)
        file = replace(file, runs=(*file.runs, Run(_now())))
        file.write(folder)  # before the first frame: a crash leaves the run as interrupted
        return (yield from _run_noted(folder, file, runner))
    finally:
        store.close()


def _run_noted(folder: Path, file: SessionFile, runner: Runner) -> Work[tuple[SessionFile, Outcome]]:
    """Run, and note in ``session.json`` how it ended."""
    try:
        outcome = yield from runner.run()
    except AcquisitionStopped as stop:
        _note(folder, file, "failed", stop.acknowledged, 0.0, str(stop))
        raise
    return _note(folder, file, outcome.how, outcome.acknowledged, outcome.seconds, ""), outcome


def _note(folder: Path, file: SessionFile, how: str, done: int, seconds: float, message: str) -> SessionFile:
    """Return the session with its last run closed; if a failed run cannot be noted, its own error counts."""
    last = replace(file.runs[-1], ended=_now(), how=how, acknowledged=done, seconds=seconds, message=message)
    file = replace(file, runs=(*file.runs[:-1], last))
    try:
        file.write(folder)
    except (LfcalError, OSError):
        if how != "failed":
            raise
    return file


def _schedule(file: SessionFile, run: int) -> Schedule:
    # an empty list stands for all positions
    redo = [Position(*p) for p in file.redo[run]] or None
    return Schedule.of(file.plan, file.options, redo)


def _open_positions(plan: ScanPlan, schedule: Schedule, todo: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which positions ``(nz, ny, nx)`` of the plan are still to do."""
    positions = np.zeros(plan.n_positions, np.bool_)
    positions[schedule.flat[todo & (schedule.kinds == Kind.POSITION)]] = True
    return positions.reshape(plan.shape[:3])


def _position(plan: ScanPlan, flat: int) -> Position:
    ny, nx = plan.period
    return Position(flat // (ny * nx), flat // nx % ny, flat % nx)


def _roi_list(schedule: Schedule) -> tuple[int, int, int, int]:
    roi = schedule.roi
    return roi.row, roi.column, roi.rows, roi.columns


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


class _Nowhere:
    """A sink that takes nothing."""

    def put(self, *_: Any) -> None:
        """Refuse."""
        raise StorageError("no recording is open; begin a session first")

    def sync(self, *_: Any) -> None:
        """Refuse."""
        self.put()
