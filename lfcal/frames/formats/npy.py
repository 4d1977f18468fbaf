"""``.npy`` arrays as frames, memory-mapped so that only the requested region is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, UnsafeFileError, check_region, map_npy
from lfcal.frames.formats._axes import used_axes
from lfcal.frames.formats.codecs import codec_fact
from lfcal.frames.formats.image_file import Format, ImageFile, check_samples

__all__ = ["NpyImage"]


class NpyImage(ImageFile):
    """A ``.npy`` file with axes (row, column), (frame, row, column) or (z, y, x, row, column)."""

    def __init__(self, path: Path) -> None:
        self.path = path
        array: Any = map_npy(path)
        array = array.reshape([array.shape[axis] for axis in used_axes(array.shape)])
        if array.dtype.kind not in "iuf":
            raise UnsafeFileError.expected(
                str(path), "whole numbers or floats", f"dtype {array.dtype}", "save it as numbers"
            )
        if array.ndim not in (2, 3, 5) or not array.size:
            raise FileFormatError.expected(
                str(path),
                "axes (row, column), (frame, row, column) or (z, y, x, row, column)",
                f"shape {array.shape}",
                "reshape it",
            )
        self._array = array
        self.shape = (int(array.shape[-2]), int(array.shape[-1]))
        self.dtype = array.dtype.newbyteorder("=")
        self._lead = tuple(int(n) for n in array.shape[:-2])
        self.pages = int(np.prod(self._lead))
        self.metadata = {"codec": codec_fact("none")} | ({"plan_shape": self._lead} if len(self._lead) == 3 else {})

    def read(self, page: int = 0) -> NDArray[Any]:
        """Return a copy of frame ``page``, ``(rows, columns)``."""
        return self.read_region(page, slice(0, self.shape[0]), slice(0, self.shape[1]))

    def read_region(self, page: int, rows: slice, columns: slice) -> NDArray[Any]:
        """Return a copy of the part ``[rows, columns]`` of frame ``page``."""
        rows, columns = check_region((rows, columns), self.shape)
        at = np.unravel_index(self.check_page(page), self._lead) if self._lead else ()
        part = np.array(self._array[(*(int(k) for k in at), rows, columns)], self.dtype, order="C")
        return check_samples(self.path, part)


FORMAT = Format(
    "NPY", frozenset({".npy"}), lambda head, _: head.startswith(b"\x93NUMPY"), lambda path, *_: NpyImage(path)
)
