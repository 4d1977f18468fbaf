"""The common part of frame sources that look at another one."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Region
from lfcal.frames.source import FrameInfo, FrameMetadata, Frames, FrameSource, Samples

__all__ = ["SourceView"]


class SourceView(Frames):
    """The frames of ``source`` seen otherwise: all that is known of them is passed on, pixels are not.

    What a view changes of the metadata it states in `derived`.
    """

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

    @cached_property
    def known(self) -> FrameMetadata:
        """What is known of the frames that are viewed."""
        return FrameMetadata.of(self.source.metadata)

    @cached_property
    def metadata(self) -> FrameMetadata:
        """What is known of all frames, made once."""
        return self.derived(self.known)

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return what is known of this view's frames; ``known`` is that of the frames viewed."""
        return known

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.source)

    def info(self, index: int) -> FrameInfo:
        """Return what is known of frame ``index``."""
        return self.source.info(index)

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the source's samples; a view that changes pixels or levels has its own."""
        return self.source.samples(index, region)

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return the source's pixels."""
        return self.source.read(index, region)

    def close(self) -> None:
        """Release what the source keeps open."""
        if isinstance(self.source, Frames):
            self.source.close()
