"""One step taken as the schedule says: light, way, exposure, cutout, note."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire._exposing import ExposedFrame, Exposer
from lfcal.acquire._motion import Mover
from lfcal.acquire.control import Control
from lfcal.acquire.guard import MeasuredFrame, SensorLimits, measured
from lfcal.acquire.lighting import Lighting
from lfcal.acquire.options import Options
from lfcal.acquire.recording import Kind, Note
from lfcal.acquire.schedule import Schedule, ScheduledFrame
from lfcal.camera import ScanPlan
from lfcal.devices import Point, Rig, Roi

__all__ = ["TakenFrame", "Taker"]


class TakenFrame(NamedTuple):
    """A frame ``(rows, columns)`` as it is to be kept, in numbers, its note, and all that was read of ``roi``."""

    frame: NDArray[Any]
    now: MeasuredFrame
    note: Note
    exposed: ExposedFrame
    roi: Roi


class Taker:
    """Take steps of a schedule with the devices of a rig.

    Parameters
    ----------
    rig, plan, options, schedule, control
        As in `Runner`.
    sensor
        The camera's.
    elapsed
        Seconds of recording so far, pauses left out.
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
        """Return the frame of ``step``; raises `DeviceError` if a device fails."""
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
            here = self.mover.check(step.target)  # a stage that crept away during the exposure shows here
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
        """Return the part that is kept, contiguous, with its saturation mask and first sensor row and column."""
        roi = self._exposer.roi
        # dark frames keep the whole region: the cutouts of all positions lie in it
        wanted = self._schedule.roi if step.kind is Kind.DARK else Roi(step.row, step.column, *self._schedule.window)
        part = wanted.within(roi)
        mask = None if exposed.mask is None else exposed.mask[part]
        return np.ascontiguousarray(exposed.data[part]), mask, wanted.row, wanted.column
