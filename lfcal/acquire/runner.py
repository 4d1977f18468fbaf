"""Record step by step: move, wait for arrival, settle, read back, expose, read back, write, acknowledge.

`Taker` carries out a step as scheduled. `Attempts` repeats it if a device failed, and investigates doubtful content.
`Runner` carries out all steps of the schedule.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire._exposing import ExposedFrame, Exposer
from lfcal.acquire._motion import Mover, check_limits
from lfcal.acquire.control import Aborted, Control
from lfcal.acquire.errors import AcquisitionStopped, SuspectFrame
from lfcal.acquire.guard import (
    NO_DOUBT,
    CheckedFrame,
    Content,
    ContentGuard,
    Doubt,
    FramePlace,
    MeasuredFrame,
    SensorLimits,
    measured,
    same_place,
)
from lfcal.acquire.lighting import Lighting, check_light
from lfcal.acquire.options import Options
from lfcal.acquire.preview import LiveFrame, Preview
from lfcal.acquire.recording import Acknowledged, Kind, Note, RecordingSource, Sink, Writer
from lfcal.acquire.schedule import Schedule, ScheduledFrame
from lfcal.base import LfcalError, Progress, Work
from lfcal.camera import ScanPlan
from lfcal.devices import CameraError, Point, Rig, Roi, StageError, WrongFrame
from lfcal.frames import Position

__all__ = ["Observer", "Outcome", "RecordedNeighbour", "Runner", "recorded_neighbours"]

ENOUGH = 512


class RecordedNeighbour(NamedTuple):
    """A recorded position: its frame ``(rows, columns)``, number of saturated pixels, and exposure (s)."""

    position: Position
    frame: NDArray[Any]
    saturated: int
    exposure_s: float


def recorded_neighbours(folder: Path, todo: NDArray[np.bool_]) -> list[RecordedNeighbour]:
    """Return frames recorded at neighbours of the True positions of ``todo`` ``(nz, ny, nx)``, at most `ENOUGH`.

    Neighbours are in the same plane, and ``todo`` is periodic in y and x. Suspect and unreadable frames are skipped; if
    the session cannot be read, the list is empty.
    """
    near = todo.copy()
    for axis in (1, 2):
        for step in (-1, 1):
            near |= np.roll(near, step, axis)
    known: list[RecordedNeighbour] = []
    with suppress(LfcalError), RecordingSource(folder, skip_damaged=True) as source:
        suspect = {position for position, _ in source.suspects()}
        for k in range(len(source)):
            info = source.info(k)
            if near[info.position] and not todo[info.position] and info.position not in suspect:
                with suppress(LfcalError):
                    record = source.record(k)
                    exposure, saturated = float(record["exposure_s"]), int(record["saturated"])
                    known.append(RecordedNeighbour(info.position, source.read(k), saturated, exposure))
            if len(known) == ENOUGH:
                break
    return known


class TakenFrame(NamedTuple):
    """A frame ``(rows, columns)`` to store, its measurements, its record, and all samples read from ``roi``."""

    frame: NDArray[Any]
    now: MeasuredFrame
    note: Note
    exposed: ExposedFrame
    roi: Roi


class Taker:
    """Controller of the devices that takes the frame of each step of a schedule.

    Parameters
    ----------
    rig, plan, options, schedule, control
        As in `Runner`.
    sensor
        Limits of the sensor.
    elapsed
        Function that returns the recording time so far, without pauses (s).
    """

    def __init__(
        self,
        rig: Rig,
        plan: ScanPlan,
        options: Options,
        schedule: Schedule,
        control: Control,
        *,
        sensor: SensorLimits,
        elapsed: Callable[[], float],
    ) -> None:
        self._rig, self._plan, self._options, self._schedule = rig, plan, options, schedule
        self._elapsed = elapsed
        self.mover = Mover(rig.stage, rig.time, options.motion(plan), control)
        self.lighting = Lighting(rig, control, options.light_settle_s)
        black = plan.camera.sensor.black_level
        self._exposer = Exposer(rig, control, options.bracket, black, options.grab_timeout_s)
        self._exposures = plan.exposures
        self._sensor = sensor

    def take(self, step: ScheduledFrame, attempt: int = 1) -> TakenFrame:
        """Return the frame of ``step``; raise `DeviceError` if a device fails. ``attempt`` is stored in its record."""
        self._exposer.read_region(self._schedule.roi_of(step.kind))
        dark = step.kind is Kind.DARK
        self.lighting.switch(not dark)
        if dark:
            repeats = self._options.darks
            exposed = self._exposer.expose(self._exposures[step.z], repeats, self._rig.time.monotonic())
            here = self.mover.position()
        else:
            self.mover.go(step.target)
            repeats = self._plan.frames_averaged
            exposed = self._exposer.expose(self._exposures[step.z], repeats, self._rig.time.monotonic())
            here = self.mover.check(step.target)  # detects a stage that moved during the exposure
        frame, mask, row, column = self._crop(step, exposed)
        saturated = int(np.count_nonzero(frame >= self._sensor.ceiling if mask is None else mask))
        now = measured(frame, saturated, self._sensor)
        note = self._note(step, exposed, now, stage_um=here, place=(row, column), attempts=attempt)
        return TakenFrame(frame, now, note, exposed, self._exposer.roi)

    def _note(
        self,
        step: ScheduledFrame,
        exposed: ExposedFrame,
        now: MeasuredFrame,
        *,
        stage_um: Point,
        place: tuple[int, int],
        attempts: int,
    ) -> Note:
        return Note(
            index=step.flat,
            attempts=attempts,
            kind=step.kind,
            row=place[0],
            column=place[1],
            period_y=step.period_y,
            period_x=step.period_x,
            saturated=now.saturated,
            sensor_saturated=exposed.saturated,
            target_um=step.target,
            stage_um=stage_um,
            exposure_s=exposed.exposure_s,
            time_s=self._rig.time.wall(),
            elapsed_s=self._elapsed(),
            energy=now.total,
            peak=now.peak,
        )

    def _crop(self, step: ScheduledFrame, exposed: ExposedFrame) -> tuple[NDArray[Any], NDArray[Any] | None, int, int]:
        """Return the stored part of a frame, its saturation mask (or None), and its first sensor row and column."""
        roi = self._exposer.roi
        # dark frames keep the whole region, which contains the cutouts of all positions
        wanted = self._schedule.roi if step.kind is Kind.DARK else Roi(step.row, step.column, *self._schedule.window)
        part = wanted.within(roi)
        mask = None if exposed.mask is None else exposed.mask[part]
        return np.ascontiguousarray(exposed.data[part]), mask, wanted.row, wanted.column


class _Judged(NamedTuple):
    """A frame with its content, the result of its check, and the doubt that remains."""

    taken: TakenFrame
    content: Content
    seen: CheckedFrame
    doubt: Doubt


class Attempts:
    """Repeated attempts to take the frame of a step, each with a check of the frame.

    A doubtful frame is taken again, because most faults are transient. If it still differs from its neighbours, the
    latest trusted position is taken again. If the new frame of that position agrees with the recorded one, the rig is
    unchanged and the doubtful pattern itself is unusual. Otherwise, the rig has changed. An unusual pattern therefore
    costs only a few additional frames, and causes no alarm.

    Parameters
    ----------
    taker, guard
        Objects that take and check frames.
    schedule, plan, options
        As in `Runner`.
    """

    def __init__(self, taker: Taker, guard: ContentGuard, schedule: Schedule, plan: ScanPlan, options: Options) -> None:
        self._taker, self._guard, self._schedule = taker, guard, schedule
        self._plan, self._options = plan, options
        self._trusted: tuple[ScheduledFrame, MeasuredFrame] | None = None
        self._standing = NO_DOUBT
        self._attempt = 1

    def trust(self, step: ScheduledFrame, now: MeasuredFrame) -> None:
        """Register ``step`` of an earlier run, with its measurements ``now``, as the latest trusted position."""
        self._trusted = step, now

    def record(self, step: ScheduledFrame) -> TakenFrame:
        """Return the frame of ``step`` with its record, which contains any remaining doubt about the frame.

        Raises
        ------
        DeviceError
            If the camera or the stage fails more often than `Options.retries` allows, or after a fault for which there
            are no retries.
        SuspectFrame
            If a doubt remains and the options request a stop.
        """
        self._attempt = 1
        judged = self._judged(step)
        if judged.doubt and judged.doubt.what != self._standing.what:
            judged = self._looked_into(step)
        elif not judged.doubt and self._standing and step.kind is not Kind.DARK:
            # with few trusted neighbours, only a known position shows whether the fault is over
            judged = judged._replace(doubt=self._witness())
        self._standing = judged.doubt
        if judged.doubt:
            if self._options.on_suspect == "stop":
                raise SuspectFrame(judged.doubt.text, judged.doubt.what)
            note = replace(judged.taken.note, suspicion=judged.doubt.what)
            return judged.taken._replace(note=note)
        self._guard.accept(judged.content, judged.seen)
        if step.kind is Kind.POSITION:
            self._trusted = step, judged.seen.now
        return judged.taken

    def _looked_into(self, step: ScheduledFrame) -> _Judged:
        """Return a later frame of ``step`` with the remaining doubt about it."""
        second = self._again(step)
        if not second.doubt or second.doubt.certain or step.kind is not Kind.POSITION:
            return second
        if self._trusted is None:  # no frame to compare with: the source may simply be dim
            return second._replace(doubt=NO_DOUBT)
        witness = self._witness()
        if witness:
            return second._replace(doubt=second.doubt | witness)
        # the rig is unchanged, so either a transient fault has passed or the pattern is unusual
        third = self._again(step)
        steady = not same_place(third.seen.now, second.seen.now, self._guard.sensor)
        return third._replace(doubt=NO_DOUBT) if steady and not third.doubt.certain else third

    def _witness(self) -> Doubt:
        """Take the latest trusted position again, and return the doubt about it."""
        if self._trusted is None:
            return NO_DOUBT
        step, before = self._trusted
        self._taker.mover.forget()
        found = self._judged(step)
        if found.doubt.certain:
            return found.doubt
        changed = same_place(found.seen.now, before, self._guard.sensor)
        if not changed:
            return NO_DOUBT
        known = f"(z, y, x) = {tuple(self._position(step))}, recorded again, also differs from its frame"
        return Doubt.of(changed.what, known)

    def _again(self, step: ScheduledFrame) -> _Judged:
        self._taker.mover.forget()
        self._attempt += 1
        return self._judged(step)

    def _judged(self, step: ScheduledFrame) -> _Judged:
        taken = self._faultless(step)
        exposed = taken.exposed
        place = FramePlace(self._position(step), (step.period_y, step.period_x))
        content = Content(
            step.kind,
            place,
            taken.frame,
            taken.now,
            exposed.raws,
            self._plan.exposures[step.z],
            (exposed.exposure_s, *exposed.reported_s),
        )
        seen = self._guard.look(content)
        return _Judged(taken, content, seen, seen.doubt)

    def _faultless(self, step: ScheduledFrame) -> TakenFrame:
        """Return the frame of ``step``, after at most the allowed number of device faults."""
        faults = 0
        while True:
            try:
                return self._taker.take(step, self._attempt)
            # another program changed the camera, so every further frame would be wrong too
            except WrongFrame:
                raise
            except (CameraError, StageError):
                faults += 1
                if faults > self._options.retries:
                    raise
            # the fault may have left the stage anywhere, so the next attempt starts with the full approach
            self._taker.mover.forget()
            self._attempt += 1

    def _position(self, step: ScheduledFrame) -> Position:
        return self._schedule.position(step.flat)


HOLD_S, TICK_S = 0.2, 0.01
"""Time between two checks of a session on hold: in the rig's time, and at least in real time (s)."""

