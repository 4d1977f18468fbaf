"""HDF5 stacks as frames; every declared size is checked when they are opened."""

from __future__ import annotations

import re
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, check_region
from lfcal.base.h5 import H5Data, H5File
from lfcal.frames.formats._axes import used_axes
from lfcal.frames.formats.codecs import codec_fact
from lfcal.frames.formats.image_file import Format, ImageFile, check_samples

__all__ = ["Hdf5Image", "stacks_in"]

_COMPRESSING = {1: "deflate", 32000: "lzf", 32001: "blosc", 32004: "lz4", 32008: "bitshuffle", 32015: "zstd"}
"""Names of the compression filters, by their numbers."""

_NEXUS_DEPTH = 8
"""Largest number of groups that NeXus ``default`` attributes may lead through."""

_DARK = re.compile(r"dark|background", re.IGNORECASE)

_CALIBRATION = re.compile(r"(?:^|[/_])(?:dark|white|flat|bright|background)s?(?:[/_]|$)", re.IGNORECASE)
"""Names of datasets that contain dark or white frames."""


class Hdf5Image(ImageFile):
    """A dataset in an HDF5 file, with axes (frame, row, column) or (z, y, x, row, column).

    If the same group also contains ``positions`` (frame, 3) as z, y, x, ``exposure_s`` (frame) or ``mask`` (row,
    column; 0: no measurement), they are read as well.

    Parameters
    ----------
    path
        Path of the file.
    dataset
        Path of the dataset within the file. None: ``frames``, or else the signal named by NeXus attributes
        (``default``, ``signal``), or else the only dataset with three or five axes, or the only one of them with the
        attribute ``signal`` = 1. Datasets whose names indicate dark or white frames are ignored unless there are no
        others.

    Raises
    ------
    FileFormatError, UnsafeFileError
        As in `lfcal.base.h5.reading.H5Data`, or if there is no dataset of frames or more than one.
    """

    def __init__(self, path: Path, dataset: str | None = None) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._others: list[str] = []
        self._file = H5File(path)
        try:
            self._open(dataset)
        except BaseException:
            self._file.close()
            raise

    def _open(self, name: str | None) -> None:
        name = self._choose() if name is None else name
        self._data, written = self._written(name)
        self._axes = used_axes(self._data.shape)
        shape = tuple(self._data.shape[axis] for axis in self._axes)
        if len(shape) not in (3, 5) or 0 in shape or self._data.dtype.kind not in "iuf":
            raise FileFormatError.expected(
                f"{self.path}:/{name}",
                "numbers with axes (frame, row, column) or (z, y, x, row, column)",
                f"{self._data.dtype} of shape {self._data.shape}",
                "give another dataset",
            )
        self._lead = shape[:-2]
        self.shape = (shape[-2], shape[-1])
        self.dtype = self._data.dtype.newbyteorder("=")
        notes: list[str] = []
        if written is not None and len(self._lead) == 1:
            notes.append(
                f"frames: {written} of {self._lead[0]} were written to {self.path.name}; the others are missing"
            )
            self._lead = (written,)
        self.pages = int(np.prod(self._lead))
        # lossy filters are not among those that can be read
        names = [_COMPRESSING[number] for number in self._data.filters if number in _COMPRESSING]
        metadata: dict[str, Any] = {"codec": codec_fact(names[0] if names else "none")}
        notes += [self._note(other) for other in self._others]
        if notes:
            metadata["format_notes"] = tuple(notes)
        if len(self._lead) == 3:
            metadata["plan_shape"] = self._lead
        folder = name.rpartition("/")[0]
        tables = {"positions": (self.pages, 3), "exposure_s": (self.pages,), "mask": self.shape}
        for key, wanted in tables.items():
            beside = f"{folder}/{key}" if folder else key
            if beside in self._file:
                metadata[key] = self._table(beside, wanted)
        self.metadata = metadata

    def _written(self, name: str) -> tuple[H5Data, int | None]:
        """Return a dataset, and the number of frames written to it if it is incomplete. None: all are there."""
        try:
            return self._file.dataset(name), None
        except FileFormatError:
            data = self._file.dataset(name, holes=True)
            count = 0 if data.table is None or data.ndim > 4 or 1 in data.shape[:1] else data.table.first_rows
            if not count:
                raise
            return data, count

    def _choose(self) -> str:
        if "frames" in self._file:
            return "frames"
        if (signal := self._signal()) and _is_stack(self._file.dataset(signal).shape):
            return signal
        stacks = _stacks(self._file)
        found = _candidates(stacks)
        # older NeXus files mark the signal among the datasets with a number
        marked = [name for name in found if str(self._file.attributes(name).plain().get("signal")) == "1"]
        found = marked if len(marked) == 1 else found
        self._others = [name for name in stacks if name not in _candidates(stacks)]
        if len(found) != 1:
            got = ", ".join(f"/{name} {stacks[name]}" for name in found[:8]) or "none"
            remedy = f"name it as {self.path.name}::/{found[0]}" if found else "check the file"
            if not found and (out := self._file.links_out()):
                got = f"links to {', '.join(out[:3])}{' …' if len(out) > 3 else ''}"
                remedy = "links to other files are not followed; open the file that contains the frames"
            raise FileFormatError.expected(str(self.path), "one dataset of frames", got, remedy)
        return found[0]

    def _note(self, name: str) -> str:
        option = "--dark" if _DARK.search(name) else "--white"
        return f"{self.path.name} also contains /{name}; to correct with it, give {option} {self.path}::/{name}"

    def _signal(self) -> str:
        """Return the dataset to which NeXus attributes lead from the root; empty if they lead to none."""
        place = ""
        for _ in range(_NEXUS_DEPTH):
            values = self._file.attributes(place).plain()
            signal, below = (_text(values.get(key)) for key in ("signal", "default"))
            name = f"{place}/{signal or below}".lstrip("/")
            if not (signal or below) or name not in self._file:
                break
            if signal:
                return name
            place = name
        return ""

    def _table(self, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
        data = self._file.dataset(name)
        each = ", one per frame" if shape[0] == self.pages else ", that of a frame"
        if data.shape != shape:
            raise FileFormatError.expected(
                f"{self.path}:/{name}", f"shape {shape}{each}", data.shape, "correct the file"
            )
        return self._file.values(name, kinds="biuf")

    def read(self, page: int = 0) -> NDArray[Any]:
        """Return frame ``page``, ``(rows, columns)``."""
        return self.read_region(page, slice(0, self.shape[0]), slice(0, self.shape[1]))

    def read_region(self, page: int, rows: slice, columns: slice) -> NDArray[Any]:
        """Return the part ``[rows, columns]`` of frame ``page``; only the chunks that contain it are read."""
        rows, columns = check_region((rows, columns), self.shape)
        at = np.unravel_index(self.check_page(page), self._lead)
        used: dict[int, int | slice] = dict(zip(self._axes, (*(int(k) for k in at), rows, columns), strict=True))
        with self._lock:
            part = self._data.read(tuple(used.get(axis, 0) for axis in range(self._data.ndim)))
        return check_samples(self.path, np.ascontiguousarray(part, self.dtype))

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._file.close()


def stacks_in(path: Path) -> dict[str, tuple[int, ...]]:
    """Return the names and shapes of those datasets in an HDF5 file that may contain frames.

    Datasets of dark and white frames are returned only if there are no others.

    Raises
    ------
    FileFormatError, StorageError
        If the file cannot be read.
    """
    with H5File(path) as file:
        stacks = _stacks(file)
        return {name: stacks[name] for name in _candidates(stacks)}


def _is_stack(shape: tuple[int, ...]) -> bool:
    return len(used_axes(shape)) in (3, 5)


def _stacks(file: H5File) -> dict[str, tuple[int, ...]]:
    return {name: shape for name, shape in sorted(file.datasets().items()) if _is_stack(shape)}


def _candidates(stacks: Mapping[str, tuple[int, ...]]) -> list[str]:
    return [name for name in stacks if not _CALIBRATION.search(name)] or list(stacks)


def _text(value: Any) -> str:
    """Return an attribute that is text, empty for any other: old NeXus files mark the dataset with a number."""
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    return value if isinstance(value, str) else ""


FORMAT: Format = Format(
    "HDF5",
    frozenset({".h5", ".hdf5", ".mat"}),
    # a user block may precede the signature, so the suffix counts as well
    lambda head, path: head.startswith(b"\x89HDF") or path.suffix.lower() in FORMAT.suffixes,
    lambda path, _, dataset: Hdf5Image(path, dataset),
    rank=1,
    in_folders=False,
)
