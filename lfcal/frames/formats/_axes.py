"""Axes of arrays that contain frames: axes of length 1, and frames along the last axis."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, format_bytes
from lfcal.frames.formats.image_file import ImageFile

__all__ = ["FramesLast", "used_axes"]

LARGEST = 4 << 30
"""Largest size of a stack with frames along the last axis, which is rearranged in memory (bytes)."""


def used_axes(shape: Sequence[int]) -> tuple[int, ...]:
    """Return the axes of an array of frames; of four axes, the first of length 1 is left out (such as colour)."""
    single = [axis for axis, length in enumerate(shape) if length == 1]
    if len(shape) != 4 or not single:
        return tuple(range(len(shape)))
    # of several, the first: frames of one row or column are still frames
    return tuple(axis for axis in range(4) if axis != single[0])


class FramesLast(ImageFile):
    """A stack with axes (row, column, frame): each page of ``stack`` is one row of all frames.

    The complete stack is read with the first frame, because every frame is spread over the whole file.

    Raises
    ------
    InputError
        If the stack is too large to be read at once.
    """

    def __init__(self, stack: ImageFile) -> None:
        self._stack = stack
        self.path, self.dtype = stack.path, stack.dtype
        self.shape = (stack.pages, stack.shape[0])
        self.pages = stack.shape[1]
        self.metadata = stack.metadata
        size = self.pages * int(np.prod(self.shape)) * self.dtype.itemsize
        if size > LARGEST:
            raise InputError.expected(
                f"{self.path}, frames along the last axis",
                f"at most {format_bytes(LARGEST)}",
                format_bytes(size),
                "move that axis to the front, for example with numpy.moveaxis(frames, -1, 0)",
            )
        self._frames: NDArray[Any] | None = None
        self._lock = threading.Lock()

    def read(self, page: int = 0) -> NDArray[Any]:
        """Return frame ``page``, ``(rows, columns)``."""
        self.check_page(page)
        with self._lock:  # threads would otherwise each rearrange the stack
            if self._frames is None:
                frames = np.empty((self.pages, *self.shape), self.dtype)
                for row in range(self.shape[0]):
                    frames[:, row, :] = self._stack.read(row).T
                self._frames = frames
            return np.array(self._frames[page])

    def close(self) -> None:
        """Close the file."""
        self._frames = None
        self._stack.close()
