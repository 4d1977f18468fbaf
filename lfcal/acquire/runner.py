"""The strict loop: move, arrive, settle, read back, expose, read back, write, acknowledge."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire._attempts import Attempts
from lfcal.acquire._known import Known
from lfcal.acquire._motion import check_limits
from lfcal.acquire._taking import Taker
from lfcal.acquire.control import Aborted, Control
from lfcal.acquire.errors import AcquisitionStopped, SuspectFrame
from lfcal.acquire.guard import ContentGuard, SensorLimits
from lfcal.acquire.lighting import check_light
from lfcal.acquire.options import Options
from lfcal.acquire.preview import LiveFrame, Preview
from lfcal.acquire.recording import Acknowledged, Kind, Note, Sink, Writer
from lfcal.acquire.schedule import Schedule, ScheduledFrame
from lfcal.base import LfcalError, Progress, Work
from lfcal.camera import ScanPlan
from lfcal.devices import Rig, Roi
from lfcal.frames import Position

__all__ = ["Observer", "Outcome", "Runner"]

HOLD_S, TICK_S = 0.2, 0.01
"""How long a session that holds waits before it looks again, and how much of it always passes really (s)."""

Observer = Callable[[ScheduledFrame, Note, NDArray[Any]], None]
"""Called with step, note and frame after each acknowledgement, in the recording thread."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run ended: ``"complete"``, ``"stopped"`` or ``"aborted"``; positions acknowledged, of how many.

    ``damaged`` frames of earlier runs were found on resuming, to be taken again. ``notes`` say what was not checked of
    the stage, and what is worth knowing of it.
    """

    how: str
    acknowledged: int
    total: int
    seconds: float
    damaged: int = 0
    notes: tuple[str, ...] = ()


class Runner:
    """Record the steps of a schedule that are still to do.

    Parameters
    ----------
    rig, plan, options, schedule
        What to do with which devices.
    sink
        Where frames go.
    todo
        ``(len(schedule),)`` steps without an acknowledged frame.
    control
        Pause, resume, stop and abort, from any thread.
    preview, observers
        Who may see the frames.
    trouble
        Returns why the session should hold, or an empty string: too little disk, a lab that is not as it should be.
    elapsed_s
        Seconds recorded by earlier runs of the session.
    recorded
        CRC-32 of the frames they kept, with their positions.
    known
        Frames of them around the steps to do.
    whole_frames
        Frames are of many points, not of one that moves on by a pixel.

    Raises
    ------
    LimitError, InputError
        At once, before anything moves: the plan leaves the stage's travel, or dark frames are to be taken and the
        light cannot be switched.
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
        known: Sequence[Known] = (),
        whole_frames: bool = False,
    ) -> None:
        self._rig, self._plan, self._options, self._schedule = rig, plan, options, schedule
        self._sink, self._todo = sink, todo
        self.control = control or Control()
        self._preview, self._observers, self._trouble = preview, observers, trouble
        motion = options.motion(plan)
        # dark frames are taken wherever the stage stands
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
        # time without an acknowledged position says nothing about the rate
        self._earlier = elapsed_s if self._done else 0.0

    def run(self) -> Work[Outcome]:
        """Record; yields after acknowledged frames and while held.

        Raises
        ------
        AcquisitionStopped
            After a fault that retries did not cure: the stage is stopped, what was acknowledged is safe.
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
        # earlier runs count for the rate from which the time to the end is estimated
        seconds = self._earlier + time.perf_counter() - self._began
        return Progress(self._done, self._total, "record", seconds, note)

    def _acknowledge(self, done: list[Acknowledged]) -> None:
        for step, note, frame in done:
            self._done += step.kind is Kind.POSITION
            for observer in self._observers:
                observer(step, note, frame)

    # -- one step --------------------------------------------------------------------------------------
    def _record(self, step: ScheduledFrame) -> tuple[NDArray[Any], Note]:
        """Return frame and note of ``step``, and show the frame."""
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
        """Wait while paused, or while there is trouble that may pass; yields so that a caller sees why."""
        self._acknowledge(writer.collect())
        began = self._rig.time.monotonic()
        while not self.control.stopping:
            why = "paused" if self.control.pausing else self._trouble()
            if why != self.control.held:
                self.control.held = why
                yield self._progress(why)
            if not why:
                break
            # while the session holds, nothing may be left in memory alone
            self._acknowledge(writer.flush())
            if not self.control.pausing:
                # what troubles may pass with the rig's time, which is not always that of the wall
                self.control.sleep(HOLD_S, self._rig.time)
            self.control.wait(HOLD_S if self.control.pausing else TICK_S)
            yield self._progress(why)
        self.control.held = ""
        # a pause is not recording time: the drift of the lamp is judged over it
        self._since += self._rig.time.monotonic() - began

    def _halt(self) -> None:
        """Stop the stage and switch the light on again, as far as the devices still answer."""
        # what a driver raises here would hide why the session ends
        with suppress(Exception):
            self._rig.stage.stop()
        self._lighting.restore()

    def _report(self, step: ScheduledFrame | None, error: BaseException) -> str:
        where = "before the first frame"
        if step is not None:
            where = f"{step.kind.name.lower()} (z, y, x) = {tuple(self._position(step))}"
        # devices raise DeviceError only, see `driver_errors`: what is left of OSError is the recording's own
        kind = "disk" if isinstance(error, OSError) else "device"
        remedy = "remove the cause, then resume"
        if isinstance(error, SuspectFrame):
            kind = "content guard"
            remedy += ", or resume with --on-suspect flag to keep such frames and name them"
        return f"stopped at {where} by the {kind}: {error}; {self._done} of {self._total} positions are safe; {remedy}"
