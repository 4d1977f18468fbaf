"""The protocol at which real, recorded, imported and simulated frames meet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lfcal.axes import Position

__all__ = ["FrameSource", "Position"]


@runtime_checkable
class FrameSource(Protocol):
    """A set of equally shaped 2-D frames, one per source position.

    Frames come in any order; a position may be missing or given twice. Reading is safe from several threads.
    """

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of every frame."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type of every frame."""
        ...

    @property
    def metadata(self) -> Mapping[str, Any]:
        """What is known of the frames: ``cfa``, ``bit_depth``, ``exposure_s``, ``origin`` …; may be empty."""
        ...

    def __len__(self) -> int:
        """Return the number of frames."""
        ...

    def position(self, index: int) -> Position:
        """Return the scan position of frame ``index``."""
        ...

    def read(self, index: int) -> NDArray[Any]:
        """Return frame ``index`` as a new ``(rows, columns)`` array of `dtype`."""
        ...

    def label(self, index: int) -> str:
        """Return a short name of frame ``index`` for messages, e.g. its file name."""
        ...
