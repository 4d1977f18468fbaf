"""Base class of frame sources that view another one."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Region
from lfcal.frames.source import FrameInfo, FrameMetadata, Frames, FrameSource, Samples

__all__ = ["SourceView"]


class SourceView(Frames):
    """Base class of frame sources that show the frames of another source in changed form.

    The metadata of a view are those of ``source`` with the changes made by `derived`.
    """

    def __init__(self, source: FrameSource) -> None:
        self.source = source

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of every frame (px)."""
        return self.source.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type of every frame."""
        return self.source.dtype

    @cached_property
    def known(self) -> FrameMetadata:
        """Metadata of the frames of ``source``, before the changes made by `derived`."""
        return FrameMetadata.of(self.source.metadata)

    @cached_property
    def metadata(self) -> FrameMetadata:
        """Metadata common to all frames, computed once."""
        return self.derived(self.known)

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return the metadata of this view, given those of the viewed frames, ``known``."""
        return known

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.source)

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index``."""
        return self.source.info(index)

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the samples of frame ``index`` in the source, or only those in ``region``.

        A view that changes pixels or levels overrides this method.
        """
        return self.source.samples(index, region)

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return the pixels of frame ``index`` in the source, or only those in ``region``."""
        return self.source.read(index, region)

    def close(self) -> None:
        """Close the files that the source keeps open."""
        if isinstance(self.source, Frames):
            self.source.close()
