"""Connected devices, opened once, used by one task at a time and always closed. No Qt."""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire import Control, Devices, LiveFrame, Preview
from lfcal.acquire.setup import LiveState, iter_live
from lfcal.base import InputError, Work
from lfcal.camera import ScanPlan
from lfcal.devices import LimitError, Limits, Point, Rig, StageError
from lfcal.devices.simulated import DeviceFault

R = TypeVar("R")
Choice = tuple[Mapping[str, str], str]
"""Options of a backend, and the backend of the stage."""

DESCRIBED = ("sim",)
"""Backends that simulate frames from a camera description."""

SEEN = ("camera", "period", "cutout", "depths_um", "anchor", "resample")
"""Fields of a plan on which simulated frames depend. Exposure and stage can be changed while connected."""

MOVE_TIMEOUT_S = 60.0
SETTLE_S = 0.1
READ_S = 0.1
"""Interval between position readings during a move (s)."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One live frame with its state; ``frame`` is None if none arrived, and ``state.trouble`` states why."""

    frame: LiveFrame | None
    state: LiveState


class Station:
    """The connected devices with a lock: live view, moves and sessions never use a device at the same time.

    Parameters
    ----------
    rig
        The devices; the station closes them.
    name
        Displayed name of the backend.
    plan, choice
        The plan the devices were opened for; options of the backend, and the backend of the stage.
    devices
        Information of the devices when they were opened. None: query it now.
    """

    def __init__(
        self, rig: Rig, name: str, plan: ScanPlan, choice: Choice = ({}, ""), devices: Devices | None = None
    ) -> None:
        self.rig, self.name = rig, name
        self.devices = devices or Devices.of(rig)
        self._opened_for, self._choice = plan, (dict(choice[0]), choice[1])
        self._lock = threading.Lock()
        self._live: Generator[LiveState, float | None, None] | None = None
        self._preview = Preview(1)
        self._plan: ScanPlan | None = None
        self._exposure = math.nan
        self._seen: Point | None = None
        self._under_way = False
        self.moving = Control()
        """Request to stop the running move."""

    # -- facts -----------------------------------------------------------------------------------------
    @property
    def limits(self) -> Limits:
        """Travel of the stage (µm)."""
        return self.rig.stage.limits

    @property
    def title(self) -> str:
        """Names of camera and stage, as reported by the devices."""
        camera = self.rig.camera
        rows, columns = camera.sensor_shape
        title = f"{camera.name}, {columns} × {rows} px, {camera.bit_depth} bits; {self.rig.stage.name}"
        automatic = self.devices.automatic_words
        return f"{title}. The camera changes frames automatically: {automatic}" if automatic else title

    def outdated(self, plan: ScanPlan, name: str, options: Mapping[str, str], stage: str) -> str:
        """Return why these devices do not match ``plan`` and the current choice of devices; empty if they do."""
        if (self.name, *self._choice) != (name, dict(options), stage):
            return "You chose other devices than those connected; connect again."
        opened = self._opened_for
        if name in DESCRIBED and any(getattr(opened, key) != getattr(plan, key) for key in SEEN):
            return "The camera or the plan changed; connect again to use the current ones."
        return ""

    # -- use -------------------------------------------------------------------------------------------
    def look(self, exposure_s: float, plan: ScanPlan) -> Look:
        """Return the next live frame, exposed for ``exposure_s``."""
        with self._lock:
            if self._live is None or self._plan is not plan:
                self._stop_live()
                self._live = iter_live(self.rig, self._preview, Control(), exposure_s, plan=plan)
                self._plan, self._exposure = plan, exposure_s
                ask: Callable[[], LiveState]
                ask = self._live.__next__
            else:
                changed = exposure_s if exposure_s != self._exposure else None
                self._exposure = exposure_s
                ask = partial(self._live.send, changed)
            try:
                state = ask()
            except BaseException:
                self._stop_live()  # the next look begins again
                raise
            self._seen = state.stage_um
            return Look(self._preview.latest(), state)

    def note(self, stage_um: Point) -> None:
        """Store the stage position (µm) of a frame of the session that uses the stage."""
        self._seen = stage_um

    @property
    def seen(self) -> Point | None:
        """Last read-back position (µm)."""
        return self._seen

    def where(self) -> tuple[Point | None, bool]:
        """Return the last read-back position (µm; None before the first) and whether `move` is moving the stage.

        Never waits: while something else uses the devices, the position is that of the move, or the last one.
        """
        if self._lock.acquire(blocking=False):
            try:
                self._seen = self.rig.stage.position()
            finally:
                self._lock.release()
        return self._seen, self._under_way

    def position(self) -> Point:
        """Read back and return the position (µm)."""
        with self._lock:
            return self.rig.stage.position()

    def move(self, target: Point) -> Point:
        """Move to ``target`` and return the read-back (µm); the target is checked against the limits first."""
        in_limits(target, self.limits)
        with self._lock:
            self.moving = Control()
            self._under_way = True
            try:
                self.rig.stage.move(target)
                self._arrive()
            finally:
                self._under_way = False
            self.rig.time.sleep(SETTLE_S)
            self._seen = self.rig.stage.position()
            return self._seen

    def _arrive(self) -> None:
        """Wait until the stage has stopped, or stop it on request; the position is read meanwhile."""
        stage = self.rig.stage
        deadline, read = time.monotonic() + MOVE_TIMEOUT_S, -math.inf
        while stage.moving():
            now = time.monotonic()
            if self.moving.stopping:
                stage.stop()
                return
            if now > deadline:
                stage.stop()
                raise StageError.expected(
                    "stage", f"arrival within {MOVE_TIMEOUT_S:g} s", "still moving", "check for an obstacle"
                )
            if now - read > READ_S:
                self._seen, read = stage.position(), now
            self.rig.time.sleep(0.005)

    def move_axes(self, target: Sequence[float | None]) -> Point:
        """Move to ``target`` (µm; None leaves an axis unchanged) and return the read-back."""
        here = self.position()
        x, y, z = (now if wanted is None else wanted for now, wanted in zip(here, target, strict=True))
        return self.move((x, y, z))

    def jog(self, axis: int, by_um: float) -> Point:
        """Move one axis (0, 1, 2: x, y, z) by a step (µm) and return the read-back."""
        with self._lock:
            here = list(self.rig.stage.position())
        here[axis] += by_um
        return self.move((here[0], here[1], here[2]))

    def inject(self, fault: DeviceFault) -> None:
        """Make the simulator fail after a number of calls, also while a session uses it."""
        from lfcal.devices.simulated import inject

        inject(self.rig, fault)

    def use(self, work: Work[R]) -> Work[R]:
        """Run ``work`` with exclusive use of the devices; the live view is stopped for it."""
        with self._lock:
            self._stop_live()
            return (yield from work)

    def close(self) -> None:
        """Release the devices when the current task has ended."""
        self.moving.stop()
        with self._lock:
            self._stop_live()
            self.rig.close()

    def _stop_live(self) -> None:
        if self._live is not None:
            self._live.close()
        self._live, self._plan = None, None


