"""A recorded session of a target as frames: whole ones, each with all the points that it was planned to show."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording.source import RecordingSource
from lfcal.frames import FrameInfo, FrameMetadata, Position, check_index

if TYPE_CHECKING:
    from lfcal.targets import Phases, TargetPlan

__all__ = ["TargetRecording"]


class TargetRecording(RecordingSource):
    """The acknowledged frames of a target's session, in the plan's order.

    Of a complete session frame ``k`` is frame ``k`` of its plan; `frames` says which it is of one that is not. Each
    frame's ``points`` are the positions that its holes are next to **as planned**, in the order of
    ``target.points(plane, offset)``: where the target really lay is found in the frames. ``metadata`` has the
    ``plan`` of the scan and the ``target`` (`lfcal.targets.TargetPlan`) besides what every session brings.

    Parameters
    ----------
    folder, skip_damaged
        As of `RecordingSource`, which raises the same.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.acquire import Options, TargetRecording, open_session, record
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.targets import Wishes, parse_target, plan_target
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> plan = plan_target(scan, parse_target("array:3x3@2mm"), Wishes(most_frames=3, level="geometric"))
    >>> _ = record(Path("new"), plan, simulated_rig(scan), Options(darks=0, reference_every=0, on_suspect="flag"))
    >>> session: TargetRecording
    >>> with open_session(Path("new")) as session:
    ...     print(len(session), "whole frames", session.shape, "- of", len(session.info(0).points), "points each")
    3 whole frames (320, 320) - of 9 points each
    """

    of_whole_frames = True

    def __init__(self, folder: Path, *, skip_damaged: bool = False) -> None:
        super().__init__(folder, skip_damaged=skip_damaged)

    @property
    def target(self) -> TargetPlan:
        """The plan that was recorded."""
        return self.session.target  # type: ignore[return-value]  # `read_frame_plan` makes no other

    @cached_property
    def frames(self) -> tuple[tuple[int, int], ...]:
        """Plane and offset's number of every frame there is, as in `TargetPlan.frames`."""
        _, _, most = self.session.grid
        return tuple((flat // most, flat % most) for flat in self._flat.tolist())

    def _known(self) -> FrameMetadata:
        # frames are no scan's
        return replace(super()._known(), target=self.target, target_frames=self.frames, plan_shape=None)

    def info(self, index: int) -> FrameInfo:
        """Return what the record of frame ``index`` says, and which positions it was planned to show."""
        k = check_index(index, len(self))
        record = self.record(k)
        return FrameInfo(
            self._points[k],
            (int(record["row"]), int(record["column"])),
            float(record["exposure_s"]),
            saturated=int(record["saturated"]),
            label=self._files[self._where[k]].label(int(self._slots[k])),
        )

    @cached_property
    def _phases(self) -> Phases:
        from lfcal.targets import Phases

        return Phases.of(self.plan)

    @cached_property
    def _points(self) -> list[tuple[Position, ...]]:
        from lfcal.targets import nearest_positions

        found = []
        for z, k in self.frames:
            lit = [self.target.points(z, one).pixels for one in self.target.lit_in(z, k)]
            pixels: NDArray[np.float64] = np.concatenate(lit)
            index = nearest_positions(self._phases, pixels).positions
            found.append(tuple(Position(z, y, x) for y, x in index.tolist()))
        return found
