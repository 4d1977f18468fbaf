"""What other packages of lfcal use of `lfcal.frames.formats`, and nobody else: it may change."""

from __future__ import annotations

from lfcal.frames.formats.codecs import codec_fact
from lfcal.frames.formats.opening import FORMATS, image_suffixes, open_image, read_image

__all__ = [
    "FORMATS",
    "codec_fact",
    "image_suffixes",
    "open_image",
    "read_image",
]
