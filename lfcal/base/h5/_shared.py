"""Names of `lfcal.base.h5` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.base.h5.chunks import FILTER_NAMES, encode_chunk
from lfcal.base.h5.codecs import has_codecs, require_codecs
from lfcal.base.h5.probe import trust
from lfcal.base.h5.reading import Attributes, H5Data, H5File
from lfcal.base.h5.writing import new_h5

__all__ = [
    "FILTER_NAMES",
    "Attributes",
    "H5Data",
    "H5File",
    "encode_chunk",
    "has_codecs",
    "new_h5",
    "require_codecs",
    "trust",
]
