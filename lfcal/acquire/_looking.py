"""Move to places and expose there without recording: for the set-up, and for the check of the stage's origin."""

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
    """The stage and the camera of a rig, driven as a session drives them.

    As a context manager, it moves the stage back to its previous place, unless a device failed or it was stopped.

    Parameters
    ----------
    rig, plan, options, control
        As in `Runner`.
    targets
        ``(N, 3)`` all stage coordinates to visit (µm).
    roi
        Region of the sensor to read; the whole sensor by default.
    bracket
        Factors of the exposure; see `Options.bracket`.

    Raises
    ------
    LimitError
        If a target lies beyond the stage's travel; nothing was moved.
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
        # before anything moves: a limit met halfway would leave the stage anywhere
        check_limits(targets, rig.stage.limits, motion.overshoot_um)
        self._time, self._stage = rig.time, rig.stage
        self._mover = Mover(rig.stage, rig.time, motion, control)
        self._exposer = Exposer(rig, control, bracket, sensor.black_level, options.grab_timeout_s)
        self._exposer.read_region(roi or Roi(0, 0, *sensor.shape))

    def __enter__(self) -> Self:
        """Remember where the stage is."""
        self._home = self._stage.position()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Move the stage back to where it was, after an answer or a refusal."""
        if kind is None or issubclass(kind, InputError):
            # a place at the very end of the travel may be out of reach for a stage that approaches from one side
            with suppress(LimitError):
                self._mover.go(self._home)

    @property
    def roi(self) -> Roi:
        """The region of the sensor that is read."""
        return self._exposer.roi

    def go(self, target: Point) -> Point:
        """Move to ``target``, settle, and return the read-back (µm)."""
        try:
            return self._mover.go(target)
        except BaseException:
            # whatever ends a set-up must not leave the stage on its way
            with suppress(Exception):
                self._stage.stop()
            raise

    def expose(self, seconds: float, repeats: int = 1) -> NDArray[Any]:
        """Return a new frame of `roi`, exposed for ``seconds``, the mean of ``repeats``."""
        return self._exposer.expose(seconds, repeats, self._time.monotonic()).data

    def find_spot(self, seconds: float) -> tuple[float, float]:
        """Return where the light of the source is, (row, column) in pixels of the sensor."""
        spot = find_spot(self.expose(seconds))
        return spot.row + self.roi.row, spot.column + self.roi.column
