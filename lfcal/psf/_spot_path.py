"""Find the point's pattern in a few frames of a scan, in any orientation of the frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work
from lfcal.frames import FrameInfo, FrameSource

__all__ = ["SpotPath", "iter_spot_path", "path_frames"]

GRIDS = {1: (4, 5), 2: (3, 3), 3: (2, 3)}
"""Number of rows and columns of positions examined in each plane, by number of planes: about 20 frames in all."""

SIDE = 512
"""Side to which larger frames are reduced by averaging blocks (pixels)."""

DETECT = 6.0
"""Signal-to-noise ratio above which light counts."""

FAINT = 0.05
"""Fraction of the peak below which light is ignored, because fluctuations of the noise would shift a centroid."""


@dataclass(frozen=True, slots=True, eq=False)
class SpotPath:
    """Observed positions of the pattern on the sensor.

    Attributes
    ----------
    indices
        Indices of frames in which light was found ``(n,)``.
    positions
        Scan positions of these frames ``(n, 3)`` as (z, y, x).
    seen
        Centroids of the pattern ``(n, 2)`` as (row, column) on the sensor, in frames as delivered (pixels).
    looked
        Number of frames examined.
    """

    indices: NDArray[np.intp]
    positions: NDArray[np.intp]
    seen: NDArray[np.float64]
    looked: int


def path_frames(infos: Sequence[FrameInfo], shape: tuple[int, int, int]) -> list[int]:
    """Return the numbers of about 20 widely separated frames in the first, middle and last plane of a scan.

    Frames of many points and frames beyond the scan are skipped. Instead of a missing position, the nearest one is
    used.
    """
    known = [k for k, info in enumerate(infos) if len(info.points) == 1]
    at = np.array([infos[k].points[0] for k in known], np.intp).reshape(-1, 3)
    inside = ((at >= 0) & (at < np.array(shape))).all(axis=1)
    numbers, at = np.array(known, np.intp)[inside], at[inside]
    planes = np.unique(at[:, 0])
    planes = np.unique(planes[[0, len(planes) // 2, -1]]) if len(planes) else planes
    found: dict[int, None] = {}
    for z in planes.tolist():
        here = np.flatnonzero(at[:, 0] == z)
        rows, columns = GRIDS[len(planes)]
        for y in np.linspace(0, shape[1] - 1, rows):
            for x in np.linspace(0, shape[2] - 1, columns):
                away = np.hypot(at[here, 1] - y, at[here, 2] - x)
                found[int(numbers[here[int(np.argmin(away))]])] = None
    return list(found)


def iter_spot_path(source: FrameSource, shape: tuple[int, int, int], cutout: tuple[int, int]) -> Work[SpotPath]:
    """Read about 20 frames and find the pattern in each.

    Static content (background, reflections, hot pixels) is subtracted. The pattern is in the window of the cutout's
    size that contains most of the remaining light; its position is the centroid in that window.

    Parameters
    ----------
    source
        Frames as delivered, preferably corrected.
    shape
        Number of positions ``(nz, ny, nx)`` of the scan.
    cutout
        Approximate size of a pattern ``(nt, ns)`` (pixels).
    """
    infos = [source.info(k) for k in range(len(source))]
    chosen = path_frames(infos, shape)
    block = max(1, -(-max(source.shape) // SIDE))
    clock = Clock("examine the frames", len(chosen))
    small: list[NDArray[np.float32]] = []
    for done, index in enumerate(chosen):
        yield clock.at(done)
        small.append(_averaged(source.read(index), block))
    yield clock.at(len(chosen))
    # each cutout shows a different part of the sensor, so none of their pixels can be compared
    still = len(small) >= 6 and len({infos[k].origin for k in chosen}) == 1
    # a third: above the dark frames among them, below a pattern that appears in most of them
    low = len(small) // 3
    common = np.partition(np.stack(small), low, axis=0)[low] if still else np.float32(0)
    side = max(3, round(max(cutout) / block) | 1)
    places = [_place(frame - common, side) for frame in small]
    lit = [k for k, place in enumerate(places) if place is not None]
    seen = np.array([places[k] for k in lit], np.float64).reshape(-1, 2)
    origins = np.array([infos[chosen[k]].origin for k in lit], np.float64).reshape(-1, 2)
    return SpotPath(
        np.array([chosen[k] for k in lit], np.intp),
        np.array([infos[chosen[k]].points[0] for k in lit], np.intp).reshape(-1, 3),
        (seen + 0.5) * block - 0.5 + origins,
        len(chosen),
    )


def _averaged(frame: NDArray[Any], block: int) -> NDArray[np.float32]:
    """Return the means of ``block`` by ``block`` pixels; an incomplete block at the end is left out."""
    values = np.nan_to_num(np.asarray(frame, np.float32), copy=False, posinf=0.0, neginf=0.0)
    if block == 1:
        return values
    rows, columns = (n // block for n in values.shape)
    blocks = values[: rows * block, : columns * block].reshape(rows, block, columns, block)
    means: NDArray[np.float32] = blocks.mean(axis=(1, 3), dtype=np.float32)
    return means


def _place(frame: NDArray[np.float32], side: int) -> tuple[float, float] | None:
    """Return row and column of the pattern's centroid in a window of ``side`` pixels; None without light."""
    from scipy import ndimage

    smooth = ndimage.gaussian_filter(frame, 1.0, mode="nearest")
    level = float(np.median(smooth))
    noise = 1.4826 * float(np.median(np.abs(smooth - level)))
    peak = float(smooth.max()) - level
    if not peak > DETECT * noise:
        return None
    light = np.where(smooth - level > max(DETECT * noise, FAINT * peak), smooth - level, 0)
    crowd = ndimage.uniform_filter(light, side, mode="constant")
    # a plateau has many highest pixels: use their mean, not the first
    at = np.argwhere(crowd >= crowd.max() * (1 - 1e-4)).mean(axis=0)
    half = side / 2
    for _ in range(4):
        low = np.maximum(np.ceil(at - half), 0).astype(int)
        high = np.minimum(np.floor(at + half) + 1, light.shape).astype(int)
        part = light[low[0] : high[0], low[1] : high[1]]
        total = float(part.sum(dtype=np.float64))
        if not total > 0:
            return None
        at = low + [
            float(part.sum(axis=1 - axis, dtype=np.float64) @ np.arange(part.shape[axis])) / total for axis in (0, 1)
        ]
    return float(at[0]), float(at[1])
