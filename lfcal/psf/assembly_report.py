"""Report on an assembled H, with notes for the user."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lfcal.base import format_count
from lfcal.frames import AS_IS, ORIENTATIONS, LeftOut, Position
from lfcal.psf.facts import Origin
from lfcal.psf.matrix import PSFMatrix

__all__ = ["AssemblyReport"]


@dataclass(frozen=True)
class AssemblyReport:
    """Report on the assembly of H: the frames that were used, and the positions that are missing.

    Attributes
    ----------
    matrix
        The assembled H, opened from its file or in memory.
    frames
        Number of recorded frames, without the copies that complete a half-cell scan.
    missing, repeated
        Positions without a frame, and positions with several frames, which were averaged.
    saturated
        Number of positions whose pattern contains saturated pixels. None: unknown for every position.
    unknown_saturation
        Number of positions whose saturation is unknown.
    padded
        Positions whose cutout extends beyond the sensor and was padded with zeros.
    residual_px
        Largest offset (rows, columns; px) of the image of the point from the centre of its cutout. Only ``nearest``
        interpolation leaves such an offset.
    spread
        Median relative rms difference between repeated frames of a position; None without repeated frames.
    left_out
        Damaged frames, including dark frames, that were not used.
    orientation
        Orientation of the recorded frames, which were turned upright before assembly: a key of
        `lfcal.frames.orientation.ORIENTATIONS`.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource
    >>> from lfcal.psf import AssemblyReport, Cutout, assemble
    >>> frames = ArraySource(np.ones((2, 9, 9), np.uint16), [(0, 0, 0), (0, 0, 0)])
    >>> report: AssemblyReport = assemble(frames, (1, 1, 2), Cutout((5, 5), anchor=(4, 4)))
    >>> print(report.missing, report.notes[0])
    (Position(z=0, y=0, x=1),) 1 position was recorded more than once and averaged; they differ by 0 % (median)
    """

    data: ClassVar[str] = "H"

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

    @property
    def known(self) -> str:
        """Clause that states the numbers of frames and recorded positions, for use in a quality verdict."""
        positions = math.prod(self.matrix.shape[:3])
        there = f"{positions - len(self.missing):,} of {format_count(positions, 'position', 'positions')}"
        return f"made of {format_count(self.frames, 'frame', 'frames')}, which show {there}"

    @property
    def filled(self) -> int:
        """Number of missing positions whose patterns were filled in from a fitted model."""
        origin = self.matrix.facts.origin
        return 0 if origin is None else int((origin == Origin.MODEL).sum())

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
        """Return the report on ``matrix``, whose `Facts` determine the numbers on saturation and spread.

        The other arguments are the attributes of the same names; ``residual`` is `residual_px`.
        """
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
        """Notes on the orientation and the averaging of frames, one line each."""
        notes = []
        if self.orientation != AS_IS:
            notes.append(
                f"the frames are {ORIENTATIONS[self.orientation].words} and were turned upright ({self.orientation})"
            )
        if self.repeated:
            spread = "" if self.spread is None else f"; they differ by {100 * self.spread:.2g} % (median)"
            again = format_count(len(self.repeated), "position was", "positions were")
            notes.append(f"{again} recorded more than once and averaged{spread}")
        return tuple(notes)
