"""Names of `lfcal.frames.formats` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.frames.formats._axes import FramesLast
from lfcal.frames.formats.codecs import codec_fact
from lfcal.frames.formats.hdf5 import stacks_in
from lfcal.frames.formats.image_file import (
    FORMATS,
    container_in,
    image_suffixes,
    open_image,
    read_image,
    split_dataset,
)

__all__ = [
    "FORMATS",
    "FramesLast",
    "codec_fact",
    "container_in",
    "image_suffixes",
    "open_image",
    "read_image",
    "split_dataset",
    "stacks_in",
]
