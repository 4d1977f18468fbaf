"""Names of `lfcal.frames.sources` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.frames.sources.array import ArraySource
from lfcal.frames.sources.base import FrameOptions, SourceKind
from lfcal.frames.sources.files import open_unplaced
from lfcal.frames.sources.folder import FolderSource

__all__ = [
    "ArraySource",
    "FolderSource",
    "FrameOptions",
    "SourceKind",
    "open_unplaced",
]
