"""The public names of `lfcal.frames.formats`, each loaded on first use."""

from __future__ import annotations

from lfcal.frames.formats.image_file import Format, ImageFile, check_declared

__all__ = [
    "Format",
    "ImageFile",
    "check_declared",
]
