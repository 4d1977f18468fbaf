"""Planes, rows and columns of a scan in stage coordinates of any unit and rotation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError

__all__ = ["PlaneGrid", "ScanGrid", "find_grid"]

CONE = 0.6
"""Largest ratio of lateral to forward part of a step along an axis: the scan may be rotated by up to 30 degrees."""
NEIGHBOURS = 13
"""Number of nearest positions examined: enough steps along each axis, even if positions were recorded several times."""


@dataclass(frozen=True, eq=False)
class PlaneGrid:
    """One plane of a scan.

    Attributes
    ----------
    frames
        Frames of the list in this plane.
    height
        Mean coordinate along the depth axis.
    steps
        ``(2, 2)``: the step along the first lateral axis, and along the second, as rows; both positive in their axis.
    index
        ``(n, 2)`` whole numbers from 0: column along the first axis, row along the second, of each frame.
    """

    frames: NDArray[np.intp]
    height: float
    steps: NDArray[np.float64]
    index: NDArray[np.intp]

    @property
    def counts(self) -> tuple[int, int]:
        """Number of columns and rows of the frames along the first and the second lateral axis."""
        first, second = self.index.max(axis=0) + 1
        return int(first), int(second)


@dataclass(frozen=True, eq=False)
class ScanGrid:
    """All planes of a scan, in the order of rising depth coordinate."""

    planes: tuple[PlaneGrid, ...]

    @property
    def counts(self) -> tuple[int, int]:
        """Number of columns and rows along the two lateral axes: the largest of any plane."""
        first, second = (max(plane.counts[k] for plane in self.planes) for k in (0, 1))
        return first, second

    def index(self, frames: int) -> NDArray[np.intp]:
        """Return the plane and the two lateral position numbers of each frame in the list, ``(frames, 3)``."""
        found = np.zeros((frames, 3), np.intp)
        for k, plane in enumerate(self.planes):
            found[plane.frames, 0] = k
            found[plane.frames, 1:] = plane.index
        return found


def find_grid(
    lateral: NDArray[np.float64], depth: NDArray[np.float64], name: str, *, counted: bool = False
) -> ScanGrid:
    """Return the regular grid of the stage positions in a list.

    The first estimate of a step is the most frequent difference between neighbours along each axis. Therefore order,
    unit, rotation (up to 30 degrees) and missing positions do not matter. Steps are then fitted to all positions.

    Parameters
    ----------
    lateral
        ``(N, 2)`` coordinates across the camera's axis.
    depth
        ``(N,)`` coordinates along the camera's axis.
    name
        Name of the list, for messages.
    counted
        Whether ``depth`` contains plane numbers, which are not compared with steps.

    Raises
    ------
    InputError
        If the positions of a plane do not form a grid.
    """
    if counted:
        heights, label = np.unique(depth, return_inverse=True)
    else:
        label, heights = _levels(depth, _spacing(lateral, depth))
    groups = [np.flatnonzero(label == k) for k in range(len(heights))]
    planes = [
        _plane(lateral[members], members, float(height), name) for members, height in zip(groups, heights, strict=True)
    ]
    return ScanGrid(tuple(planes))


def _spacing(lateral: NDArray[np.float64], depth: NDArray[np.float64]) -> float:
    """Return the typical distance between neighbouring positions."""
    if len(lateral) < 2:
        return 0.0
    lengths, _ = _neighbours(np.column_stack([lateral, depth]))
    nearest = lengths.min(axis=1)
    return float(np.median(nearest[np.isfinite(nearest)])) if np.isfinite(nearest).any() else 0.0


def _neighbours(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return distances and indices of the nearest positions; repetitions of a position itself are at infinity."""
    from scipy.spatial import cKDTree  # a fifth of a second

    lengths, near = cKDTree(points).query(points, k=min(NEIGHBOURS + 1, len(points)))
    lengths, near = np.asarray(lengths)[:, 1:], np.asarray(near)[:, 1:]
    # the farthest neighbour is one or more steps away, a repetition only as much as the stage's noise
    return np.where(lengths > 0.1 * lengths[:, -1:], lengths, np.inf), near


