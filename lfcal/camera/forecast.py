"""Forecast of the time, disk space and memory of a scan."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import check_number
from lfcal.camera.plan import ScanPlan

__all__ = ["Forecast", "readout_hours"]

MIN_RATE = 1e-6
"""Smallest speed of a stage (µm/s) and frame rate (frames/s) accepted: slower scans would not end."""


def readout_hours(frames: int, frames_per_s: float | None) -> float | None:
    """Return the time to read out and transfer ``frames`` frames (h); None if the camera's rate is unknown.

    ``frames_per_s`` is the camera's largest frame rate. The stage moves, and the next exposure begins, only after a
    frame has arrived. The readout time is therefore added to the exposure time, even for cameras that can expose and
    read out simultaneously.
    """
    if frames_per_s is None:
        return None
    check_number("frame rate (frames/s)", frames_per_s, at_least=MIN_RATE)
    return frames / frames_per_s / 3600


@dataclass(frozen=True, slots=True)
class Forecast:
    """Time, disk space and memory required to record a `ScanPlan` and to assemble its H.

    Attributes
    ----------
    positions, frames
        Number of source positions, and number of recorded frames, which is larger if frames are averaged.
    exposure_hours, settle_hours, move_hours
        Total time for exposures, for settling and for moves of the stage (h).
    readout_hours
        Total readout time (h), which `hours` includes; None if the frame rate of the camera is unknown.
    frame_bytes, cutout_bytes
        Size of all frames as delivered by the camera, and size of one uint16 cutout for each position (bytes).
    h_float32_bytes, h_rounded_bytes
        Size of H as float32 without compression, and largest expected size of an H file with values rounded to 16 bits
        (bytes). HT is stored only if it is exported.
    assembly_bytes
        Peak memory of the assembly of H: two float32 planes (bytes).

    Examples
    --------
    >>> from lfcal.camera import Forecast, ScanPlan, preset
    >>> plan = ScanPlan.for_camera(preset("r29"), virtual_depths=[2, 3, 5], cutout=301, exposure_s=0.1, settle_s=0.2)
    >>> cost = Forecast.of(plan)
    >>> print(cost.positions, f"positions: {cost.hours:.2f} h, H of at most {cost.h_rounded_bytes / 1e9:.2f} GB")
    15675 positions: 1.41 h, H of at most 3.73 GB
    """

    positions: int
    frames: int
    exposure_hours: float
    settle_hours: float
    move_hours: float
    readout_hours: float | None
    frame_bytes: int
    cutout_bytes: int
    h_float32_bytes: int
    h_rounded_bytes: int
    assembly_bytes: int

    @property
    def hours(self) -> float:
        """Total recording time (h), including the readout time if it is known."""
        return self.exposure_hours + self.settle_hours + self.move_hours + (self.readout_hours or 0.0)

    @property
    def bytes_per_s(self) -> float:
        """Average data rate of the camera (bytes/s): size of all complete frames divided by the total time.

        It is infinite if the total time is 0.
        """
        return self.frame_bytes / (3600 * self.hours) if self.hours else math.inf

    @property
    def ht_float32_bytes(self) -> int:
        """Size of HT as float32 without compression (bytes), as in an export."""
        return self.h_float32_bytes

    def to_dict(self) -> dict[str, Any]:
        """Return all values, including the derived ones, as plain JSON types."""
        names = ("hours", "bytes_per_s", "ht_float32_bytes")
        return asdict(self) | {name: getattr(self, name) for name in names}

    @classmethod
    def of(
        cls,
        plan: ScanPlan,
        *,
        stage_um_per_s: float = 1000.0,
        frames_per_s: float | None = None,
        positions: NDArray[np.intp] | None = None,
    ) -> Forecast:
        """Return the forecast of ``plan`` for a stage that moves all axes simultaneously at ``stage_um_per_s`` (µm/s).

        ``frames_per_s`` is the largest frame rate of the camera for the region that it reads out. None: unknown.
        ``positions`` contains the indices (z, y, x) of the positions to record, ``(n, 3)``, in the order of recording.
        None: all positions of the plan. The size of H does not depend on ``positions``.
        """
        check_number("stage speed (µm/s)", stage_um_per_s, at_least=MIN_RATE)
        _, ny, nx, nt, ns = plan.shape
        per_plane = ny * nx
        pixels = math.prod(plan.camera.sensor.shape)
        if positions is None:
            planes = [per_plane] * len(plan.depths_um)
        else:
            planes = np.bincount(positions[:, 0], minlength=len(plan.depths_um)).tolist()
        count = sum(planes)
        frames = count * plan.frames_averaged
        entries = plan.n_positions * nt * ns
        return cls(
            positions=count,
            frames=frames,
            exposure_hours=sum(plan.exposures[z] * n for z, n in enumerate(planes)) * plan.frames_averaged / 3600,
            settle_hours=count * plan.settle_s / 3600,
            move_hours=_travel_um(plan, positions) / stage_um_per_s / 3600,
            readout_hours=readout_hours(frames, frames_per_s),
            # cameras deliver up to 8 bits in one byte, up to 16 in two
            frame_bytes=frames * pixels * (1 if plan.camera.sensor.bit_depth <= 8 else 2),
            cutout_bytes=2 * count * nt * ns,
            h_float32_bytes=4 * entries,
            h_rounded_bytes=21 * entries // 8,
            assembly_bytes=2 * per_plane * nt * ns * 4,
        )


def _travel_um(plan: ScanPlan, positions: NDArray[np.intp] | None) -> float:
    """Return the path length of the stage (µm); each move counts with the axis that travels farthest."""
    # all steps of a row are equal, so the ends of the rows suffice if there are no gaps
    path = plan.stage_um(plan.row_ends() if positions is None else positions)
    # the axes move simultaneously, so the longest component determines the duration
    return float(np.abs(np.diff(path, axis=0)).max(axis=1).sum()) if len(path) > 1 else 0.0
