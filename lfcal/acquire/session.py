"""Record a session, resume it, or record some of its positions again."""

from __future__ import annotations

import datetime
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire._looking import Looker
from lfcal.acquire.control import Control
from lfcal.acquire.errors import AcquisitionStopped
from lfcal.acquire.frame_plan import FramePlan
from lfcal.acquire.options import Options
from lfcal.acquire.preview import Preview
from lfcal.acquire.recording import (
    DiskGuard,
    FolderLock,
    Kind,
    RecordingFile,
    SessionReport,
    Store,
    file_name,
    iter_repair,
    iter_verify,
    recording_bytes,
)
from lfcal.acquire.runner import Observer, Outcome, RecordedNeighbour, Runner, recorded_neighbours
from lfcal.acquire.schedule import Schedule
from lfcal.acquire.session_file import Devices, Run, SessionFile, frame_dtype, keep_task
from lfcal.acquire.setup import iter_stage_check
from lfcal.acquire.spots import image_shift
from lfcal.acquire.suspending import Suspender
from lfcal.base import InputError, LfcalError, StorageError, Work, drained, format_pixels, require_space, storage_errors
from lfcal.camera import ScanPlan
from lfcal.devices import Rig
from lfcal.frames import Position

__all__ = ["check_devices", "check_fixed", "check_new", "iter_record", "record"]

CORRELATION = 0.8


def check_origin(
    rig: Rig,
    plan: ScanPlan,
    options: Options,
    schedule: Schedule,
    latest: tuple[int, NDArray[Any], NDArray[Any]],
    control: Control,
) -> None:
    """Raise `InputError` unless a new frame at the latest recorded position agrees with the recorded one.

    The shift of the image must not exceed `Options.origin_tolerance_px` in rows and columns (None: no check). The
    correlation of the two images must be at least `CORRELATION`.

    Parameters
    ----------
    rig, plan, options, schedule, control
        As in `Runner`.
    latest
        Slot, frame and record of the latest acknowledged position.
    """
    slot, before, note = latest
    tolerance = options.origin_tolerance_px
    if tolerance is None:
        return
    x, y, depth = (float(v) for v in note["target_um"])
    targets = np.array([[x, y, depth]])
    looker = Looker(rig, plan, options, control, targets=targets, roi=schedule.roi, bracket=options.bracket)
    looker.go((x, y, depth))
    z = schedule.position(int(note["index"])).z
    data = looker.expose(plan.exposures[z], plan.frames_averaged)
    top, left = int(note["row"]) - looker.roi.row, int(note["column"]) - looker.roi.column
    after = data[top : top + before.shape[0], left : left + before.shape[1]]
    what = f"image of the last recorded position (slot {slot})"
    remedy = "restore the stage's origin and the optics, or start a new session"
    try:
        down, right, correlation = image_shift(before, after)
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
    if max(abs(down), abs(right)) > tolerance:
        got = f"moved by ({down:.2f}, {right:.2f}) px"
        raise InputError.expected(what, f"the same position within {tolerance:g} px (row, column)", got, remedy)
    # an image at the same position may still differ: defocused, or of another spot
    if correlation < CORRELATION:
        raise InputError.expected(what, f"a correlation above {CORRELATION}", f"{correlation:.2f}", remedy)


R = TypeVar("R")


