"""How fast stage and camera are, as forecasts of time use it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lfcal.records import opt

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.camera import Forecast, ScanPlan

__all__ = ["WITHOUT_READOUT", "Pace", "frame_rate", "speed"]

WITHOUT_READOUT = "without readout (--frame-rate)"
"""Of a time that counts no readout."""


def speed() -> float:
    """Return the field of a task for the speed of the stage."""
    return opt(1000.0, "Speed of the stage.", unit="µm/s", above=0, more=True)


def frame_rate() -> float | None:
    """Return the field of a task for the frame rate of the camera."""
    return opt(
        None,
        "Largest frame rate of the camera for the region that is read, as in its data sheet.",
        unit="frames/s",
        above=0,
        empty="readout is not counted",
        more=True,
    )


@dataclass(frozen=True)
class Pace:
    """Speed of the stage (µm/s), and the largest frame rate of the camera, where it is known."""

    stage_um_per_s: float
    frames_per_s: float | None = None

    def forecast(self, plan: ScanPlan, positions: NDArray[np.intp] | None = None) -> Forecast:
        """Return what the scan costs, or what some ``positions`` of it cost."""
        from lfcal.camera import Forecast

        speeds: dict[str, Any] = {"stage_um_per_s": self.stage_um_per_s, "frames_per_s": self.frames_per_s}
        return Forecast.of(plan, **speeds, positions=positions)

    def reading(self, frames: int) -> float:
        """Return the time in hours in which frames are read out; 0 where the frame rate is not known."""
        from lfcal.camera import readout_hours

        return readout_hours(frames, self.frames_per_s) or 0.0

    @property
    def note(self) -> str:
        """What follows a time in messages, with a blank before it; empty where all is counted."""
        return f" {WITHOUT_READOUT}" if self.frames_per_s is None else ""
