"""NDTiff folders of Micro-Manager and Pycro-Manager as frames, read by their index.

The index lists the images in the order of acquisition. Each entry has the axes of an image as JSON, the name of its
file, and eight numbers of 32 bits. These are offset, width, height, type and compression of the samples, and offset,
length and compression of the metadata (https://github.com/micro-manager/NDStorage, version 3).
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, UnsafeFileError, check_region, parse_json, storage_errors
from lfcal.frames.formats.codecs import codec_fact
from lfcal.frames.formats.image_file import Format, ImageFile, check_declared, check_grey, decoding

__all__ = ["INDEX", "NDTiffImage"]

INDEX = "NDTiff.index"

_BITS = {0: 8, 1: 16, 2: 24, 3: 10, 4: 12, 5: 14, 6: 11}
"""Bits of a pixel by its type; type 2 is colour."""

_STAGE = (("XPosition_um_Intended", "XPositionUm"), ("YPosition_um_Intended", "YPositionUm"))
_FOCUS = ("ZPosition_um_Intended", "ZPositionUm")
"""Names of stage coordinates (µm) in the metadata of an image; the first one found is used."""

MOST_METADATA = 1 << 24
"""Largest size of the metadata of an image (bytes)."""


@dataclass(frozen=True, slots=True)
class _Entry:
    """An image in the index: its axes, its file, and the eight numbers."""

    axes: dict[str, Any]
    file: str
    numbers: tuple[int, ...]


class NDTiffImage(ImageFile):
    """The images of an NDTiff folder as pages, in the order of acquisition.

    If an image was recorded several times, only the last version is read.

    Parameters
    ----------
    path
        The index, ``NDTiff.index``.
    channel
        Name of the channel to read; required if there are several.

    Raises
    ------
    FileFormatError, UnsafeFileError, InputError, StorageError
        If the index or an image is damaged, images are compressed or differ in size or type, or ``channel`` does not
        exist or is required.
    """

    def __init__(self, path: Path, channel: str | None = None) -> None:
        self.path = path
        entries = self._of_channel(_entries(path), channel)
        kinds = {entry.numbers[1:5] for entry in entries}
        if len(kinds) != 1:
            raise FileFormatError.expected(
                str(path), "images of one size and type", f"{len(kinds)} kinds", "record them with one setting"
            )
        ((columns, rows, kind, compression),) = kinds
        if kind not in _BITS or compression:
            got = f"type {kind}, compression {compression}"
            raise FileFormatError.expected(str(path), "uncompressed images", got, "export them as OME-TIFF")
        check_grey(path, 3 if kind == 2 else 1, None, 8)
        self.shape, self.dtype = (rows, columns), np.dtype(np.uint8 if kind == 0 else np.uint16)
        self._entries, self.pages = entries, len(entries)
        self._check_sizes()
        self.metadata = {"codec": codec_fact("none"), "bit_depth": _BITS[kind], **self._places(), **self._facts()}

    def _of_channel(self, entries: list[_Entry], channel: str | None) -> list[_Entry]:
        names = list(dict.fromkeys(str(entry.axes["channel"]) for entry in entries if "channel" in entry.axes))
        if channel is None and len(names) < 2:
            return entries
        if channel not in names:
            got = "none" if channel is None else repr(channel)
            known = ", ".join(names) or "no channel"
            remedy = f"name it as {self.path.parent.name}::{names[0] if names else ''}"
            raise InputError.expected(f"channel of {self.path.parent}", f"one of {known}", got, remedy)
        return [entry for entry in entries if str(entry.axes.get("channel")) == channel]

    def _check_sizes(self) -> None:
        """Raise `FileFormatError` if an image or its metadata extend beyond their file."""
        sizes: dict[str, int] = {}
        length = math.prod(self.shape) * self.dtype.itemsize
        for entry in self._entries:
            if entry.file not in sizes:
                if Path(entry.file).name != entry.file or entry.file in ("", ".", ".."):
                    raise UnsafeFileError.expected(
                        str(self.path), "names of files in the same folder", repr(entry.file), "copy the folder again"
                    )
                with storage_errors(self.path.parent / entry.file):
                    sizes[entry.file] = (self.path.parent / entry.file).stat().st_size
                check_declared(self.path, self.shape, self.dtype.itemsize, sizes[entry.file])
            if max(entry.numbers[0] + length, entry.numbers[5] + entry.numbers[6]) > sizes[entry.file]:
                raise FileFormatError.expected(
                    str(self.path.parent / entry.file), "all images of the index", "a shorter file", "copy it again"
                )

    def _places(self) -> dict[str, Any]:
        """Return the positions, if every image has a row and a column."""
        if not all({"row", "column"} <= set(entry.axes) for entry in self._entries):
            return {}
        rows = [[entry.axes.get("z", 0), entry.axes["row"], entry.axes["column"]] for entry in self._entries]
        places = np.array(rows)
        return {"positions": places} if places.dtype.kind == "i" else {}

    def _facts(self) -> dict[str, Any]:
        """Return stage coordinates and exposure times, if the metadata of every image state them."""
        said = [self._said(entry) for entry in self._entries]
        found: dict[str, Any] = {}
        stage = np.array([[_first(one, names) for names in (*_STAGE, _FOCUS)] for one in said])
        exposures = np.array([_first(one, ("Exposure",)) for one in said]) / 1e3
        if np.isfinite(exposures).all() and (exposures > 0).all():
            found["exposure_s"] = exposures
        if np.isfinite(stage[:, :2]).all() and np.ptp(stage[:, :2], axis=0).any():
            found |= {"stage_um": stage, "stage_pages": tuple(("", k) for k in range(self.pages))}
            if "exposure_s" in found:
                found["stage_exposure_s"] = exposures
        return found

    def _said(self, entry: _Entry) -> dict[str, Any]:
        """Return the metadata of an image; empty if they cannot be read, because the image can be used without them."""
        start, length, compression = entry.numbers[5:]
        if compression or not 0 < length <= MOST_METADATA:
            return {}
        data = self._bytes(entry, start, length)
        try:
            found = json.loads(data.split(b"\0")[0])
        except ValueError:
            return {}
        return found if isinstance(found, dict) else {}

    def _bytes(self, entry: _Entry, start: int, length: int) -> bytes:
        file = self.path.parent / entry.file
        with storage_errors(file), file.open("rb") as opened:
            opened.seek(start)
            return opened.read(length)

    def read(self, page: int = 0) -> NDArray[Any]:
        """Return frame ``page``, ``(rows, columns)``."""
        return self.read_region(page, slice(0, self.shape[0]), slice(0, self.shape[1]))

    def read_region(self, page: int, rows: slice, columns: slice) -> NDArray[Any]:
        """Return the part ``[rows, columns]`` of frame ``page``; only these rows are read."""
        rows, columns = check_region((rows, columns), self.shape)
        entry = self._entries[self.check_page(page)]
        width = self.shape[1] * self.dtype.itemsize
        data = self._bytes(entry, entry.numbers[0] + rows.start * width, (rows.stop - rows.start) * width)
        if len(data) != (rows.stop - rows.start) * width:
            raise FileFormatError.expected(
                str(self.path.parent / entry.file), "all images of the index", "a shorter file", "copy it again"
            )
        part = np.frombuffer(data, self.dtype.newbyteorder("<")).reshape(-1, self.shape[1])[:, columns]
        return np.ascontiguousarray(part, self.dtype)


def _entries(path: Path) -> list[_Entry]:
    """Return the entries of an index; it ends with a length of 0, or where the acquisition stopped."""
    with storage_errors(path):
        data = path.read_bytes()
    found: dict[str, _Entry] = {}
    at = 0
    with decoding(path, "NDTiff index"):
        while at + 4 <= len(data) and (length := struct.unpack_from("<I", data, at)[0]):
            axes = parse_json(data[at + 4 : at + 4 + length].decode(), str(path))
            at += 4 + length
            (length,) = struct.unpack_from("<I", data, at)
            file = data[at + 4 : at + 4 + length].decode()
            at += 4 + length
            # the same axes again: the image was replaced
            found[json.dumps(axes, sort_keys=True)] = _Entry(dict(axes), file, struct.unpack_from("<8I", data, at))
            at += 32
    if not found:
        raise FileFormatError.expected(str(path), "an index of images", "none", "copy the folder again")
    return list(found.values())


def _first(said: dict[str, Any], names: tuple[str, ...]) -> float:
    """Return the first of several entries that is a number; NaN without one."""
    for name in names:
        try:
            return float(said[name])
        except (KeyError, TypeError, ValueError):
            continue
    return math.nan


FORMAT = Format(
    "NDTiff",
    frozenset(),
    lambda _, path: path.name == INDEX,
    lambda path, _, channel: NDTiffImage(path, channel),
    in_folders=False,
)
