"""A target of many points in the place of the scan: its plan's file, its points on a frame, what is covered. No Qt."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire import CoverageState, LiveCoverage
from lfcal.base import InputError, read_text
from lfcal.camera import ScanPlan
from lfcal.frames import Position
from lfcal_gui.pages.acquire.model_recorder import Recorder, RecordPicture, lamp_words, record_picture

if TYPE_CHECKING:
    from lfcal.targets import TargetPlan

__all__ = ["coverage_picture", "picture_of", "places_px", "points_px", "read_target_plan"]


def read_target_plan(path: str) -> TargetPlan:
    """Return the plan of a target in a file; raises `LfcalError` where there is none."""
    from lfcal.targets import TargetPlan  # here: a page is shown before simulators are loaded

    return TargetPlan.from_json(read_text(Path(path)))


def places_px(
    plan: ScanPlan | TargetPlan, position: Position | None
) -> tuple[tuple[float, float] | None, NDArray[np.float64] | None]:
    """Return where a frame's image of the point is as planned, or else those of a target's points; None: not known."""
    if position is None:
        return None, None
    if not isinstance(plan, ScanPlan):
        return None, points_px(plan, position)
    row, column = plan.image_px(position).tolist()
    return (row, column), None


def points_px(plan: TargetPlan, position: Position) -> NDArray[np.float64]:
    """Return where a frame's images are, as planned, ``(n, 2)`` as (row, column); positions count frames."""
    if position.z >= len(plan.offsets_px) or position.x >= len(plan.offsets_px[position.z]):
        raise InputError.expected("frame of the target", "one of its plan", tuple(position), "open the plan's session")
    return plan.points(position.z, position.x).pixels


def coverage_picture(state: CoverageState, z: int) -> RecordPicture:
    """Return what to draw of a target's recording: frames that show each position, the light of each frame."""
    shown = state.shown[z]
    seen = np.flatnonzero(np.isfinite(state.light))
    number = np.asarray(seen + 1.0, np.float64)
    none = np.zeros(0)
    curves = {
        "energy": (number, state.light[seen]),
        "residual": (none, none),
        "saturated": (number, state.saturated[seen].astype(np.float64)),
    }
    alarms = tuple(one.line for one in state.alarms)
    return RecordPicture(
        shown.astype(np.float64),
        shown > 0,
        np.zeros((1, 1)),
        curves,
        alarms,
        lamp_words(state.lamp),
        False,
        state.done,
        state.total,
        covered=True,
    )


def picture_of(made: Recorder, z: int, quantity: str, earlier: NDArray[np.bool_] | None) -> RecordPicture:
    """Return what to draw of a recording, of single points or of a target; arguments as of `record_picture`."""
    if isinstance(made.quality, LiveCoverage):
        return coverage_picture(made.quality.state(), z)
    return record_picture(made.quality.state(z), made.order, z, quantity, earlier, made.earlier.sum_of(z))
