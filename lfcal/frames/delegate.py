"""The common part of frame sources that look at another one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lfcal.frames.source import FrameSource, Position
from lfcal.frames.stack import frame_drift, frame_exposure

__all__ = ["SourceView"]


class SourceView:
    """The frames of ``source`` seen otherwise: everything but the pixels is passed on."""

    def __init__(self, source: FrameSource) -> None:
        self.source = source

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of every frame."""
        return self.source.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type of every frame."""
        return self.source.dtype

    @property
    def metadata(self) -> Mapping[str, Any]:
        """What is known of the frames."""
        return self.source.metadata

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.source)

    def position(self, index: int) -> Position:
        """Return the scan position of frame ``index``."""
        return self.source.position(index)

    def exposure_s(self, index: int) -> float | None:
        """Return the exposure of frame ``index`` (s), or None."""
        return frame_exposure(self.source, index)

    def drift(self, index: int) -> tuple[float, float]:
        """Return the drift ``(dy, dx)`` of frame ``index`` (px)."""
        return frame_drift(self.source, index)

    def label(self, index: int) -> str:
        """Return the name of the frame."""
        return self.source.label(index)