Observer = Callable[[ScheduledFrame, Note, NDArray[Any]], None]
"""Function called in the recording thread with step, note and frame after each acknowledgement."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a run of a recording.

    ``how`` states how the run ended: ``"complete"``, ``"stopped"`` or ``"aborted"``. ``acknowledged`` is the number of
    positions whose frames are on disk, and ``total`` the number of all positions. The recording time of this run
    without pauses is ``seconds``. ``damaged`` is the number of frames of earlier runs that were found damaged on
    resuming and had to be taken again. ``notes`` lists omitted checks of the stage, and remarks about it.
    """

    how: str
    acknowledged: int
    total: int
    seconds: float
    damaged: int = 0
    notes: tuple[str, ...] = ()


class Runner:
    """Loop that records the remaining steps of a schedule.

    Parameters
    ----------
    rig, plan, options, schedule
        Devices, plan and options, and the steps to record.
    sink
        Receiver of the frames.
    todo
        Mask ``(len(schedule),)`` of the steps without an acknowledged frame.
    control
        Requests to pause, resume, stop or abort, from any thread.
    preview, observers
        Receivers of frames for display and live quality.
    trouble
        Function that returns the reason why the session should pause, such as a full disk or a gauge out of bounds, or
        an empty string.
    elapsed_s
        Duration of earlier runs of this recording, without pauses (s).
    recorded
        Mapping from the CRC-32 of each frame stored by earlier runs to the position of the frame.
    known
        Frames of earlier runs at positions next to the remaining ones.
    whole_frames
        Whether frames cover the whole sensor and show many points of a target.

    Raises
    ------
    LimitError, InputError
        If the plan exceeds the stage's travel, or dark frames are still to be taken and the light cannot be switched
        off; nothing has moved.
    """

    def __init__(
        self,
        rig: Rig,
        plan: ScanPlan,
        options: Options,
        schedule: Schedule,
        sink: Sink,
        todo: NDArray[np.bool_],
        *,
        control: Control | None = None,
        preview: Preview | None = None,
        observers: tuple[Observer, ...] = (),
        trouble: Callable[[], str] = lambda: "",
        elapsed_s: float = 0.0,
        recorded: Mapping[int, Position] | None = None,
        known: Sequence[RecordedNeighbour] = (),
        whole_frames: bool = False,
    ) -> None:
        self._rig, self._plan, self._options, self._schedule = rig, plan, options, schedule
        self._sink, self._todo = sink, todo
        self.control = control or Control()
        self._preview, self._observers, self._trouble = preview, observers, trouble
        motion = options.motion(plan)
        # dark frames are taken at any position of the stage
        moved = schedule.kinds != Kind.DARK
        check_limits(schedule.targets[moved], rig.stage.limits, motion.overshoot_um)
        if bool((todo & ~moved).any()):
            check_light(rig)
        sensor = SensorLimits(rig.camera.max_value, plan.camera.sensor.electrons_per_count)
        taker = Taker(rig, plan, options, schedule, self.control, sensor=sensor, elapsed=self._elapsed_s)
        self._lighting = taker.lighting
        guard = ContentGuard(
            schedule.grid, sensor, coarse=options.order == "coarse", recorded=recorded, whole=whole_frames
        )
        self._attempts = Attempts(taker, guard, schedule, plan, options)
        for item in known:
            seen = guard.know(*item)
            if item is known[-1]:
                self._attempts.trust(next(Schedule.of(plan, options, [item.position]).steps()), seen)
        self._earlier_s = elapsed_s
        self._began = time.perf_counter()
        self._since = rig.time.monotonic()
        self._total = schedule.count(Kind.POSITION)
        self._done = self._total - int(todo[schedule.kinds == Kind.POSITION].sum())
        # only time with acknowledged positions shows the rate
        self._earlier = elapsed_s if self._done else 0.0

    def run(self) -> Work[Outcome]:
        """Record the remaining steps and return the outcome; yield progress after each frame and while paused.

        Raises
        ------
        AcquisitionStopped
            After an error of a device, the content guard or the disk that ends the run. The stage is stopped, and
            acknowledged frames are safe.
        """
        self._began = time.perf_counter()
        self._since = self._rig.time.monotonic()
        writer = Writer(self._sink)
        step: ScheduledFrame | None = None
        yield self._progress()
        try:
            try:
                for step in self._schedule.steps(self._todo):
                    yield from self._hold(writer)
                    if self.control.stopping:
                        break
                    self._acknowledge(writer.submit(step, *self._record(step)))
                    yield self._progress()
                self._lighting.switch(True)
            except Aborted:
                self._halt()
            self._acknowledge(writer.flush())
        except (LfcalError, OSError) as error:
            self._halt()
            # frames that were already on their way to the disk still count
            self._acknowledge(writer.salvage())
            raise AcquisitionStopped(self._report(step, error), self._done, error) from error
        except BaseException:
            self._halt()
            raise
        finally:
            writer.close()
        yield self._progress()
        seconds = self._rig.time.monotonic() - self._since
        how = "aborted" if self.control.aborting else "stopped"
        if not self.control.stopping and self._done == self._total:
            how = "complete"
        return Outcome(how, self._done, self._total, seconds)

    def _progress(self, note: str = "") -> Progress:
        # earlier runs are included in the rate for the estimate of the remaining time
        seconds = self._earlier + time.perf_counter() - self._began
        return Progress(self._done, self._total, "record", seconds, note)

    def _acknowledge(self, done: list[Acknowledged]) -> None:
        for step, note, frame in done:
            self._done += step.kind is Kind.POSITION
            for observer in self._observers:
                observer(step, note, frame)

    # -- one step --------------------------------------------------------------------------------------
    def _record(self, step: ScheduledFrame) -> tuple[NDArray[Any], Note]:
        """Return frame and note of ``step``, and display the frame."""
        taken = self._attempts.record(step)
        note = taken.note
        if self._preview is not None:
            cutout = Roi(note.row, note.column, *taken.frame.shape)
            exposed, kind = taken.exposed, step.kind.name.lower()
            self._preview.put(LiveFrame(exposed.data, taken.roi, cutout, self._position(step), exposed.saturated, kind))
        return taken.frame, note

    def _position(self, step: ScheduledFrame) -> Position:
        return self._schedule.position(step.flat)

    def _elapsed_s(self) -> float:
        return self._earlier_s + self._rig.time.monotonic() - self._since

    # -- around the steps ------------------------------------------------------------------------------
    def _hold(self, writer: Writer) -> Work[None]:
        """Wait while the session is paused or a temporary problem persists; yields progress with the reason."""
        self._acknowledge(writer.collect())
        began = self._rig.time.monotonic()
        while not self.control.stopping:
            why = "paused" if self.control.pausing else self._trouble()
            if why != self.control.held:
                self.control.held = why
                yield self._progress(why)
            if not why:
                break
            # while the session is on hold, all frames must be on disk
            self._acknowledge(writer.flush())
            if not self.control.pausing:
                # the condition may depend on the rig's time, which may differ from real time
                self.control.sleep(HOLD_S, self._rig.time)
            self.control.wait(HOLD_S if self.control.pausing else TICK_S)
            yield self._progress(why)
        self.control.held = ""
        # exclude pauses from recording time, over which the lamp's drift is measured
        self._since += self._rig.time.monotonic() - began

    def _halt(self) -> None:
        """Stop the stage and switch the light on again, as far as the devices still answer."""
        # an error of a driver here would hide why the session ends
        with suppress(Exception):
            self._rig.stage.stop()
        self._lighting.restore()

    def _report(self, step: ScheduledFrame | None, error: BaseException) -> str:
        where = "before the first frame"
        if step is not None:
            where = f"{step.kind.name.lower()} (z, y, x) = {tuple(self._position(step))}"
        # devices raise only DeviceError (see `driver_errors`), so any OSError comes from the recording
        kind = "disk" if isinstance(error, OSError) else "device"
        remedy = "remove the cause, then resume"
        if isinstance(error, SuspectFrame):
            kind = "content guard"
            remedy += ", or keep and flag such frames (--on-suspect flag) and resume"
        return f"stopped at {where} by the {kind}: {error}; {self._done} of {self._total} positions are safe; {remedy}"
