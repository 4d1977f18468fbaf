"""FITS images as frames: the first uncompressed array of the file that is an image or a stack."""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, check_region, storage_errors
from lfcal.frames.formats.codecs import codec_fact
from lfcal.frames.formats.image_file import Format, ImageFile, check_declared, check_samples

__all__ = ["FitsImage"]

BLOCK = 2880
"""Headers and data fill whole blocks of this many bytes."""

MAX_BLOCKS = 1000
"""Length of the longest header that is read (blocks)."""

MAX_AXES = 999
"""Largest number of axes of an array."""

MAX_ARRAYS = 100
"""Largest number of arrays that are searched for the first image."""

_TYPES = {8: "u1", 16: ">i2", 32: ">i4", 64: ">i8", -32: ">f4", -64: ">f8"}


class FitsImage(ImageFile):
    """The first array in a FITS file with axes (row, column), (frame, row, column) or (z, y, x, row, column).

    Samples are ``BZERO + BSCALE x`` for the stored value x, or NaN where x is ``BLANK``. Rows keep the order of the
    file. ``EXPTIME`` is the exposure time (s). The format is that of FITS Standard 4.0 (IAU FITS Working Group 2018).

    Raises
    ------
    FileFormatError
        If the file is damaged or truncated, or contains no image array.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with storage_errors(path), path.open("rb") as file:
            self._bytes = path.stat().st_size
            self._find(file)

    def _find(self, file: BinaryIO) -> None:
        """Find the first array that is an image."""
        seen: list[str] = []
        for _ in range(MAX_ARRAYS):
            if (header := self._header(file)) is None:
                break
            # the standard allows 999 axes; a damaged header may state any number
            axes = min(_whole(header, "NAXIS"), MAX_AXES)
            lengths = [_whole(header, f"NAXIS{k + 1}") for k in range(axes)][::-1]
            bits = _whole(header, "BITPIX")
            table = header.get("XTENSION", "IMAGE") != "IMAGE"
            if bits in _TYPES and len(lengths) in (2, 3, 5) and 0 not in lengths and not table:
                self._describe(header, file.tell(), tuple(lengths), np.dtype(_TYPES[bits]))
                return
            compressed = " compressed" if header.get("ZIMAGE") == "T" else ""
            shape = " x ".join(map(str, lengths)) if len(lengths) <= len("zyxts") else f"{len(lengths)} axes"
            seen.append(f"{'a' + compressed + ' table' if table else shape or 'no data'}")
            count = int(np.prod(lengths, dtype=object)) if lengths else 0
            size = (count + max(0, _whole(header, "PCOUNT"))) * abs(bits) // 8
            if size > self._bytes:  # nothing can follow it
                break
            file.seek(-(-size // BLOCK) * BLOCK, 1)
        raise FileFormatError.expected(
            str(self.path),
            "an image with 2, 3 or 5 axes",
            ", ".join(map(str, seen)) or "none",
            "export it uncompressed",
        )

    def _header(self, file: BinaryIO) -> dict[str, str] | None:
        """Return the cards of the next header, None at the end of the file."""
        cards: dict[str, str] = {}
        for number in range(MAX_BLOCKS):
            block = file.read(BLOCK)
            if not block and not number:
                return None
            if len(block) < BLOCK:
                break
            for at in range(0, BLOCK, 80):
                card = block[at : at + 80].decode("ascii", errors="replace")
                if card[:8] == "END     ":
                    return cards
                if card[8:10] == "= ":
                    cards.setdefault(card[:8].strip(), _value(card[10:]))
        raise FileFormatError.expected(str(self.path), "a header that ends with END", "none", "record or copy it again")

    def _describe(self, header: dict[str, str], offset: int, lengths: tuple[int, ...], stored: np.dtype[Any]) -> None:
        check_declared(self.path, lengths[-2:], stored.itemsize, self._bytes)
        need = offset + int(np.prod(lengths, dtype=object)) * stored.itemsize
        if self._bytes < need:
            raise FileFormatError.expected(
                str(self.path), f"{need} bytes", f"{self._bytes}", "the file is cut short; record or copy it again"
            )
        self._offset, self._stored, self._lead = offset, stored, lengths[:-2]
        self._zero, self._scale = _number(header, "BZERO", 0.0), _number(header, "BSCALE", 1.0)
        self._blank = _whole(header, "BLANK") if "BLANK" in header and stored.kind != "f" else None
        self.shape = (lengths[-2], lengths[-1])
        self.pages = int(np.prod(self._lead))
        self.dtype = self._type()
        self.metadata = {"codec": codec_fact("none")}
        if len(self._lead) == 3:
            self.metadata |= {"plan_shape": self._lead}
        if header.get("ROWORDER", "").upper() == "BOTTOM-UP":
            words = "ROWORDER states that the first row is the bottom row; turn such frames upright with mirror-y"
            self.metadata |= {"format_notes": (f"{self.path.name}: {words} (--orientation)",)}
        if (exposure := _number(header, "EXPTIME", 0.0)) > 0:
            self.metadata |= {"exposure_s": np.full(self.pages, exposure)}

    def _type(self) -> np.dtype[Any]:
        """Return the type of samples: unsigned integers are stored as signed ones with an offset."""
        own = self._stored.newbyteorder("=")
        if self._blank is not None or self._scale != 1:
            return np.dtype(np.float32 if own.itemsize < 4 else np.float64)
        if self._zero == 0 or own.kind == "f":
            return own
        if own.kind == "i" and self._zero == 1 << (8 * own.itemsize - 1):
            return np.dtype(f"u{own.itemsize}")
        return np.dtype(np.float32 if own.itemsize < 4 else np.float64)

    def read(self, page: int = 0) -> NDArray[Any]:
        """Return frame ``page``, ``(rows, columns)``."""
        return self.read_region(page, slice(0, self.shape[0]), slice(0, self.shape[1]))

    def read_region(self, page: int, rows: slice, columns: slice) -> NDArray[Any]:
        """Return the part ``[rows, columns]`` of frame ``page``; only these rows are read."""
        rows, columns = check_region((rows, columns), self.shape)
        first = self.check_page(page) * self.shape[0] + rows.start
        count = (rows.stop - rows.start) * self.shape[1]
        with storage_errors(self.path), self.path.open("rb") as file:
            file.seek(self._offset + first * self.shape[1] * self._stored.itemsize)
            data = np.fromfile(file, self._stored, count)
        if data.size != count:
            raise FileFormatError.expected(
                str(self.path), f"{count} samples", data.size, "the file is cut short; copy it again"
            )
        part = data.reshape(-1, self.shape[1])[:, columns]
        if self.dtype == self._stored.newbyteorder("="):
            return check_samples(self.path, np.ascontiguousarray(part, self.dtype))
        if self.dtype.kind == "u":
            # the offset is the sign bit: exact for all sizes, where floats are not
            bits = np.ascontiguousarray(part, self._stored.newbyteorder("=")).view(self.dtype)
            return check_samples(self.path, bits ^ self.dtype.type(1 << (8 * self.dtype.itemsize - 1)))
        with np.errstate(over="ignore", invalid="ignore"):  # infinite samples are refused or masked like any other
            values = self._zero + self._scale * part.astype(np.float64)
        if self._blank is not None:
            values[part == self._blank] = np.nan
        return check_samples(self.path, np.ascontiguousarray(values, self.dtype))


def _value(text: str) -> str:
    """Return the value of a card without its comment; a quote within text is doubled."""
    text = text.strip()
    if text.startswith("'"):
        return text[1:].replace("''", "\0").partition("'")[0].replace("\0", "'").rstrip()
    return text.partition("/")[0].strip()


def _number(header: dict[str, str], name: str, default: float) -> float:
    try:
        found = float(header.get(name, default))
    except ValueError:
        return default
    return found if np.isfinite(found) else default


def _whole(header: dict[str, str], name: str) -> int:
    return max(0, int(_number(header, name, 0))) if name.startswith("NAXIS") else int(_number(header, name, 0))


FORMAT = Format(
    "FITS",
    frozenset({".fits", ".fit", ".fts"}),
    lambda head, _: head.startswith(b"SIMPLE  ="),
    lambda path, *_: FitsImage(path),
)
