"""Binary PGM frames of 8 and 16 bits; samples are not scaled to the declared maximum."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, check_region, storage_errors
from lfcal.frames.formats.codecs import codec_fact
from lfcal.frames.formats.image_file import Format, ImageFile, check_declared

__all__ = ["PgmImage"]

_HEADER = re.compile(rb"P5(?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})\s")


class PgmImage(ImageFile):
    """A binary PGM file (``P5``) of one frame."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with storage_errors(path):
            stored = path.stat().st_size
            with path.open("rb") as file:
                head = _HEADER.match(file.read(4096))
        columns, rows, top = (int(n) for n in head.groups()) if head else (0, 0, 0)
        if head is None or not 0 < top < 65536:
            raise FileFormatError.expected(
                str(path), "a PGM header with a maximum value of 1 … 65535", "none", "record or copy it again"
            )
        self._stored = np.dtype(np.uint8 if top < 256 else ">u2")
        check_declared(path, (rows, columns), self._stored.itemsize, stored)
        need = head.end() + rows * columns * self._stored.itemsize
        if stored < need:
            raise FileFormatError.expected(
                str(path), f"{need} bytes", f"{stored}", "the file is cut short; record or copy it again"
            )
        self._offset = head.end()
        self.shape = (rows, columns)
        self.dtype = self._stored.newbyteorder("=")
        self.metadata = {"saturation": float(top), "codec": codec_fact("none")}

    def read(self, page: int = 0) -> NDArray[Any]:
        """Return the frame, ``(rows, columns)``."""
        return self.read_region(page, slice(0, self.shape[0]), slice(0, self.shape[1]))

    def read_region(self, page: int, rows: slice, columns: slice) -> NDArray[Any]:
        """Return the part ``[rows, columns]`` of the frame."""
        self.check_page(page)
        rows, columns = check_region((rows, columns), self.shape)
        with storage_errors(self.path), self.path.open("rb") as file:
            file.seek(self._offset + rows.start * self.shape[1] * self._stored.itemsize)
            count = (rows.stop - rows.start) * self.shape[1]
            data = np.fromfile(file, self._stored, count)
        if data.size != count:
            raise FileFormatError.expected(
                str(self.path), f"{count} samples", data.size, "the file is cut short; copy it again"
            )
        return np.ascontiguousarray(data.reshape(-1, self.shape[1])[:, columns], self.dtype)


FORMAT = Format("PGM", frozenset({".pgm"}), lambda head, _: head[:2] == b"P5", lambda path, *_: PgmImage(path))
