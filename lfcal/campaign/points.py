"""The points of a target's frames: labelled, and where each is on the sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, drained
from lfcal.camera import half_extent_px
from lfcal.frames import FrameSource
from lfcal.targets import FoundPoints, Mistake, TargetPlan, find_points, frames_of

__all__ = ["Points", "iter_points_of", "points_of"]

F8 = NDArray[np.float64]

DIM = 0.2
"""Light over that of the median hole below which a point is not used."""

SURE = 0.3
"""Least confidence in a label."""

BESIDE_PX = 0.5
"""Middle of the light beside the lattice from which on a pattern is not of one hole alone; or six times the rms."""


@dataclass(frozen=True, eq=False)
class Points:
    """Points of a target's frames that can be used: their cutouts are on the sensor whole, their labels certain.

    Attributes
    ----------
    plan
        What was recorded.
    frame, z
        Frame and plane of each ``(n,)``.
    holes
        Labels ``(n, 2)`` as (row, column).
    pixels
        Sensor position ``(n, 2)`` of each chief ray (row, column); the cutout lies about the nearest pixel.
    brightness
        Light of each, over that of the median hole in its frame ``(n,)``.
    away_um
        Depth of each, by the pose of the target in its frame ``(n,)`` (µm).
    found
        What was found in each frame, by its number.
    """

    plan: TargetPlan
    frame: NDArray[np.intp]
    z: NDArray[np.intp]
    holes: NDArray[np.intp]
    pixels: F8
    brightness: F8
    away_um: F8
    found: Mapping[int, FoundPoints]

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.frame)

    @property
    def middles(self) -> NDArray[np.intp]:
        """The pixel ``(n, 2)`` at the middle of each cutout."""
        whole: NDArray[np.intp] = np.floor(self.pixels + 0.5).astype(np.intp)
        return whole

    @property
    def residuals(self) -> F8:
        """What is left of each position ``(n, 2)`` (pixels)."""
        rest: F8 = self.pixels - self.middles
        return rest

    def only(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> Points:
        """Return some of them."""
        names = ("frame", "z", "holes", "pixels", "brightness", "away_um")
        return replace(self, **{name: getattr(self, name)[which] for name in names})

    def region(self, k: int) -> tuple[slice, slice]:
        """Return the cutout of point ``k`` on the sensor."""
        (row, column), (nt, ns) = self.middles[k].tolist(), self.plan.scan.cutout
        top, left = row - (nt - 1) // 2, column - (ns - 1) // 2
        return slice(top, top + nt), slice(left, left + ns)

    def alone(self, k: int) -> NDArray[np.bool_]:
        """Return which pixels of the cutout of point ``k`` no neighbour's pattern reaches ``(nt, ns)``."""
        found, scan = self.found[int(self.frame[k])], self.plan.scan
        rows, columns = (np.arange(part.start, part.stop) for part in self.region(k))
        radius = half_extent_px(scan.camera, scan.depths_um[int(self.z[k])])
        away = np.abs(found.pixels - self.pixels[k]).max(1)
        near = (away < radius + max(scan.cutout)) & (found.holes != self.holes[k]).any(1)
        out = np.ones((len(rows), len(columns)), np.bool_)
        for row, column in found.pixels[near].tolist():
            out &= np.hypot(rows[:, None] - row, columns[None, :] - column) > radius
        return out

    @property
    def mistakes(self) -> tuple[tuple[Mistake, int], ...]:
        """What is not as described, each with the number of frames that show it; the most frequent first."""
        counts: dict[tuple[str, tuple[tuple[int, int], ...]], tuple[Mistake, int]] = {}
        for found in self.found.values():
            for one in found.mistakes:
                first, count = counts.get((one.kind, one.holes), (one, 0))
                counts[one.kind, one.holes] = first, count + 1
        return tuple(sorted(counts.values(), key=lambda pair: -pair[1]))


def iter_points_of(source: FrameSource, plan: TargetPlan, frames: Sequence[int] | None = None) -> Work[Points]:
    """Find the points of all frames.

    Parameters
    ----------
    source
        Whole frames, with their dark level subtracted: hand over the corrected view. ``metadata.target_frames``, or
        else the plan's order, says which frame is which.
    plan
        The target, and where it was moved.
    frames
        Which are read; None: all.

    Yields
    ------
    Progress
        In frames.

    Raises
    ------
    InputError
        If frames and plan do not belong together, or a frame's points cannot be labelled.
    """
    order = frames_of(source, plan)
    chosen = list(range(len(source))) if frames is None else list(frames)
    clock, found = Clock("find points", len(chosen)), {}
    yield clock.at(0)
    for done, k in enumerate(chosen, 1):
        found[k] = _of_frame(source, plan, k, order[k])
        yield clock.at(done)
    use = {k: _usable(one, plan) for k, one in found.items()}
    points = Points(
        plan,
        np.concatenate([np.full(len(use[k]), k, np.intp) for k in found]),
        np.concatenate([np.full(len(use[k]), order[k][0], np.intp) for k in found]),
        np.concatenate([one.holes[use[k]] for k, one in found.items()]),
        np.concatenate([one.pixels[use[k]] for k, one in found.items()]),
        np.concatenate([one.light[use[k]] / np.median(one.light) for k, one in found.items()]),
        np.concatenate([one.away_um[use[k]] for k, one in found.items()]),
        found,
    )
    if not len(points):
        raise InputError.expected("points of the frames", "some that can be used", "none", "check lamp and target")
    return points


points_of = drained(iter_points_of)


def _of_frame(source: FrameSource, plan: TargetPlan, k: int, at: tuple[int, int]) -> FoundPoints:
    z, number = at
    scan, label = plan.scan, source.info(k).label or f"frame {k}"
    # saturated pixels are the brightest: the middle of the light is nearer with them than without
    values = np.asarray(source.samples(k).values, np.float64)
    try:
        return find_points(values, plan.target, scan.camera, scan.depths_um[z], offset_px=plan.offsets_px[z][number])
    except InputError as error:
        raise InputError(f"{label}: {error}") from None


def _usable(found: FoundPoints, plan: TargetPlan) -> NDArray[np.intp]:
    """Return which points can be used."""
    half = (np.array(plan.scan.cutout) - 1) // 2
    middles = np.floor(found.pixels + 0.5)
    usable = ((middles >= half) & (middles <= np.array(plan.scan.camera.sensor.shape) - 1 - half)).all(1)
    usable &= (found.light > DIM * np.median(found.light)) & (found.confidence > SURE)
    usable &= np.linalg.norm(found.deviation, axis=1) < max(BESIDE_PX, 6 * found.fit.rms_px)
    return np.flatnonzero(usable)