def iter_record(
    folder: Path,
    plan: ScanPlan | FramePlan,
    rig: Rig,
    options: Options | None = None,
    *,
    resume: bool = False,
    redo: Sequence[Position] | None = None,
    only: Sequence[Position] | None = None,
    kept_aside: Sequence[Position] = (),
    control: Control | None = None,
    preview: Preview | None = None,
    observers: tuple[Observer, ...] = (),
    task: Mapping[str, Any] | None = None,
) -> Work[Outcome]:
    """Record ``plan`` to the session ``folder``, and return how the run ended.

    Parameters
    ----------
    folder
        A new or empty folder; with ``resume`` or ``redo``, the folder of an earlier session.
    plan, rig, options
        Plan to record (a scan, or a `lfcal.targets.TargetPlan` of whole frames), devices, and settings. Options of None
        are the options of the session that is continued, or `Options()`.
    resume
        Whether to continue an interrupted run, after checking that plan, options, devices and the stage's origin and
        scale are unchanged. Every frame is checked first, and damaged frames are taken again. The new frames replace
        them in place, or are written to a separate file if the recording was packed.
    redo
        Positions (z, y, x) of a finished session to record again, to a separate file. Of several frames of a position,
        the latest is used. Positions that the session does not have are added. Whole frames are numbered as in
        `lfcal.acquire.frame_plan`.
    only
        Positions (z, y, x) of the scan to record; not allowed for a target. None: all.
    kept_aside
        Recorded positions (z, y, x) whose patterns are held out from a fit; not allowed for a target.
    control, preview, observers
        See `Runner`.
    task
        Task that requested the recording, from `lfcal.tasks.Task.to_dict`; stored with the session and with H made
        from it.

    Raises
    ------
    InputError, StorageError
        If the session cannot start; nothing has moved, and no files are left.
    InputError, DeviceError, Cancelled
        If the check of the stage fails (`lfcal.acquire.setup.iter_stage_check`), or if, on resuming, the last recorded
        position looks different. A new session leaves no files.
    AcquisitionStopped
        If the session had to end early; it can be resumed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from dataclasses import replace
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(2, 3))
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.acquire import iter_record
    >>> for step in iter_record(Path("watched"), plan, simulated_rig(plan)):
    ...     last = step
    >>> print(last.count, "frames")
    6 of 6 frames
    """
    control = control or Control()
    scan = plan.scan
    devices = check_devices(scan, rig)
    if scan is not plan and (only is not None or len(kept_aside)):
        raise InputError.expected(
            "positions to record",
            "none together with a target",
            f"{len(only or ()) + len(kept_aside)} positions",
            "leave them out, because the plan of the target determines them",
        )
    if not isinstance(plan, ScanPlan) and plan.lit is not None and not rig.switches:
        remedy = "show its images (lfcal plan target --patterns), and assemble the folder of frames"
        raise InputError.expected("plan", "a target that a stage moves", "frames of a display", remedy)
    goes_on = resume or redo is not None
    if not goes_on:
        check_new(folder)
    earlier = SessionFile.read(folder) if goes_on else None
    options = options or (earlier.options if earlier else Options())
    if earlier:
        earlier.check_same(plan, options, devices)  # before the lock, for the clearer message
    check_fixed(devices, options)
    gauges = Suspender(rig, options.bounds, options.steady_s)  # a missing one is reported before anything is made
    with _locked(folder) as lock:
        target = None if isinstance(plan, ScanPlan) else plan
        new = _new(SessionFile(uuid.uuid4().hex, scan, options, devices, target=target), only, kept_aside)
        file, first = _planned(folder, new, resume=resume, redo=redo)
        found, seen = None, None
        if resume:
            found = yield from iter_verify(folder)
            file = yield from _repaired(folder, file, rig, options, found)
        else:
            _check_possible(folder, file, first, rig, options)
        if found is None or any(part.whole < part.frames for part in found.files):
            seen = yield from iter_stage_check(rig, plan, options, control)
        if not resume:
            _create(folder, file, first, rig, options)
            if task is not None:
                keep_task(folder, task, first)
        outcome = Outcome("complete", 0, 0, 0.0)
        for run in range(first, len(file.recordings)):
            watching = _Watching(control, preview, observers, gauges, "" if seen is None else seen.words)
            work = _record_one(folder, file, run, rig, options, watching=watching, found=found)
            file, outcome = yield from _noted_holds(work, lock, control)
            if outcome.how != "complete":
                break
        return replace(outcome, damaged=0 if found is None else found.lost, notes=() if seen is None else seen.notes)


record = drained(
    iter_record,
    """
    Examples
    --------
    >>> from pathlib import Path
    >>> from dataclasses import replace
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(2, 3))
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.acquire import Options, Outcome, record
    >>> outcome: Outcome = record(Path("new"), plan, simulated_rig(plan), Options(darks=2))
    >>> print(outcome.how, outcome.acknowledged, "of", outcome.total)
    complete 6 of 6
    """,
)


def check_devices(plan: ScanPlan, rig: Rig) -> Devices:
    """Return the properties of the devices of ``rig``; raise `InputError` if the sensor's shape is not the plan's.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(2, 3))
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.acquire import check_devices
    >>> devices = check_devices(plan, simulated_rig(plan))
    >>> print(devices.camera, tuple(devices.sensor_shape))
    simulated camera (320, 320)
    """
    devices = Devices.of(rig)
    if tuple(devices.sensor_shape) != tuple(plan.camera.sensor.shape):
        raise InputError.expected(
            f"sensor of {devices.camera}",
            f"{format_pixels(plan.camera.sensor.shape)}, as in the plan",
            format_pixels(devices.sensor_shape),
            "correct the plan's camera, or choose the right one",
        )
    return devices


