"""Small frames and matrices whose truth is known by construction."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.axes import Region
from lfcal.frames.source import FrameInfo, FrameMetadata, Frames, Position


class ListSource(Frames):
    """Frames in a list; independent of the library's readers."""

    def __init__(self, frames: list[NDArray[Any]], positions: list[tuple[int, int, int]]) -> None:
        self.frames, self.positions = frames, positions
        self.reads = 0

    @property
    def shape(self) -> tuple[int, int]:
        return self.frames[0].shape  # type: ignore[return-value]

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.frames[0].dtype

    @property
    def metadata(self) -> FrameMetadata:
        return FrameMetadata()

    def __len__(self) -> int:
        return len(self.frames)

    def info(self, index: int) -> FrameInfo:
        return FrameInfo((Position(*self.positions[index]),), label=f"frame {index}")

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        self.reads += 1
        frame = self.frames[index]
        return (frame if region is None else frame[region]).copy()


def coded_frames(
    shape: tuple[int, int, int] = (2, 3, 4), sensor: tuple[int, int] = (32, 40), seed: int = 0
) -> tuple[ListSource, NDArray[np.uint16]]:
    """Random 16-bit frames, one per position, and the stack ``(nz, ny, nx, rows, columns)`` they come from."""
    stack = np.random.default_rng(seed).integers(0, 60000, (*shape, *sensor), np.uint16)
    positions = [(z, y, x) for z in range(shape[0]) for y in range(shape[1]) for x in range(shape[2])]
    return ListSource([stack[p] for p in positions], positions), stack


@pytest.fixture
def frames() -> tuple[ListSource, NDArray[np.uint16]]:
    return coded_frames()
