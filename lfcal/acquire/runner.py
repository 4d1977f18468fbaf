"""The strict loop: move, arrive, settle, read back, expose, read back, write, acknowledge."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.control import Aborted, Control
from lfcal.acquire.errors import AcquisitionStopped
from lfcal.acquire.exposing import ExposedFrame, Exposer
from lfcal.acquire.lighting import Lighting, check_light
from lfcal.acquire.motion import Mover, check_limits
from lfcal.acquire.options import Options
from lfcal.acquire.preview import LiveFrame, Preview
from lfcal.acquire.recording.records import Kind, Note
from lfcal.acquire.recording.writer import Acknowledged, Sink, Writer
from lfcal.acquire.schedule import Schedule, Step
from lfcal.camera import ScanPlan
from lfcal.devices.errors import CameraError, StageError, WrongFrame
from lfcal.devices.protocols import Point, Rig, Roi
from lfcal.errors import LfcalError
from lfcal.frames.source import Position
from lfcal.progress import Progress, Work

__all__ = ["Observer", "Outcome", "Runner"]

HOLD_S = 0.2

Observer = Callable[[Step, Note, NDArray[Any]], None]
"""Called with step, note and frame after each acknowledgement, in the recording thread."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run ended: ``"complete"``, ``"stopped"`` or ``"aborted"``; positions acknowledged, of how many.

    ``damaged`` frames of earlier runs were found on resuming, to be taken again.
    """

    how: str
    acknowledged: int
    total: int
    seconds: float
    damaged: int = 0


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
    low_space
        Returns why the session should hold, or an empty string.
    elapsed_s
        Seconds recorded by earlier runs of the session.

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
        low_space: Callable[[], str] = lambda: "",
        elapsed_s: float = 0.0,
    ) -> None:
        self._rig, self._plan, self._options, self._schedule = rig, plan, options, schedule
        self._sink, self._todo = sink, todo
        self.control = control or Control()
        self._preview, self._observers, self._low_space = preview, observers, low_space
        self._exposures = plan.exposures
        motion = options.motion(plan)
        # dark frames are taken wherever the stage stands
        moved = schedule.kinds != Kind.DARK
        check_limits(schedule.targets[moved], rig.stage.limits, motion.overshoot_um)
        if bool((todo & ~moved).any()):
            check_light(rig)
        self._mover = Mover(rig.stage, rig.time, motion, self.control)
        self._lighting = Lighting(rig, self.control, options.light_settle_s)
        sensor = plan.camera.sensor
        self._exposer = Exposer(rig, self.control, options.bracket, sensor.black_level, options.grab_timeout_s)
        self._max = rig.camera.max_value
        self._elapsed = elapsed_s
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
        step: Step | None = None
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
        how = "aborted" if self.control.aborting else "stopped" if self.control.stopping else "complete"
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
    def _record(self, step: Step) -> tuple[NDArray[Any], Note]:
        """Return frame and note of ``step``, after as many attempts as are allowed."""
        attempt = 1
        while True:
            try:
                return self._take(step, attempt)
            # the camera was changed from outside: every further frame would be wrong too
            except WrongFrame:
                raise
            except (CameraError, StageError):
                if attempt > self._options.retries:
                    raise
            # the fault may have left the stage anywhere, so the next attempt approaches from the start
            self._mover.forget()
            attempt += 1

    def _take(self, step: Step, attempt: int) -> tuple[NDArray[Any], Note]:
        self._exposer.read_region(self._schedule.roi_of(step.kind))
        dark = step.kind is Kind.DARK
        self._lighting.switch(not dark)
        if dark:
            repeats = self._options.darks
            exposure = self._exposer.expose(self._exposures[step.z], repeats, self._rig.time.monotonic())
            here = self._mover.position()
        else:
            self._mover.go(step.target)
            repeats = self._plan.frames_averaged
            exposure = self._exposer.expose(self._exposures[step.z], repeats, self._rig.time.monotonic())
            here = self._mover.check(step.target)  # a stage that crept away during the exposure shows here
        frame, mask, row, column = self._crop(step, exposure)
        note = self._note(step, exposure, frame, mask, stage_um=here, place=(row, column), attempts=attempt)
        if self._preview is not None:
            self._show(step, exposure, Roi(row, column, *frame.shape))
        return frame, note

    def _note(
        self,
        step: Step,
        exposure: ExposedFrame,
        frame: NDArray[Any],
        mask: NDArray[np.bool_] | None,
        *,
        stage_um: Point,
        place: tuple[int, int],
        attempts: int,
    ) -> Note:
        clock = self._rig.time
        return Note(
            index=step.flat,
            attempts=attempts,
            kind=step.kind,
            row=place[0],
            column=place[1],
            period_y=step.period_y,
            period_x=step.period_x,
            saturated=int(np.count_nonzero(frame >= self._max if mask is None else mask)),
            sensor_saturated=exposure.saturated,
            target_um=step.target,
            stage_um=stage_um,
            exposure_s=exposure.exposure_s,
            time_s=clock.wall(),
            elapsed_s=self._elapsed + clock.monotonic() - self._since,
            energy=float(frame.sum(dtype=_sum_type(frame))),
            peak=float(frame.max()),
        )

    def _crop(self, step: Step, exposure: ExposedFrame) -> tuple[NDArray[Any], NDArray[Any] | None, int, int]:
        """Return the part that is kept, contiguous, with its saturation mask and first sensor row and column."""
        roi = self._exposer.roi
        # dark frames keep the whole region: the cutouts of all positions lie in it
        wanted = self._schedule.roi if step.kind is Kind.DARK else Roi(step.row, step.column, *self._schedule.window)
        top, left = wanted.row - roi.row, wanted.column - roi.column
        rows, columns = slice(top, top + wanted.rows), slice(left, left + wanted.columns)
        mask = None if exposure.mask is None else exposure.mask[rows, columns]
        return np.ascontiguousarray(exposure.data[rows, columns]), mask, wanted.row, wanted.column

    def _show(self, step: Step, exposure: ExposedFrame, cutout: Roi) -> None:
        assert self._preview is not None
        _, ny, nx = self._plan.shape[:3]
        position = Position(step.z, step.flat // nx % ny, step.flat % nx)
        self._preview.put(
            LiveFrame(exposure.data, self._exposer.roi, cutout, position, exposure.saturated, step.kind.name.lower())
        )

    # -- around the steps ------------------------------------------------------------------------------
    def _hold(self, writer: Writer) -> Work[None]:
        """Wait while paused or while the disk is too full; yields so that a caller sees why."""
        self._acknowledge(writer.collect())
        began = self._rig.time.monotonic()
        while not self.control.stopping:
            why = "paused" if self.control.pausing else self._low_space()
            if why != self.control.held:
                self.control.held = why
                yield self._progress(why)
            if not why:
                break
            # while the session holds, nothing may be left in memory alone
            self._acknowledge(writer.flush())
            self.control.wait(HOLD_S)
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

    def _report(self, step: Step | None, error: BaseException) -> str:
        where = "before the first frame"
        if step is not None:
            _, ny, nx = self._plan.shape[:3]
            where = f"{step.kind.name.lower()} (z, y, x) = ({step.z}, {step.flat // nx % ny}, {step.flat % nx})"
        # devices raise DeviceError only, see `driver_errors`: what is left of OSError is the recording's own
        kind = "disk" if isinstance(error, OSError) else "device"
        return (
            f"stopped at {where} by the {kind}: {error}; {self._done} of {self._total} positions are safe; "
            "remove the cause, then resume"
        )


def _sum_type(frame: NDArray[Any]) -> type:
    return np.float64 if frame.dtype.kind == "f" else np.uint64
