"""Stage axes and the way frames lie, told apart: both turn the path of the light."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan, StageAxes
from lfcal.frames.lists.motion import CentroidMotion
from lfcal.frames.orientation import AS_IS, AUTO, CHECK, ORIENTATIONS, Orientation

__all__ = ["AUTO", "CHECK", "Lie", "stage_and_lie", "turn_of"]


@dataclass(frozen=True, slots=True)
class Lie:
    """Stage axes, the orientation that frames would then need, and the other reading where both would look the same.

    Attributes
    ----------
    stage
        The axes.
    turn
        What would make the frames upright.
    other
        What would make them upright if the plan's axes were right; None where the light rules that out.
    """

    stage: StageAxes
    turn: Orientation
    other: Orientation | None = None


def turn_of(stage: StageAxes, light: CentroidMotion, lateral: tuple[int, int]) -> Orientation | None:
    """Return what makes upright the frames that light of clear axes was seen in, if the axes are those of ``stage``."""
    seen = light.axes()
    if seen is None:
        return None
    moves, wanted = np.zeros((2, 2)), np.zeros((2, 2))
    for row, ((axis, sense), said) in enumerate(zip(seen, (stage.down, stage.right), strict=True)):
        moves[row, axis] = sense
        wanted[row, lateral.index("xyz".index(said[1]))] = 1 if said[0] == "+" else -1
    return next((turn for turn in ORIENTATIONS.values() if np.array_equal(turn.moves() @ moves, wanted)), None)


def stage_and_lie(
    allowed: Sequence[StageAxes], light: CentroidMotion, plan: ScanPlan, lateral: tuple[int, int], choice: str
) -> Lie | None:
    """Return the axes that light of clear axes is read with; None if none of those ``allowed`` has it in such frames.

    Frames that are certainly flipped or turned keep the plan's axes, so that turning them is all that is to be done.

    Parameters
    ----------
    allowed
        Axes that the numbers of steps allow, the nearest to the plan's first.
    light
        As seen in the frames.
    plan
        What frames and axes should be like.
    lateral
        Which of (x, y, z) are the first and second lateral axis.
    choice
        ``"check"``: where both would look the same the axes are otherwise than the plan says; ``"auto"``: the frames
        are turned; else the frames are known to be upright.
    """
    found = [Lie(stage, turn) for stage in allowed if (turn := turn_of(stage, light, lateral)) is not None]
    upright = next((lie for lie in found if lie.turn.name == AS_IS), None)
    if choice not in (CHECK, AUTO):
        return upright
    shaped = [lie for lie in found if lie.turn.shape(light.shape) == plan.camera.sensor.shape]
    if shaped and upright not in shaped:
        upright = None
    found = shaped or found
    own = next((lie for lie in found if _lateral(lie.stage) == _lateral(plan.stage)), None)
    if own is None or upright is None or own is upright:
        # one of them, or where neither can be, the one that is nearest to where the plan has the light
        return own or upright or min(found, key=lambda lie: _away(lie, light, plan), default=None)
    if_frames, if_scan = _away(own, light, plan), _away(upright, light, plan)
    # the places of cropped frames mean nothing; a stage's origin is not better than some of the cutout
    slack = max(2.0, 0.1 * max(plan.cutout), 2 * light.rms_px)
    if shaped and abs(if_frames - if_scan) >= max(2 * slack, min(if_frames, if_scan)):
        return own if if_frames < if_scan else upright
    return own if choice == AUTO else Lie(upright.stage, upright.turn, own.turn)


def _lateral(stage: StageAxes) -> tuple[str, str]:
    return stage.right, stage.down


def _away(lie: Lie, light: CentroidMotion, plan: ScanPlan) -> float:
    """Return how far the middle of the light's path, turned upright, lies from that of the plan's (px)."""
    ends: NDArray[np.float64] = plan.image_px([(0, 0, 0), (0, plan.period[0] - 1, plan.period[1] - 1)])
    return math.dist(lie.turn.places(light.middle, light.shape), ends.mean(axis=0))
