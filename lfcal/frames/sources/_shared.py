"""What other packages of lfcal use of `lfcal.frames.sources`, and nobody else: it may change."""

from __future__ import annotations

from lfcal.frames.sources.array import ArraySource
from lfcal.frames.sources.base import FrameOptions, SourceKind
from lfcal.frames.sources.folder import FolderSource

__all__ = [
    "ArraySource",
    "FolderSource",
    "FrameOptions",
    "SourceKind",
]
