"""Detect flipped or rotated frames of a scan: compare a few patterns with the camera in all eight orientations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, any_of
from lfcal.camera import ScanPlan
from lfcal.fit import Fineness, Setup, predict
from lfcal.frames import AS_IS, ORIENTATIONS, Orientation
from lfcal.frames.lists import centre_of_light
from lfcal.simulate.engines import EnergyError

__all__ = ["SeenPattern", "TurnedFrames", "find_turned_frames", "seen_patterns"]

REACH = 2
"""Largest distance of the image from the centre of the light (pixels)."""

EXPLAINED = 0.2
"""Largest unexplained fraction of the light in a reported orientation."""

BETTER = 0.5
"""Largest ratio of the residual in a reported orientation to that as delivered."""

EQUALLY_GOOD = 1.25
"""Largest residual, relative to the best orientation's, of an orientation that explains patterns equally well."""


@dataclass(frozen=True, eq=False)
class SeenPattern:
    """A frame minus its median, the index of its plane, and the centre of its light (row, column) (px)."""

    frame: NDArray[np.float32]
    z: int
    place: tuple[float, float]


@dataclass(frozen=True, slots=True)
class TurnedFrames:
    """Orientations in which patterns match those of the camera much better than as delivered.

    Attributes
    ----------
    turns
        Orientations of the frames, the best one first; several if they explain the patterns about equally well.
    residual, as_is
        Fraction of the squared light that remains unexplained in the best orientation, and in the orientation as
        delivered.
    """

    turns: tuple[Orientation, ...]
    residual: float
    as_is: float

    @property
    def words(self) -> str:
        """Text that states the orientation of the frames, with the evidence."""
        ways = any_of(turn.words for turn in self.turns)
        left = f"unexplained light: {100 * self.residual:.0f} % when upright, {100 * self.as_is:.0f} % as delivered"
        return f"{ways} relative to the camera ({left})"

    @property
    def options(self) -> str:
        """The command-line options that turn the frames upright."""
        return any_of(f"--orientation {turn.option}" for turn in self.turns)


def seen_patterns(
    read: Callable[[int], NDArray[Any]], positions: NDArray[np.intp], plan: ScanPlan
) -> list[SeenPattern]:
    """Return the patterns of up to four frames: two of the first and two of the last plane, far apart in the period.

    Planes without frames, and frames without light, are omitted.

    Parameters
    ----------
    read
        Function that returns the frame with index k, as in ``positions``.
    positions
        Position ``(n, 3)`` of each frame as (z, y, x).
    plan
        Plan of the scan.
    """
    ny, nx = plan.period
    found = []
    for z in sorted({0, plan.shape[0] - 1}):
        own = np.flatnonzero(positions[:, 0] == z)
        for y, x in ((ny // 4, nx // 4), (3 * ny // 4, 3 * nx // 4)):
            if not len(own):
                continue
            k = own[np.abs(positions[own, 1:] - (y, x)).sum(axis=1).argmin()]
            frame = np.asarray(read(int(k)), np.float32)
            frame = frame - np.float32(np.median(frame))
            place = centre_of_light(frame)
            if np.isfinite(place).all():
                found.append(SeenPattern(frame, z, place))
    return found


def find_turned_frames(seen: Sequence[SeenPattern], plan: ScanPlan) -> TurnedFrames | None:
    """Return the orientations in which patterns match the camera.

    The result is None if they match as delivered or in no orientation. It is also None if no conclusion is possible.
    This is the case if there are no patterns, or the frames do not have the shape of the sensor. It is also the case if
    the position of the lattice is only assumed, or the camera cannot be simulated. Orientations that exchange rows and
    columns are compared only on a square sensor.

    Parameters
    ----------
    seen
        Patterns from `seen_patterns`.
    plan
        Plan of the scan, for the frames as delivered.
    """
    sensor, marks = plan.camera.sensor.shape, plan.camera.marks
    # an array with an unknown position cannot be mirrored
    if not seen or marks["lattice.offset_um"] == "assumed" or any(one.frame.shape != sensor for one in seen):
        return None
    setup = Setup(plan.camera, (), (0.0,) * plan.shape[0])
    left = {}
    for turn in ORIENTATIONS.values():
        if turn.shape(sensor) == sensor:
            try:
                alike = float(np.median([_alike(one, turn, plan, setup) for one in seen]))
            except (InputError, EnergyError):  # a camera that cannot be simulated gives no evidence
                return None
            left[turn.name] = 1 - alike**2
    best = min(left.values())
    if best > EXPLAINED or best > BETTER * left[AS_IS]:
        return None
    turns = sorted((name for name in left if left[name] <= EQUALLY_GOOD * best), key=lambda name: left[name])
    return TurnedFrames(tuple(ORIENTATIONS[name] for name in turns), best, left[AS_IS])


def _alike(one: SeenPattern, turn: Orientation, plan: ScanPlan, setup: Setup) -> float:
    """Return the largest correlation of a pattern with those of the camera near the centre of its light."""
    frame = turn.apply(one.frame)
    corner = np.rint(turn.places(one.place, one.frame.shape)).astype(int) - REACH
    own = replace(plan, anchor=(float(corner[0]), float(corner[1])))
    index = np.array([(one.z, y, x) for y, x in np.ndindex(2 * REACH + 1, 2 * REACH + 1)])
    index = index[(index[:, 1:] < np.array(plan.period)).all(axis=1)]
    best = 0.0
    model = predict(setup, own, index, np.zeros((len(index), 2)), Fineness.coarse)
    for (_, y, x), pattern in zip(index, model, strict=True):
        top, left = (int(c + k - n // 2) for c, k, n in zip(corner, (y, x), plan.cutout, strict=True))
        if min(top, left) < 0:
            continue
        part = frame[top : top + plan.cutout[0], left : left + plan.cutout[1]]
        size = float(np.linalg.norm(part)) * float(np.linalg.norm(pattern))
        if part.shape == pattern.shape and size > 0:
            best = max(best, float((part * pattern).sum(dtype=np.float64)) / size)
    return best
