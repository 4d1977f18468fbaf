"""Motion of the light with the stage: the axes that move it right and down on the sensor, and the start of the scan."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, StorageError
from lfcal.camera import ScanPlan, StageAxes
from lfcal.frames.orientation import AS_IS, AUTO, CHECK, ORIENTATIONS, Orientation, named_orientation

__all__ = [
    "AUTO",
    "CHECK",
    "CentroidMotion",
    "Part",
    "StageOrientation",
    "centre_of_light",
    "find_stage_orientation",
    "image_motion",
    "spread_out",
    "turn_of",
]

MAX_FRAMES = 16
"""Number of frames that are read."""


@dataclass(frozen=True, eq=False)
class CentroidMotion:
    """Motion of the centroid of the light on the sensor over the positions of a scan.

    Attributes
    ----------
    matrix
        Motion (down, right; px) per step along the two lateral axes, ``(2, 2)``; each column belongs to one axis.
    start
        Fitted row and column of the centroid (px) at the first position along both axes.
    rms_px
        Rms distance of the centroids from the fitted motion, over the frames (px).
    middle
        Fitted row and column of the centroid (px) at the middle of the positions.
    shape
        Rows and columns of the frames.
    """

    matrix: NDArray[np.float64]
    start: tuple[float, float]
    rms_px: float
    middle: tuple[float, float]
    shape: tuple[int, int]

    def axes(self) -> tuple[tuple[int, int], tuple[int, int]] | None:
        """Return which lateral axis moves the light down, and which to the right; None if the motion is unclear.

        Each is (axis, sign). The axis is a column of ``matrix``, 0 or 1. The sign is -1 if steps along the axis move
        the light up or to the left, else 1.
        """
        down, right = np.abs(self.matrix)
        order = (int(down.argmax()), int(right.argmax()))
        main = np.array([down[order[0]], right[order[1]]])
        aside = np.array([down[1 - order[0]], right[1 - order[1]]])
        # one step is one pixel; lenslet patterns make the centre of light jump by some pixels
        if order[0] == order[1] or (main < 0.5).any() or (main > 2).any() or (aside > 0.5 * main).any():
            return None
        sense = [int(np.sign(self.matrix[row, axis])) for row, axis in enumerate(order)]
        return (order[0], sense[0]), (order[1], sense[1])

    def on_sensor(self, part: Part, sensor: tuple[int, int]) -> CentroidMotion:
        """Return the motion in pixels of the upright sensor.

        ``sensor`` is its shape (rows, columns), and ``part`` is the part of it that the frames show.
        """
        turn = named_orientation(part.turn)
        first = np.array(part.origin)
        last = first + turn.inverse.shape(self.shape) - 1
        by = turn.places([first, last], turn.inverse.shape(sensor)).min(axis=0)
        start, middle = (float(self.start[0] + by[0]), float(self.start[1] + by[1])), self.middle + by
        return replace(self, start=start, middle=(float(middle[0]), float(middle[1])), shape=sensor)


class Part(NamedTuple):
    """Part of the sensor that frames show.

    ``origin`` is the position (row, column) on the sensor of their first pixel before they are turned. ``turn`` is the
    name, in `lfcal.frames.ORIENTATIONS`, of the orientation that makes the frames upright.
    """

    origin: tuple[int, int]
    turn: str = AS_IS


def spread_out(index: NDArray[np.intp], count: int = MAX_FRAMES) -> NDArray[np.intp]:
    """Return the numbers of up to ``count`` rows of ``index`` ``(N, 2)`` whose positions are far apart.

    The first one has the smallest sum of indices. Each next one is the farthest from those already chosen.
    """
    chosen = [int(np.argmin(index.sum(axis=1)))]
    distance = np.full(len(index), np.inf)
    while len(chosen) < min(count, len(index)):
        distance = np.minimum(distance, np.hypot(*(index - index[chosen[-1]]).T))
        far = int(distance.argmax())
        if distance[far] == 0:
            break
        chosen.append(far)
    return np.array(chosen, np.intp)


def image_motion(read: Callable[[int], NDArray[Any]], index: NDArray[np.intp]) -> CentroidMotion | None:
    """Return the motion of the centroid of light over the frames of one plane; None if it cannot be determined.

    The minimum of each pixel over the frames (dark level, hot pixels) is subtracted, and values within the noise are
    ignored. Damaged frames are skipped.

    Parameters
    ----------
    read
        Function that returns frame k, ``(rows, columns)``.
    index
        Position numbers ``(n, 2)`` of the frames along the first and the second lateral axis.
    """
    if np.ptp(index, axis=0).min() < 2:
        return None
    good: list[int] = []
    floor: NDArray[Any] | None = None
    for k in range(len(index)):
        try:
            frame = read(k)
        except (FileFormatError, StorageError):
            continue  # damaged frames are refused or left out later, when all frames are read
        if floor is None or frame.shape == floor.shape:
            floor = frame if floor is None else np.minimum(floor, frame)
            good.append(k)
    if floor is None:
        return None
    # read again instead of stored: sixteen frames of a large sensor are gigabytes
    centres = np.array([centre_of_light(read(k).astype(np.float32) - floor) for k in good]).reshape(-1, 2)
    seen = np.isfinite(centres).all(axis=1)
    places = index[good][seen]
    if len(places) < 6 or np.ptp(places, axis=0).min() < 2:
        return None
    design = np.column_stack([np.ones(len(places)), places])
    fitted, *_ = np.linalg.lstsq(design, centres[seen], rcond=None)
    rms = float(np.sqrt(((design @ fitted - centres[seen]) ** 2).sum(axis=1).mean()))
    middle = fitted[0] + (index.min(axis=0) + index.max(axis=0)) / 2 @ fitted[1:]
    rows, columns = floor.shape[:2]
    start, halfway = ((float(at[0]), float(at[1])) for at in (fitted[0], middle))
    return CentroidMotion(fitted[1:].T, start, rms, halfway, (rows, columns))


def centre_of_light(light: NDArray[np.float32]) -> tuple[float, float]:
    """Return row and column (px) of the centroid of the light above the noise; both are NaN if there is no such light.

    The threshold is the median plus 5 standard deviations of the noise, or plus 2 % of the difference between maximum
    and median, whichever is higher.
    """
    level = float(np.median(light))
    noise = 1.4826 * float(np.median(np.abs(light - level)))
    light = light - np.float32(level + max(5 * noise, 0.02 * (float(light.max()) - level)))
    np.maximum(light, 0, out=light)
    total = float(light.sum(dtype=np.float64))
    if total <= 0:
        return float("nan"), float("nan")
    rows, columns = (light.sum(axis=axis, dtype=np.float64) for axis in (1, 0))
    return float(rows @ np.arange(len(rows)) / total), float(columns @ np.arange(len(columns)) / total)


@dataclass(frozen=True, slots=True)
class StageOrientation:
    """Stage axes and the orientation of frames that they imply, with an alternative if the light allows one.

    Attributes
    ----------
    stage
        The stage axes.
    turn
        Orientation that would make the frames upright.
    other
        Alternative: orientation that would make the frames upright if the plan's axes are correct. None: there is no
        alternative.
    """

    stage: StageAxes
    turn: Orientation
    other: Orientation | None = None


def turn_of(stage: StageAxes, light: CentroidMotion, lateral: tuple[int, int]) -> Orientation | None:
    """Return the orientation of frames that reconciles the motion of their light with the stage axes.

    The result is None if the motion is unclear, or if there is no such orientation. ``lateral`` contains the indices of
    the first and the second lateral axis in (x, y, z).
    """
    seen = light.axes()
    if seen is None:
        return None
    moves, wanted = np.zeros((2, 2)), np.zeros((2, 2))
    for row, ((axis, sense), said) in enumerate(zip(seen, (stage.down, stage.right), strict=True)):
        moves[row, axis] = sense
        wanted[row, lateral.index("xyz".index(said[1]))] = 1 if said[0] == "+" else -1
    return next((turn for turn in ORIENTATIONS.values() if np.array_equal(turn.moves() @ moves, wanted)), None)


def find_stage_orientation(
    allowed: Sequence[StageAxes], light: CentroidMotion, plan: ScanPlan, lateral: tuple[int, int], choice: str
) -> StageOrientation | None:
    """Return the stage axes and frame orientation that explain the motion of the light; None if no ``allowed`` axes do.

    If the frames are certainly flipped or turned, the plan's axes are preferred, so that only the frames need turning.

    Parameters
    ----------
    allowed
        Axes consistent with the numbers of steps, those nearest to the plan first.
    light
        Motion of the light in the frames.
    plan
        Scan plan with the expected frames and axes.
    lateral
        Indices of the first and the second lateral axis in (x, y, z).
    choice
        What to assume if the light does not show whether the axes or the frames differ from the plan. ``"check"``: the
        axes differ. ``"auto"``: the frames are turned. Any other value: the frames are known to be upright.
    """
    found = [StageOrientation(stage, turn) for stage in allowed if (turn := turn_of(stage, light, lateral)) is not None]
    upright = next((one for one in found if one.turn.name == AS_IS), None)
    if choice not in (CHECK, AUTO):
        return upright
    shaped = [one for one in found if one.turn.shape(light.shape) == plan.camera.sensor.shape]
    if shaped and upright not in shaped:
        upright = None
    found = shaped or found
    own = next((one for one in found if _lateral(one.stage) == _lateral(plan.stage)), None)
    if own is None or upright is None or own is upright:
        # a possible one, or if none is, the one nearest to the planned position of the light
        return own or upright or min(found, key=lambda one: _away(one, light, plan), default=None)
    if_frames, if_scan = _away(own, light, plan), _away(upright, light, plan)
    # positions in cropped frames are meaningless; a stage's origin is only accurate to a part of the cutout
    slack = max(2.0, 0.1 * max(plan.cutout), 2 * light.rms_px)
    if shaped and abs(if_frames - if_scan) >= max(2 * slack, min(if_frames, if_scan)):
        return own if if_frames < if_scan else upright
    return own if choice == AUTO else StageOrientation(upright.stage, upright.turn, own.turn)


def _lateral(stage: StageAxes) -> tuple[str, str]:
    return stage.right, stage.down


def _away(one: StageOrientation, light: CentroidMotion, plan: ScanPlan) -> float:
    """Return the distance of the middle of the light's path, after turning upright, from that of the plan (px)."""
    ends: NDArray[np.float64] = plan.image_px([(0, 0, 0), (0, plan.period[0] - 1, plan.period[1] - 1)])
    return math.dist(one.turn.places(light.middle, light.shape), ends.mean(axis=0))
