"""A step taken until its frame may count: faults of devices tried again, doubtful content looked into."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from lfcal.acquire._taking import TakenFrame, Taker
from lfcal.acquire.errors import SuspectFrame
from lfcal.acquire.guard import (
    NO_DOUBT,
    CheckedFrame,
    Content,
    ContentGuard,
    Doubt,
    FramePlace,
    MeasuredFrame,
    same_place,
)
from lfcal.acquire.options import Options
from lfcal.acquire.recording import Kind
from lfcal.acquire.schedule import Schedule, ScheduledFrame
from lfcal.camera import ScanPlan
from lfcal.devices import CameraError, StageError, WrongFrame
from lfcal.frames import Position

__all__ = ["Attempts"]


class _Judged(NamedTuple):
    """A frame with its content, what is seen of it, and what is doubted after all."""

    taken: TakenFrame
    content: Content
    seen: CheckedFrame
    doubt: Doubt


class Attempts:
    """Take steps and judge what comes.

    A doubtful frame is taken again, because most faults pass. If it stays unlike its neighbours, the latest trusted
    position is taken again: where that comes out as it was recorded, the rig is as it was, and the pattern itself is
    unusual; where it does not, the rig changed. So a pattern of any kind costs a few frames more, and never an alarm.

    Parameters
    ----------
    taker, guard
        What takes a frame, and what judges it.
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
        """Take ``step`` of an earlier run, which looked like ``now``, for one that is known."""
        self._trusted = step, now

    def record(self, step: ScheduledFrame) -> TakenFrame:
        """Return frame and note of ``step``, the latter with what is still suspected of the frame.

        Raises
        ------
        DeviceError
            If a device fails more often than is allowed.
        SuspectFrame
            If a doubt stays, and the options say that the session stops then.
        """
        self._attempt = 1
        judged = self._judged(step)
        if judged.doubt and judged.doubt.what != self._standing.what:
            judged = self._looked_into(step)
        elif not judged.doubt and self._standing and step.kind is not Kind.DARK:
            # with few neighbours to be trusted, only a known place tells whether the fault is over
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
        """Return a later frame of ``step`` with what is to be thought of it."""
        second = self._again(step)
        if not second.doubt or second.doubt.certain or step.kind is not Kind.POSITION:
            return second
        if self._trusted is None:  # nothing to hold it against: the source may well be dim
            return second._replace(doubt=NO_DOUBT)
        witness = self._witness()
        if witness:
            return second._replace(doubt=second.doubt | witness)
        # the rig is as it was: is it the fault of a moment, which passed meanwhile, or the pattern?
        third = self._again(step)
        steady = not same_place(third.seen.now, second.seen.now, self._guard.sensor)
        return third._replace(doubt=NO_DOUBT) if steady and not third.doubt.certain else third

    def _witness(self) -> Doubt:
        """Return the doubt about the latest trusted position, taken again."""
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
        known = f"(z, y, x) = {tuple(self._position(step))}, taken again, differs from its frame too"
        return Doubt(changed.what, (known,))

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
        """Return what is taken of ``step``, after as many faults of the devices as are allowed."""
        faults = 0
        while True:
            try:
                return self._taker.take(step, self._attempt)
            # the camera was changed from outside: every further frame would be wrong too
            except WrongFrame:
                raise
            except (CameraError, StageError):
                faults += 1
                if faults > self._options.retries:
                    raise
            # the fault may have left the stage anywhere, so the next attempt approaches from the start
            self._taker.mover.forget()
            self._attempt += 1

    def _position(self, step: ScheduledFrame) -> Position:
        return self._schedule.position(step.flat)
