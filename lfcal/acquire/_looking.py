"""Move and expose without recording: for setting up, and for checking the stage's origin."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire._exposing import Exposer
from lfcal.acquire._motion import Mover, check_limits
from lfcal.acquire.control import Control
from lfcal.acquire.options import Options
from lfcal.acquire.spots import find_spot
from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.devices import LimitError, Point, Rig, Roi

__all__ = ["Looker"]


class Looker:
    """Control of a rig's stage and camera for frames that are not recorded.

    As a context manager, it finally moves the stage back to its previous position, unless a device failed or the user
    stopped it.

    Parameters
    ----------
    rig, plan, options, control
        As in `Runner`.
    targets
        ``(N, 3)`` stage coordinates of all positions to visit (µm).
    roi
        Region of the sensor to read. None: the whole sensor.
    bracket
        Multiples of the exposure time; see `Options.bracket`.

    Raises
    ------
    LimitError
        If a target is beyond the stage's travel; nothing was moved.
    """

    def __init__(
        self,
        rig: Rig,
        plan: ScanPlan,
        options: Options,
        control: Control,
        *,
        targets: NDArray[np.float64],
        roi: Roi | None = None,
        bracket: tuple[float, ...] = (1.0,),
    ) -> None:
        motion, sensor = options.motion(plan), plan.camera.sensor
        # check before anything moves: a limit reached halfway would leave the stage at an unknown position
        check_limits(targets, rig.stage.limits, motion.overshoot_um)
        self._time, self._stage = rig.time, rig.stage
        self._mover = Mover(rig.stage, rig.time, motion, control)
        self._exposer = Exposer(rig, control, bracket, sensor.black_level, options.grab_timeout_s)
        self._exposer.read_region(roi or Roi(0, 0, *sensor.shape))

    def __enter__(self) -> Self:
        """Store the position of the stage."""
        self._home = self._stage.position()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Move the stage back to its previous position, unless a device failed or the user stopped."""
        if kind is None or issubclass(kind, InputError):
            # near the end of the travel, the approach from one side may be impossible
            with suppress(LimitError):
                self._mover.go(self._home)

    @property
    def roi(self) -> Roi:
        """The region of the sensor that is read."""
        return self._exposer.roi

    def go(self, target: Point) -> Point:
        """Move to ``target`` (x, y, z) (µm), settle, and return the position read back (µm)."""
        try:
            return self._mover.go(target)
        except BaseException:
            # whatever ends the set-up, the stage must not keep moving
            with suppress(Exception):
                self._stage.stop()
            raise

    def expose(self, seconds: float, repeats: int = 1) -> NDArray[Any]:
        """Return the mean of ``repeats`` new frames of `roi`, each exposed for ``seconds``."""
        return self._exposer.expose(seconds, repeats, self._time.monotonic()).data

    def find_spot(self, seconds: float) -> tuple[float, float]:
        """Return the position (row, column) of the source's light on the sensor (pixels)."""
        spot = find_spot(self.expose(seconds))
        return spot.row + self.roi.row, spot.column + self.roi.column