def _levels(values: NDArray[np.float64], step: float) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the level of each value, and the mean of each level.

    Levels are separated by far more than their width.
    """
    order = np.argsort(values, kind="stable")
    gaps = np.diff(values[order])
    label = np.zeros(len(values), np.intp)
    if gaps.size and values.max() - values.min() > 0.5 * step:
        floor = max(1e-4 * float(values.max() - values.min()), 1e-12)
        ranked = np.sort(np.maximum(gaps, floor))
        jump = int(np.argmax(ranked[1:] / ranked[:-1])) if len(ranked) > 1 else -1
        # gaps of similar size mean one frame per level
        threshold = ranked[jump] if jump >= 0 and ranked[jump + 1] > 3 * ranked[jump] else 0.5 * ranked[0]
        label[order[1:]] = np.cumsum(gaps > threshold)
    means = np.bincount(label, values) / np.bincount(label)
    return label, means


def _plane(points: NDArray[np.float64], frames: NDArray[np.intp], height: float, name: str) -> PlaneGrid:
    steps = _steps(points)
    index = np.zeros((len(points), 2))
    # from the middle outwards, where the accumulated error of the step is smallest
    origin = np.array(points[np.argmin(np.abs(points - np.median(points, axis=0)).sum(axis=1))], np.float64)
    for _ in range(4):
        index = np.round(np.linalg.solve(steps.T, (points - origin).T).T)
        design = np.column_stack([np.ones(len(points)), index])
        spans = np.ptp(index, axis=0) > 0
        used = np.array([True, *spans])
        fitted = np.asarray(np.linalg.lstsq(design[:, used], points, rcond=None)[0], np.float64)
        origin = fitted[0]
        steps[spans] = fitted[1:]
        if spans.sum() == 1:
            steps[~spans] = _across(fitted[1], int(spans.argmin()))
    rest = np.linalg.solve(steps.T, (points - origin).T).T - index
    if np.sqrt((rest**2).mean()) > 0.2:
        raise InputError.expected(
            f"{name}, stage positions of plane {height:g}",
            "a grid of rows and columns",
            f"positions up to {np.abs(rest).max():.2f} steps off a grid",
            "check the contents of the columns (--columns)",
        )
    return PlaneGrid(frames, height, steps, (index - index.min(axis=0)).astype(np.intp))


def _steps(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the steps along the two axes as rows: the typical one to the nearest neighbours along each."""
    steps = np.zeros((2, 2))
    if len(points) > 1:
        lengths, near = _neighbours(points)
        vectors = points[near] - points[:, None]
        for axis in (0, 1):
            along, aside = vectors[..., axis], vectors[..., 1 - axis]
            ahead = np.where((along > 0) & (np.abs(aside) < CONE * along), lengths, np.inf)
            first = ahead.argmin(axis=1)
            there = np.flatnonzero(np.isfinite(ahead[np.arange(len(points)), first]))
            if there.size:
                found = vectors[there, first[there]]
                middle = np.median(found, axis=0)
                # rounded steps have a few lengths, and their median is one of them; the mean has no such systematic
                # error
                like = np.linalg.norm(found - middle, axis=1) <= np.linalg.norm(middle) / 3
                steps[axis] = found[like].mean(axis=0)
    for axis in (0, 1):
        if not steps[axis].any():  # for a single row or column, the step across it equals that along it
            other = steps[1 - axis] if steps[1 - axis].any() else np.eye(2)[1 - axis]
            steps[axis] = _across(other, axis)
    return steps


def _across(other: NDArray[np.float64], axis: int) -> tuple[float, float]:
    """Return a step along ``axis``, as long as ``other``, the step along the other axis, and perpendicular to it."""
    return (-other[1], other[0]) if axis == 1 else (other[1], -other[0])
