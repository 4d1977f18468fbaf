"""What an assembly of H made, and what a user should know of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfcal.frames.orientation import AS_IS, ORIENTATIONS
from lfcal.frames.source import LeftOut, Position
from lfcal.psf.matrix import PSFMatrix

__all__ = ["AssemblyReport"]


@dataclass(frozen=True)
class AssemblyReport:
    """What was assembled, and what is not there.

    Attributes
    ----------
    matrix
        The assembled H, opened from the file, or in memory.
    frames
        Frames read.
    missing, repeated
        Positions without a frame, and positions with several, which are averaged.
    saturated
        Positions with saturated pixels in their pattern; None: unknown for all of them.
    unknown_saturation
        Positions whose saturation is unknown.
    padded
        Positions whose cutout leaves the sensor and was padded with zeros.
    residual_px
        Largest sub-pixel distance (rows, columns) that ``nearest`` left between point and cutout.
    spread
        Median relative difference between repeated frames; None without repeats.
    left_out
        Damaged frames, of positions and dark ones, that were left out.
    orientation
        How the frames were flipped or turned, one of `lfcal.frames.orientation.ORIENTATIONS`.
    """

    matrix: PSFMatrix
    frames: int
    missing: tuple[Position, ...] = ()
    repeated: tuple[Position, ...] = ()
    saturated: int | None = None
    unknown_saturation: int = 0
    padded: tuple[Position, ...] = ()
    residual_px: tuple[float, float] = (0.0, 0.0)
    spread: float | None = None
    left_out: tuple[LeftOut, ...] = ()
    orientation: str = AS_IS

    @classmethod
    def of(
        cls,
        matrix: PSFMatrix,
        frames: int,
        missing: tuple[Position, ...],
        repeated: tuple[Position, ...],
        padded: tuple[Position, ...],
        residual: tuple[float, float],
    ) -> AssemblyReport:
        """Return the report of ``matrix``, whose facts tell of saturation and spread."""
        there = matrix.recorded > 0
        counted = matrix.saturated
        unknown = int(there.sum()) if counted is None else int(((counted < 0) & there).sum())
        known = counted is not None and bool((counted >= 0).any())
        spreads = matrix.facts.spread
        known_spreads = None if spreads is None else spreads[np.isfinite(spreads)]
        return cls(
            matrix,
            frames,
            missing,
            repeated,
            int((counted > 0).sum()) if counted is not None and known else None,
            unknown,
            padded,
            residual,
            float(np.median(known_spreads)) if known_spreads is not None and known_spreads.size else None,
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know, a line each."""
        notes = []
        if self.orientation != AS_IS:
            notes.append(f"the frames are {ORIENTATIONS[self.orientation].words}: turned upright ({self.orientation})")
        if self.left_out:
            notes.append(f"{len(self.left_out)} damaged frames are left out")
        if self.missing:
            notes.append(f"{len(self.missing)} positions are missing, first (z, y, x) = {tuple(self.missing[0])}")
        if self.repeated:
            spread = "" if self.spread is None else f"; they differ by {100 * self.spread:.2g} % (median)"
            notes.append(f"{len(self.repeated)} positions were recorded more than once and are averaged{spread}")
        if self.padded:
            notes.append(f"{len(self.padded)} cutouts leave the sensor and are padded with zeros")
        if self.saturated:
            notes.append(f"{self.saturated} positions have saturated pixels")
        if self.unknown_saturation:
            notes.append(
                f"saturation is unknown at {self.unknown_saturation} positions: "
                "state the bit depth in plan or manifest, or the saturation level"
            )
        return tuple(notes)
