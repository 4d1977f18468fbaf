"""Plans of whole frames with many points each, as a session needs them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan

__all__ = ["FramePlan", "frame_grid", "frame_positions", "read_frame_plan"]


class FramePlan(Protocol):
    """Protocol for the plan of a session of whole frames, such as `lfcal.targets.TargetPlan`.

    A session numbers whole frames as positions: frame ``k`` of plane ``z`` is position ``(z, 0, k)``.
    """

    @property
    def scan(self) -> ScanPlan:
        """The scan plan whose positions the frames show, with its camera, depth planes, exposures and stage axes."""
        ...

    @property
    def frames(self) -> tuple[tuple[int, int], ...]:
        """All frames as (plane index, index within the plane), in the order of recording."""
        ...

    @property
    def lit(self) -> object:
        """For each plane and frame, the indices of the offsets that a display shows; None: frame k shows offset k."""
        ...

    def stage_um(self) -> NDArray[np.float64]:
        """Return the stage coordinates (x, y, z) of all frames (µm), ``(frames, 3)`` in the order of recording."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as plain JSON types."""
        ...


def frame_grid(plan: FramePlan) -> tuple[int, int, int]:
    """Return the shape of the grid of frame numbers: (planes, 1, largest number of frames in a plane)."""
    counts = np.bincount([z for z, _ in plan.frames], minlength=len(plan.scan.depths_um))
    return len(counts), 1, max(1, int(counts.max(initial=0)))


def frame_positions(plan: FramePlan) -> NDArray[np.int64]:
    """Return the positions (z, 0, k) of all frames on the grid of `frame_grid`, ``(frames, 3)`` in recording order."""
    return np.array([(z, 0, k) for z, k in plan.frames], np.int64).reshape(-1, 3)


def read_frame_plan(data: Mapping[str, Any]) -> FramePlan:
    """Return the target plan described by ``data``, as returned by `FramePlan.to_dict`.

    Raises `FileFormatError` or `InputError` if ``data`` does not describe a valid plan.
    """
    from lfcal.targets import TargetPlan  # slow to import, and not needed for single points

    return TargetPlan.from_dict(data)
