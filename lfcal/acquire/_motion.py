"""Move the stage: limits, approach from one side, arrival, settling, read-back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.control import Control
from lfcal.base import check_number
from lfcal.devices import CheckedStage, LimitError, Limits, NotInPosition, Point, StageDevice, StageError, TimeSource

__all__ = ["Motion", "Mover", "check_limits"]

AXES = "xyz"
FIRST_POLL_S = 0.0005
LAST_POLL_S = 0.02


@dataclass(frozen=True, slots=True)
class Motion:
    """Settings for moving the stage.

    Attributes
    ----------
    settle_s
        Waiting time after arrival (s).
    tolerance_um
        Largest difference between read-back and target along x, y and z (µm).
    overshoot_um
        Distance along x, y and z (µm) by which moves in the negative direction first go beyond the target. Every target
        is then approached in the positive direction, which makes backlash constant. 0: approach directly.
    timeout_s
        Longest wait for arrival (s).
    """

    settle_s: float = 0.05
    tolerance_um: tuple[float, float, float] = (1.0, 1.0, 1.0)
    overshoot_um: tuple[float, float, float] = (20.0, 20.0, 20.0)
    timeout_s: float = 60.0

    def __post_init__(self) -> None:
        """Check every value."""
        check_number("settle time (s)", self.settle_s, at_least=0)
        check_number("arrival timeout (s)", self.timeout_s, above=0)
        for tolerance, overshoot in zip(self.tolerance_um, self.overshoot_um, strict=True):
            check_number("position tolerance (µm)", tolerance, above=0)
            check_number("overshoot (µm)", overshoot, at_least=0)


def check_limits(targets: NDArray[np.float64], limits: Limits, overshoot_um: tuple[float, float, float]) -> None:
    """Raise `LimitError` if any of ``targets`` ``(N, 3)`` (µm), or its approach, is beyond the stage's travel."""
    low, high = targets.min(axis=0) - np.array(overshoot_um), targets.max(axis=0)
    for k, axis in enumerate(AXES):
        lo, hi = limits[k]
        if low[k] < lo or high[k] > hi:
            raise LimitError.expected(
                f"stage axis {axis}",
                f"{lo:g} to {hi:g} µm (the limits)",
                f"{low[k]:.6g} to {high[k]:.6g} µm (the plan, including an overshoot of {overshoot_um[k]:g} µm)",
                "move the stage's origin or shrink the plan; nothing was moved",
            )


class Mover:
    """Control of a stage, which moves it to targets and remembers the direction of the last approach.

    Parameters
    ----------
    stage, time
        Stage and clock of the rig.
    motion
        Settings for moving the stage.
    control
        Requests of the user; waiting ends with `Aborted` if an abort is requested.
    """

    def __init__(self, stage: StageDevice, time: TimeSource, motion: Motion, control: Control) -> None:
        self._stage, self._time, self._motion, self._control = CheckedStage.of(stage), time, motion, control
        self._limits = self._stage.limits
        self._last: Point | None = None

    def forget(self) -> None:
        """Approach the next target from its negative side, because the backlash is unknown after a fault."""
        self._last = None

    def go(self, target: Point) -> Point:
        """Move to ``target`` (x, y, z) (µm), wait for arrival, settle, and return the position read back (µm).

        Raises
        ------
        LimitError
            If the target is beyond the stage's travel; nothing was moved.
        StageError, NotInPosition, DeviceLost
            If the stage did not reach the target.
        """
        before = self._before(target)
        for k, (lo, hi) in enumerate(self._limits):
            if not lo <= before[k] <= hi or not lo <= target[k] <= hi:
                raise LimitError.expected(
                    f"stage axis {AXES[k]}", f"{lo:g} to {hi:g} µm", f"{target[k]:g} µm", "correct the plan"
                )
        # the position of the stage is unknown until it has arrived
        self._last = None
        if before != target:
            self._travel(before)
        self._travel(target)
        self._control.sleep(self._motion.settle_s, self._time)
        here = self.check(target)
        self._last = target
        return here

    def check(self, target: Point) -> Point:
        """Return the position read back (µm); raise `NotInPosition` if it is out of tolerance."""
        here = self.position()
        for k, tolerance in enumerate(self._motion.tolerance_um):
            # written so that a read-back of NaN fails too
            if not abs(here[k] - target[k]) <= tolerance:
                raise NotInPosition.expected(
                    f"stage axis {AXES[k]}",
                    f"{target[k]:.6g} ± {tolerance:g} µm",
                    f"{here[k]:.6g} µm",
                    "check the stage, or widen the tolerance",
                )
        return here

    def position(self) -> Point:
        """Return the current position read back from the stage (µm)."""
        return self._stage.position()

    def _before(self, target: Point) -> Point:
        """Return the position to move to first, so that every axis arrives in the positive direction."""
        last, over = self._last, self._motion.overshoot_um
        if last is None:
            return target[0] - over[0], target[1] - over[1], target[2] - over[2]
        x, y, z = (t - o if t < p else t for t, p, o in zip(target, last, over, strict=True))
        return x, y, z

    def _travel(self, target: Point) -> None:
        self._control.check()
        self._stage.move(target, seconds=self._motion.timeout_s, cancelled=self._aborting)
        self._control.check()
        time, deadline, pause = self._time, self._time.monotonic() + self._motion.timeout_s, FIRST_POLL_S
        while self._stage.moving(self._aborting):
            if time.monotonic() > deadline:
                self._stage.stop()
                raise StageError.expected(
                    "stage",
                    f"arrival within {self._motion.timeout_s:g} s",
                    "still moving",
                    "check for an obstacle, or allow a longer time (--move-timeout)",
                )
            time.sleep(pause)
            self._control.check()
            # short moves are polled closely, long ones without loading the controller
            pause = min(pause * 1.5, LAST_POLL_S)

    def _aborting(self) -> bool:
        return self._control.aborting
