"""The table of all patterns of a plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import centre, for_each_chunk
from lfcal.judge.quality._dark import DarkCorners
from lfcal.judge.quality._kernels import FRAME_COLUMNS, PatternSums, frame_pass

__all__ = ["PatternTable"]


FRAME_S, PIXEL_S = 2e-8, 2e-6
"""Additional processor time (s) of `_frame_sums` instead of `frame_pass`, per value, and per pixel of each row."""

NOISELESS = 3000.0
"""Ratio of peak to noise above which a matrix was computed instead of recorded."""


@dataclass(frozen=True, slots=True, eq=False)
class PatternTable:
    """Table of the properties of each pattern of a plane.

    Attributes
    ----------
    table, digest
        Columns `FRAME_COLUMNS` ``(ny, nx, 10)``, and a checksum of each pattern ``(ny, nx)``.
    lit, sensor
        Number of times that each pixel of the cutout ``(nt, ns)``, and of the sensor ``(nt + ny - 1, ns + nx - 1)``,
        is lit.
    dark
        Measurements of the dark corners.
    floor, peak
        Value above which a pixel is lit, and the median peak of some patterns above the background.
    tolerance
        Difference below which values count as equal.
    """

    table: NDArray[np.float64]
    digest: NDArray[np.uint64]
    lit: NDArray[np.int32]
    sensor: NDArray[np.int32]
    dark: DarkCorners
    floor: float
    peak: float
    tolerance: float

    @staticmethod
    def of(plane: NDArray[np.float32], dark: DarkCorners, workers: int | None = None) -> PatternTable:
        """Return the table of the patterns ``(ny, nx, nt, ns)`` of a plane, whose dark corners are ``dark``."""
        ny, nx, nt, ns = plane.shape
        some = plane.reshape(ny * nx, -1)[:: max(1, ny * nx // 64)]
        tops = np.where(np.isfinite(some), some, -np.inf).max(1)
        # the median over some patterns, because a hot pixel or a reflection in one of them is not a peak
        peak = float(np.median(tops)) - dark.background
        # weights exclude noise; without noise, they exclude the far tails of a model
        floor = dark.background + max(4 * dark.noise, 0.003 * peak)
        tolerance = 0.25 * dark.noise
        table = np.zeros((ny, nx, len(FRAME_COLUMNS)))
        digest = np.zeros((ny, nx), np.uint64)
        measure = _frame_sums if frame_pass.spared(FRAME_S * plane.size + PIXEL_S * ny * nt * ns) else frame_pass

        def rows(start: int, stop: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
            lit = np.zeros((nt, ns), np.int32)
            sensor = np.zeros((nt + ny - 1, ns + nx - 1), np.int32)
            for y in range(start, stop):
                out = PatternSums(table[y], digest[y], lit, sensor[y : y + nt])
                measure(plane[y], plane[y].view(np.uint32), floor, tolerance, out)
            return lit, sensor

        parts = for_each_chunk(rows, ny, workers, parts_per_worker=2)
        lit = np.stack([p[0] for p in parts]).sum(0, dtype=np.int32)
        sensor = np.stack([p[1] for p in parts]).sum(0, dtype=np.int32)
        return PatternTable(table, digest, lit, sensor, dark, floor, peak, tolerance)

    def column(self, name: str) -> NDArray[np.float64]:
        """Return the column ``name`` of `FRAME_COLUMNS`, ``(ny, nx)``."""
        return self.table[..., FRAME_COLUMNS.index(name)]

    @property
    def computed(self) -> bool:
        """Whether the plane has so little noise that it must have been computed instead of recorded.

        In a computed plane, equal peaks do not indicate saturation, and zeros do not indicate dead pixels.
        """
        return self.peak >= NOISELESS * self.dark.noise

    @property
    def light(self) -> NDArray[np.float64]:
        """Energy of each pattern ``(ny, nx)`` without the background."""
        return self.column("energy") - self.dark.background * self.lit.size


def _frame_sums(
    frames: NDArray[np.float32], bits: NDArray[np.uint32], floor: float, tolerance: float, out: PatternSums
) -> None:
    """Do what `frame_pass` does, by numpy."""
    nx, nt, ns = frames.shape
    good = np.isfinite(frames)
    finite = np.where(good, frames, np.float32(0))
    values = finite.astype(np.float64)
    top = np.where(good, frames, np.float32(-np.inf)).max((1, 2)).astype(np.float64)
    lit = values > floor
    weights = np.where(lit, values - floor, 0.0)
    rows, columns = np.arange(nt) - centre(nt), np.arange(ns) - centre(ns)
    weight = weights.sum((1, 2))
    some = np.where(weight > 0, weight, 1.0)
    found = {
        "energy": values.sum(2).sum(1),
        "squares": (finite * finite).sum(2, dtype=np.float64).sum(1),
        "top": top,
        "clipped": (lit & (values >= (top - tolerance)[:, None, None])).sum((1, 2)),
        "nonfinite": (~good).sum((1, 2)),
        "lit": lit.sum((1, 2)),
        "weight": weight,
        "row": weights.sum(2) @ rows / some,
        "column": weights.sum(1) @ columns / some,
        "spread": lit.sum(2) @ rows**2 + lit.sum(1) @ columns**2,
    }
    for column, name in zip(out.table.T, FRAME_COLUMNS, strict=True):
        column[:] = found[name]
    out.digest[:] = 14695981039346656037  # FNV-1a, 64 bits: offset basis, then a prime for each word
    for words in bits.reshape(nx, -1).T:
        out.digest[:] = (out.digest ^ words) * np.uint64(1099511628211)
    out.lit[:] += lit.sum(0, dtype=np.int32)
    for x in range(nx):
        out.sensor[:, x : x + ns] += lit[x]
