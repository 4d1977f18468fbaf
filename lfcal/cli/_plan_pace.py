"""How fast stage and camera are, as ``lfcal plan`` and ``lfcal acquire --dry-run`` are told it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.camera import Forecast, ScanPlan

__all__ = ["WITHOUT_READOUT", "FrameRateOption", "Pace"]

FrameRateOption: TypeAlias = Annotated[
    float | None,
    typer.Option("--frame-rate", help="Most frames/s that the camera delivers; without it readout is not counted."),
]
"""As a data sheet has it, of the region that is read."""

WITHOUT_READOUT = "without readout (--frame-rate)"
"""Of a time in which none is counted."""


@dataclass(frozen=True)
class Pace:
    """Speed of the stage (µm/s), and the most frames that the camera delivers in a second, where that is known."""

    stage_um_per_s: float
    frames_per_s: float | None = None

    def forecast(self, plan: ScanPlan, positions: NDArray[np.intp] | None = None) -> Forecast:
        """Return what the scan costs; of some ``positions``, where they are named."""
        from lfcal.camera import Forecast

        speeds: dict[str, Any] = {"stage_um_per_s": self.stage_um_per_s, "frames_per_s": self.frames_per_s}
        return Forecast.of(plan, **speeds, positions=positions)

    def reading(self, frames: int) -> float:
        """Return how long so many frames are read out (h); 0 where nothing is known of it."""
        from lfcal.camera import readout_hours

        return readout_hours(frames, self.frames_per_s) or 0.0

    @property
    def note(self) -> str:
        """What is to be said behind a time, a blank before it; empty where all is counted."""
        return f" {WITHOUT_READOUT}" if self.frames_per_s is None else ""