def open_station(plan: ScanPlan, backend: str, options: Mapping[str, str], stage: str = "") -> Station:
    """Open the devices of ``backend``, optionally with the stage of another backend; pass on errors of opening."""
    from lfcal.acquire import check_devices
    from lfcal.devices import open_rig

    rig = open_rig(plan, backend, options, stage=stage)
    try:
        devices = check_devices(plan, rig)
    except BaseException:
        rig.close()
        raise
    return Station(rig, backend, plan, (options, stage), devices)


def read_target(words: str, limits: Limits) -> tuple[float | None, ...]:
    """Return the position (µm) in a text ``x, y, z``; an empty axis, as in ``, , 1200``, is unchanged (None).

    Raises
    ------
    InputError
        If ``words`` is not a position, or the position is outside the limits.
    """
    parts = [part.strip() for part in re.split("[,;]", words)] if re.search("[,;]", words) else words.split()
    try:
        target = tuple(float(part) if part else None for part in parts)
    except ValueError:
        target = ()
    if len(target) != 3 or all(value is None for value in target):
        raise InputError.expected(
            "position of the stage",
            "x, y and z in µm",
            repr(words),
            "separate three values by commas (100, -20, 1500); an empty value leaves its axis unchanged",
        )
    middles = [(low + high) / 2 for low, high in limits]
    x, y, z = (middle if value is None else value for value, middle in zip(target, middles, strict=True))
    in_limits((x, y, z), limits)
    return target


def in_limits(target: Point, limits: Limits) -> None:
    """Raise `LimitError` if ``target`` is outside ``limits`` (µm), or `InputError` if it is not finite."""
    for name, value, (low, high) in zip("xyz", target, limits, strict=True):
        if not math.isfinite(value):
            raise InputError.expected(f"stage axis {name}", "a number (µm)", value, "enter a number")
        if not low <= value <= high:
            raise LimitError.expected(
                f"stage axis {name}",
                f"{low:.6g} to {high:.6g} µm",
                f"{value:.6g} µm",
                "stay within the travel; nothing was moved",
            )


def cut(frame: NDArray[np.generic], row: int, column: int, shape: tuple[int, int]) -> NDArray[np.generic]:
    """Return the cutout of ``frame`` of the given shape with first pixel (row, column); zero outside the frame."""
    out = np.zeros(shape, frame.dtype)
    top, left = max(row, 0), max(column, 0)
    bottom, right = min(row + shape[0], frame.shape[0]), min(column + shape[1], frame.shape[1])
    if bottom > top and right > left:
        out[top - row : bottom - row, left - column : right - column] = frame[top:bottom, left:right]
    return out