def check_fixed(devices: Devices, options: Options) -> None:
    """Raise `InputError` if the camera changes pixel values automatically, unless the options allow it."""
    if devices.automatic and not options.allow_automatic:
        raise InputError.expected(
            f"settings of {devices.camera}",
            "frames proportional to light",
            devices.automatic_words,
            "switch this off with the camera manufacturer's software, or record anyway (--allow-automatic)",
        )


def check_new(folder: Path) -> None:
    """Raise `InputError` if there is a session in ``folder``."""
    if (folder / "session.json").exists():
        raise InputError.expected(
            str(folder), "a new folder", "a session", "choose another folder, or resume this session"
        )


def _new(file: SessionFile, only: Sequence[Position] | None, kept_aside: Sequence[Position]) -> SessionFile:
    """Return the new session ``file`` for the positions ``only`` (None: all), with the positions ``kept_aside``."""
    aside = tuple(tuple(map(int, p)) for p in kept_aside)
    if only is None:
        return replace(file, kept_aside=aside)
    if not len(only):
        raise InputError.expected(
            "positions to record", "at least one", "an empty list", "leave the empty list out to record all positions"
        )
    positions = tuple(tuple(map(int, p)) for p in file.plan.in_scan_order(only).tolist())
    return replace(file, redo=(positions,), kept_aside=aside)


def _planned(
    folder: Path, new: SessionFile, *, resume: bool, redo: Sequence[Position] | None
) -> tuple[SessionFile, int]:
    """Return the session (``new`` if there is none), and the first recording to work on; creates no files."""
    if not resume and redo is None:
        return new, 0
    file = SessionFile.read(folder)
    # again: another program may have been at it before the lock
    file.check_same(new.target or new.plan, new.options, new.devices)
    if redo is not None:
        file = replace(file, kept_aside=tuple(dict.fromkeys((*file.kept_aside, *new.kept_aside))))
        return _with_recording(file, redo), len(file.recordings)
    return file, 0


def _with_recording(file: SessionFile, redo: Sequence[Position]) -> SessionFile:
    """Return the session with another recording, of the positions ``redo``; creates no files."""
    positions = tuple(tuple(map(int, p)) for p in redo)
    name = file_name(Kind.POSITION, len(file.recordings))
    return replace(file, recordings=(*file.recordings, name), redo=(*file.redo, positions))


def _repaired(folder: Path, file: SessionFile, rig: Rig, options: Options, found: SessionReport) -> Work[SessionFile]:
    """Return the session, ready to take damaged frames again; for packed recordings, into a separate recording."""
    again = yield from iter_repair(folder, file, found)
    if not again:
        return file
    file = _with_recording(file, again)
    _create(folder, file, len(file.recordings) - 1, rig, options)
    return file


def _check_possible(
    folder: Path, file: SessionFile, run: int, rig: Rig, options: Options
) -> tuple[Schedule, np.dtype[Any]]:
    """Return the steps of recording ``run`` and the sample type of its frames.

    Raises an error if the stage's limits, the light or the disk space do not allow the recording.
    """
    schedule = file.schedule(run)
    Runner(rig, file.plan, options, schedule, _Nowhere(), np.ones(len(schedule), np.bool_))
    dtype = frame_dtype(file.plan, file.options, file.devices)
    size = recording_bytes(schedule, dtype)
    require_space(folder, size + options.reserve(size), what="the recording and its reserve")
    return schedule, dtype


def _create(folder: Path, file: SessionFile, run: int, rig: Rig, options: Options) -> None:
    """Create the files of recording ``run`` and enter it in ``session.json``; an error leaves no files."""
    schedule, dtype = _check_possible(folder, file, run, rig, options)
    reserve = options.reserve(recording_bytes(schedule, dtype))
    Store.create(folder, run, schedule, dtype, file.attributes(run, schedule), reserve=reserve).close()
    try:
        file.write(folder)
    except BaseException:
        # files without a session.json would block the next attempt
        for kind in Kind:
            (folder / file_name(kind, run)).unlink(missing_ok=True)
        raise


class _Watching(NamedTuple):
    """Control, preview and observers of a run, its conditions for pauses, and the result of the stage check."""

    control: Control
    preview: Preview | None
    observers: tuple[Observer, ...]
    trouble: Callable[[], str]
    stage: str


@contextmanager
def _locked(folder: Path) -> Iterator[FolderLock]:
    """Create the session's folder and exclude other programs from it; a refused session leaves no folder behind."""
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    lock = FolderLock(folder)
    try:
        yield lock
    finally:
        lock.release()
        if not (folder / "session.json").exists():
            with suppress(OSError):
                lock.path.unlink(missing_ok=True)
                folder.rmdir()


