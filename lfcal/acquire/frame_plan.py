"""Plans of whole frames with many points each: the facts about a target's plan needed for acquisition."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan

__all__ = ["FramePlan", "frame_grid", "frame_positions", "read_frame_plan"]


class FramePlan(Protocol):
    """What a session of whole frames records; `lfcal.targets.TargetPlan` is one.

    A session counts its frames by position, whatever they show: frame ``k`` of plane ``z`` is position ``(z, 0, k)``.
    """

    @property
    def scan(self) -> ScanPlan:
        """The scan whose positions the frames show: camera, planes, exposures, stage."""
        ...

    @property
    def frames(self) -> tuple[tuple[int, int], ...]:
        """All frames as (plane, number in it), in the order they are recorded."""
        ...

    @property
    def lit(self) -> object:
        """Which offsets each frame shows, of points that a display switches; None where the stage moves all."""
        ...

    def stage_um(self) -> NDArray[np.float64]:
        """Return the stage's coordinates ``(frames, 3)`` (µm)."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as plain JSON types."""
        ...


def frame_grid(plan: FramePlan) -> tuple[int, int, int]:
    """Return the grid ``(planes, 1, most frames of a plane)`` that a session counts its frames on."""
    counts = np.bincount([z for z, _ in plan.frames], minlength=len(plan.scan.depths_um))
    return len(counts), 1, max(1, int(counts.max(initial=0)))


def frame_positions(plan: FramePlan) -> NDArray[np.int64]:
    """Return the positions ``(frames, 3)`` of a session's frames on that grid, in order."""
    return np.array([(z, 0, k) for z, k in plan.frames], np.int64).reshape(-1, 3)


def read_frame_plan(data: Mapping[str, Any]) -> FramePlan:
    """Return the plan in a session's file; raises `FileFormatError` if it is not one."""
    from lfcal.targets import TargetPlan  # here: a session of single points needs no simulator

    return TargetPlan.from_dict(data)
