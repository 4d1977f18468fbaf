"""Completion of a half-cell scan: a frame is also used for the unrecorded position half a period away."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Region
from lfcal.camera import HalfCell, ScanPlan, half_cell
from lfcal.frames.source import FrameInfo, FrameMetadata, FrameSource, Position, Samples
from lfcal.frames.view import SourceView

__all__ = ["HalfCellSource", "with_partners"]


class HalfCellSource(SourceView):
    """The frames of ``source``, followed by copies that fill the unrecorded positions half a period away.

    Parameters
    ----------
    source
        Corrected, upright frames of single points.
    cell
        Symmetry of the half cell.
    shape
        Number of positions ``(nz, ny, nx)`` of the plan.
    """

    def __init__(self, source: FrameSource, cell: HalfCell, shape: tuple[int, int, int]) -> None:
        super().__init__(source)
        self._cell = cell
        index = np.array([tuple(source.info(k).position) for k in range(len(source))], np.intp).reshape(-1, 3)
        inside = ((index >= 0) & (index < np.array(shape))).all(axis=1)
        partners = cell.partners(index)
        recorded = np.zeros(shape, np.bool_)
        recorded[tuple(index[inside].T)] = True
        there = np.flatnonzero(inside)
        self._frames = there[~recorded[tuple(partners[there].T)]]
        self._partners, self._moved = partners[self._frames], (partners - index)[self._frames, 1:]
        self.filled = np.unique(np.ravel_multi_index(tuple(self._partners.T), shape))
        """Filled positions, as numbers ``(z * ny + y) * nx + x``."""

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return the metadata ``known``, with details of the copies as ``half_cell``."""
        ends = np.flatnonzero(np.diff(self.filled) != 1)
        first = self.filled[np.r_[0, ends + 1]] if len(self.filled) else self.filled
        last = self.filled[np.r_[ends, len(self.filled) - 1]] if len(self.filled) else self.filled
        facts = {
            "frames": len(self._frames),
            "filled": len(self.filled),
            "shift": list(self._cell.shift),
            "residual_px": list(self._cell.residual_px),
            "positions": np.stack([first, last + 1], axis=1).tolist(),
        }
        return replace(known, half_cell=facts)

    def __len__(self) -> int:
        """Return the number of frames, including the copies."""
        return len(self.source) + len(self._frames)

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index``; those of a copy state the position that it fills."""
        extra = index - len(self.source)
        if extra < 0:
            return self.source.info(index)
        found = self.source.info(int(self._frames[extra]))
        row, column = np.array(found.origin) + self._moved[extra]
        place = Position(*self._partners[extra].tolist())
        return replace(
            found, points=(place,), origin=(int(row), int(column)), label=f"{found.label} for {tuple(place)}"
        )

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index``, or only the part of it in ``region``."""
        return self.source.read(self._frame(index), region)

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the samples of frame ``index``, or only those in ``region``."""
        return self.source.samples(self._frame(index), region)

    def _frame(self, index: int) -> int:
        extra = index - len(self.source)
        return index if extra < 0 else int(self._frames[extra])


def with_partners(source: FrameSource, plan: ScanPlan) -> HalfCellSource:
    """Return the frames of a half-cell scan, completed to those of a full cell.

    Raises
    ------
    InputError
        If the light pattern half a period away differs (`lfcal.camera.half_cell`), or no position needs filling.
    """
    found = HalfCellSource(source, half_cell(plan), plan.shape[:3])
    if not len(found.filled):
        got = "recorded frames at all positions"
        raise InputError.expected(
            "half-cell scan",
            "positions that were not recorded",
            got,
            "do not complete the scan (leave --half-cell out)",
        )
    return found
