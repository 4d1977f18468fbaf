"""The table of all patterns of a plane, and what is collected of the plane."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.aperture import Aperture
from lfcal.psf.quality.dark import Dark
from lfcal.psf.quality.kernels import FRAME_COLUMNS, FrameTable, Lit, frame_pass
from lfcal.psf.quality.lattice import SpotLattice
from lfcal.psf.quality.periodicity import Periodicity
from lfcal.threads import for_each_chunk

__all__ = ["Frames", "PlaneMeasures"]


NOISELESS = 3000.0
"""Peak over noise from which on a matrix was computed, not recorded."""


@dataclass(slots=True)
class PlaneMeasures:
    """What was measured of a plane.

    Attributes
    ----------
    values
        Value by metric key; a metric that could not be measured is absent.
    maps
        Value per position ``(ny, nx)`` by metric key.
    named
        Positions a metric names, ``(ny, nx)`` flags by metric key.
    details
        Words by metric key.
    lit
        Whether there is light in the plane.
    energy
        Mean energy of a good pattern.
    spread
        Second moment of the depth-plane sum (pixels squared); NaN where it cannot be relied on.
    locked
        Whether each pattern is the image of a single lenslet, which does not follow the source.
    spots
        The spots' lattice, where there is one.
    tiling
        What control frames said, where there were some.
    sample
        Some of the patterns, weighted for comparison with other planes.
    """

    lit: bool
    energy: float
    peak: float
    dark: Dark
    aperture: Aperture
    spread: float = math.nan
    locked: bool = False
    spots: SpotLattice | None = None
    tiling: Periodicity | None = None
    sample: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, np.float32))
    values: dict[str, float] = field(default_factory=dict)
    maps: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    named: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    details: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Frames:
    """The table of `lfcal.psf.quality.kernels.frame_pass` over a plane.

    Attributes
    ----------
    table, digest
        Columns ``(ny, nx, 10)`` and a checksum of each pattern ``(ny, nx)``.
    lit, sensor
        How often each pixel is lit, of the cutout ``(nt, ns)`` and of the sensor ``(nt + ny - 1, ns + nx - 1)``.
    floor, peak
        What lit pixels exceed, and the median peak over the background.
    tolerance
        Values this close are the same.
    computed
        Whether the plane has so little noise that it was computed, not recorded: equal peaks are no sign of
        saturation then, nor nulls of dead pixels.
    """

    table: NDArray[np.float64]
    digest: NDArray[np.uint64]
    lit: NDArray[np.int32]
    sensor: NDArray[np.int32]
    floor: float
    peak: float
    tolerance: float
    computed: bool

    @staticmethod
    def of(plane: NDArray[np.float32], dark: Dark, workers: int | None = None) -> Frames:
        """Return the table of plane ``(ny, nx, nt, ns)``, by rows of positions in threads."""
        ny, nx, nt, ns = plane.shape
        some = plane.reshape(ny * nx, -1)[:: max(1, ny * nx // 64)]
        tops = np.where(np.isfinite(some), some, -np.inf).max(1)
        peak = float(np.median(tops)) - dark.background
        floor = dark.background + max(4 * dark.noise, 0.003 * peak)
        tolerance = 0.25 * dark.noise
        table = np.zeros((ny, nx, len(FRAME_COLUMNS)))
        digest = np.zeros((ny, nx), np.uint64)

        def rows(start: int, stop: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
            lit = np.zeros((nt, ns), np.int32)
            sensor = np.zeros((nt + ny - 1, ns + nx - 1), np.int32)
            for y in range(start, stop):
                bits = plane[y].view(np.uint32)
                counted = Lit(floor, tolerance, lit, sensor[y : y + nt])
                frame_pass(plane[y], bits, counted, FrameTable(table[y], digest[y]))
            return lit, sensor

        parts = for_each_chunk(rows, ny, workers, parts_per_worker=2)
        lit = np.stack([p[0] for p in parts]).sum(0, dtype=np.int32)
        sensor = np.stack([p[1] for p in parts]).sum(0, dtype=np.int32)
        return Frames(table, digest, lit, sensor, floor, peak, tolerance, peak >= NOISELESS * dark.noise)

    def column(self, name: str) -> NDArray[np.float64]:
        """Return one column of the table, ``(ny, nx)``: see `FRAME_COLUMNS`."""
        return self.table[..., FRAME_COLUMNS.index(name)]
