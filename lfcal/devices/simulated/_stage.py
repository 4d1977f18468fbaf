"""Simulate a stage: velocity, ringing, backlash, drift and injected faults."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from lfcal.base import check_number
from lfcal.devices.errors import DeviceLost, StageError
from lfcal.devices.protocols import Limits, Point, TimeSource
from lfcal.devices.simulated.faults import STAGE_FAULTS, DeviceFault, FaultSchedule

__all__ = ["SimStage", "StageModel", "VirtualTime"]


class VirtualTime:
    """Clock that advances only when the program waits: a session of hours runs in seconds.

    Parameters
    ----------
    wall_s
        Seconds since 1970 at the start.
    """

    def __init__(self, wall_s: float = 1.7e9) -> None:
        self._now = 0.0
        self._wall = wall_s

    def monotonic(self) -> float:
        """Return seconds since the start."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Advance the clock by ``seconds`` immediately."""
        self._now += max(0.0, seconds)

    def wall(self) -> float:
        """Return seconds since 1970."""
        return self._wall + self._now

    def jump(self, seconds: float) -> None:
        """Move the computer's clock forward or back, as an operator or a time server may do."""
        self._wall += seconds


@dataclass(frozen=True, slots=True)
class StageModel:
    """Motion of the simulated stage.

    Attributes
    ----------
    velocity_um_s
        Speed of each axis (µm/s).
    ringing_um, ringing_s
        Amplitude of the ringing after a stop (µm), and time constant of its decay (s).
    backlash_um
        Backlash of each axis (µm): after a move in the negative direction, the source is displaced this far in the
        positive direction. The encoder is on the motor and does not detect it.
    drift_um_s
        Speed at which each axis drifts after arrival (µm/s).
    limits
        Travel of x, y and z (µm).
    """

    velocity_um_s: float = 20e3
    ringing_um: float = 0.5
    ringing_s: float = 0.005
    backlash_um: tuple[float, float, float] = (3.0, 3.0, 3.0)
    drift_um_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    limits: Limits = ((-5e5, 5e5), (-5e5, 5e5), (-5e5, 5e5))

    def __post_init__(self) -> None:
        """Check every value."""
        check_number("velocity (µm/s)", self.velocity_um_s, above=0)
        check_number("ringing (µm)", self.ringing_um, at_least=0)
        check_number("ringing time (s)", self.ringing_s, above=0)
        for backlash in self.backlash_um:
            check_number("backlash (µm)", backlash, at_least=0)