def _record_one(
    folder: Path,
    file: SessionFile,
    run: int,
    rig: Rig,
    options: Options,
    *,
    watching: _Watching,
    found: SessionReport | None,
) -> Work[tuple[SessionFile, Outcome]]:
    """Record missing and damaged frames of recording ``run``, and note the run in ``session.json``."""
    schedule = file.schedule(run)
    dtype = frame_dtype(file.plan, file.options, file.devices)
    store = Store.open(folder, run, schedule, dtype, file.identity, _nothing if found is None else found.slots)
    try:
        todo = store.todo()
        if not store.writable:  # packed, so it was complete
            count = schedule.count(Kind.POSITION)
            return file, Outcome("complete", count, count, 0.0)
        full = DiskGuard(folder, options.reserve(recording_bytes(schedule, dtype)))
        if todo.any() and (why := full()):
            raise StorageError(f"{folder}: {why}, or keep less space free (--keep-free)")
        runner = Runner(
            rig,
            file.plan,
            options,
            schedule,
            store,
            todo,
            control=watching.control,
            preview=watching.preview,
            observers=watching.observers,
            trouble=lambda: full() or watching.trouble(),
            elapsed_s=store.elapsed_s,
            known=_known(folder, file, schedule, todo) if not todo.all() or run else (),
            recorded={crc: schedule.position(flat) for crc, flat in store.checksums().items()},
            whole_frames=file.target is not None,
        )
        if found is not None and todo.any():
            _check_origin(folder, file, rig, options, watching.control, found)
        file = replace(file, runs=(*file.runs, Run(_now(), recording=run, stage=watching.stage)))
        file.write(folder)  # before the first frame: a crash leaves the run as interrupted
        return (yield from _run_noted(folder, file, runner))
    finally:
        store.close()


def _noted_holds(work: Work[R], lock: FolderLock, control: Control) -> Work[R]:
    """Pass on ``work``, and store the reasons for pauses in the folder's lock, for other programs to read."""
    held = ""
    try:
        while True:
            record = next(work)
            if control.held != held:
                held = control.held
                lock.note(held)
            yield record
    except StopIteration as stop:
        found: R = stop.value
        return found
    finally:
        work.close()


def _check_origin(
    folder: Path, file: SessionFile, rig: Rig, options: Options, control: Control, found: SessionReport
) -> None:
    """Compare the latest intact position of the session with a new frame of that position."""
    if options.origin_tolerance_px is None:
        return
    for name in reversed(file.recordings):
        with RecordingFile(folder / name) as recording:
            there = recording.taken.copy()
            there[found.slots(name)] = False
            if not there.any():
                continue
            records = recording.records
            slot = int(np.argmax(np.where(there, records["sequence"].astype(np.int64), -1)))
            latest = slot, recording.read(slot), records[slot]
        check_origin(rig, file.plan, options, file.schedule(0), latest, control)
        return


def _run_noted(folder: Path, file: SessionFile, runner: Runner) -> Work[tuple[SessionFile, Outcome]]:
    """Run the recording, and store how it ended in ``session.json``."""
    try:
        outcome = yield from runner.run()
    except AcquisitionStopped as stop:
        _note(folder, file, "failed", stop.acknowledged, 0.0, str(stop))
        raise
    return _note(folder, file, outcome.how, outcome.acknowledged, outcome.seconds, ""), outcome


def _note(folder: Path, file: SessionFile, how: str, done: int, seconds: float, message: str) -> SessionFile:
    """Return the session with its last run ended; after a failed run, an error in writing this is ignored."""
    last = replace(file.runs[-1], ended=_now(), how=how, acknowledged=done, seconds=seconds, message=message)
    file = replace(file, runs=(*file.runs[:-1], last))
    try:
        file.write(folder)
    except (LfcalError, OSError):
        if how != "failed":
            raise
    return file


def _known(folder: Path, file: SessionFile, schedule: Schedule, todo: NDArray[np.bool_]) -> list[RecordedNeighbour]:
    """Return frames of earlier runs around the remaining positions; none for whole frames."""
    if file.target is not None:
        return []
    positions = np.zeros(file.positions, np.bool_)
    positions[schedule.flat[todo & (schedule.kinds == Kind.POSITION)]] = True
    return recorded_neighbours(folder, positions.reshape(file.grid))


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def _nothing(_: str) -> NDArray[np.int64]:
    """Return no damaged slots for any file."""
    return np.array([], np.int64)


class _Nowhere:
    """A sink that accepts no frames."""

    def put(self, *_: Any) -> None:
        """Raise an error."""
        raise StorageError("no recording is open; begin a session first")

    def sync(self, *_: Any) -> None:
        """Raise an error."""
        self.put()