class SimStage:
    """A simulated stage; see `StageModel`.

    Parameters
    ----------
    time, model, faults
        Clock, motion, and faults.
    slip_um
        Displacement of the source along x during an encoder fault; lost steps displace it twice as far along y (µm).
    """

    name = "simulated stage"

    def __init__(
        self,
        time: TimeSource,
        model: StageModel | None = None,
        faults: Iterable[DeviceFault] = (),
        *,
        slip_um: float = 20.0,
    ) -> None:
        self.model = model or StageModel()
        self._time = time
        self.faults = FaultSchedule(faults, STAGE_FAULTS)
        self._start: Point = (0.0, 0.0, 0.0)
        self._target: Point = self._start
        self._began = self._ends = time.monotonic()
        self._true: Point = self._start
        self._drift: Point = self.model.drift_um_s
        self._lost = False
        self._off: Point = (0.0, 0.0, 0.0)
        self._slip_um = slip_um
        # after this time, the ringing is below 0.1 nm and ignored, so that positions repeat exactly
        self._quiet_s = self.model.ringing_s * math.log(max(self.model.ringing_um, 1e-4) / 1e-4)
        self.moves = 0

    @property
    def waits(self) -> bool:
        """Whether moves take real time."""
        return not isinstance(self._time, VirtualTime)

    @property
    def limits(self) -> Limits:
        """Travel of each axis (µm)."""
        return self.model.limits

    def move(self, target: Point) -> None:
        """Begin to move; raises an error for a target beyond the limits, as a controller does."""
        active = self.faults.next_call()
        self._check_connected("stage vanishes" in active)
        if any(not lo <= t <= hi for t, (lo, hi) in zip(target, self.limits, strict=True)):
            raise StageError.expected("stage", f"a target within {self.limits} µm", target, "correct the plan")
        if "move fails" in active:
            raise StageError("simulated stage: move refused because of the simulated fault 'move fails'; try again")
        here = self.position()
        # ringing stays within the backlash and does not move the source
        self._true = self._follow(here if self._time.monotonic() < self._ends else self._settled())
        # the read-back shows neither: a wrong count lasts for one move, lost steps remain
        lost = self._off[1] + 2 * self._slip_um * ("loses steps" in active and not self._off[1])
        self._off = self._slip_um * ("encoder off" in active), lost, 0.0
        # the read-back shows it: the encoder sees where the motor stopped
        short = 0.6 if "stops short" in active else 1.0
        self._start = here
        self._target = _between(here, target, short) if short < 1 else target
        self._drift = (400.0, 0.0, 0.0) if "drifts" in active else self.model.drift_um_s
        self._began = self._time.monotonic()
        way = max(abs(t - h) for t, h in zip(self._target, here, strict=True))
        self._ends = math.inf if "never arrives" in active else self._began + way / self.model.velocity_um_s
        self.moves += 1

    def moving(self) -> bool:
        """Return whether the move is in progress."""
        self._check_connected(False)
        return self._time.monotonic() < self._ends

    def position(self) -> Point:
        """Return the positions of the encoders on the motors (µm)."""
        self._check_connected(False)
        now = self._time.monotonic()
        if now < self._ends:
            return self._on_the_way(now)
        rest = now - self._ends
        if rest > self._quiet_s:
            return self._settled()
        ring = self.model.ringing_um * math.exp(-rest / self.model.ringing_s)
        x, y, z = (p + ring * (t != s) for p, t, s in zip(self._settled(), self._target, self._start, strict=True))
        return x, y, z

    def true_position(self) -> Point:
        """Return the true position of the source: the read-back with backlash and slips (µm)."""
        x, y, z = (p + off for p, off in zip(self._follow(self.position()), self._off, strict=True))
        return x, y, z

    def stop(self) -> None:
        """Stop at the present position."""
        self._check_connected(False)
        now = self._time.monotonic()
        if now < self._ends:
            self._true = self._follow(self._on_the_way(now))
            self._start = self._target = self._on_the_way(now)
            self._ends = now

    def bump(self, by_um: Point) -> None:
        """Displace the resting stage (µm), as by a knock against the table; its encoders detect it."""
        x, y, z = (t + d for t, d in zip(self._target, by_um, strict=True))
        self._target = x, y, z

    def home(self) -> None:
        """Begin to move to (0, 0, 0)."""
        self.move((0.0, 0.0, 0.0))

    def close(self) -> None:
        """Do nothing."""

    def _on_the_way(self, now: float) -> Point:
        way = self.model.velocity_um_s * (now - self._began)
        x, y, z = (
            h + math.copysign(min(way, abs(t - h)), t - h) for h, t in zip(self._start, self._target, strict=True)
        )
        return x, y, z

    def _settled(self) -> Point:
        """Return the positions of the motors after arrival, without ringing."""
        # exactly the target, so that positions are reproduced bit by bit
        if self._drift == (0.0, 0.0, 0.0):
            return self._target
        rest = self._time.monotonic() - self._ends
        x, y, z = (t + d * rest for t, d in zip(self._target, self._drift, strict=True))
        return x, y, z

    def _follow(self, motor: Point) -> Point:
        """Return the source's position for motors at ``motor``: the source is dragged at the ends of the backlash."""
        x, y, z = (min(max(t, m), m + b) for t, m, b in zip(self._true, motor, self.model.backlash_um, strict=True))
        return x, y, z

    def _check_connected(self, vanishes: bool) -> None:
        self._lost = self._lost or vanishes
        if self._lost:
            raise DeviceLost(
                "simulated stage: connection lost because of the simulated fault 'stage vanishes'; connect again"
            )


def _between(a: Point, b: Point, share: float) -> Point:
    x, y, z = (p + share * (q - p) for p, q in zip(a, b, strict=True))
    return x, y, z
