"""A dataset of a file, checked before a byte of it is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError, UnsafeFileError
from lfcal.base.files import MAX_EXPANSION
from lfcal.base.h5._errors import damage
from lfcal.base.h5.attributes import Attributes
from lfcal.base.h5.chunks import ChunkTable
from lfcal.base.units import format_bytes

__all__ = ["MAX_BYTES", "H5Data"]

MAX_BYTES = 1 << 44
"""A dataset with a declared size above this (17.6 TB) is refused."""

Index = int | slice | tuple[int | slice, ...]

KNOWN_FILTERS = {1, 2, 3, 32000, 32001, 32004, 32008, 32015}
"""HDF5 filters that are read: deflate, shuffle, fletcher32, lzf, blosc, lz4, bitshuffle, zstd."""


class H5Data:
    """Numbers in an HDF5 file: what they are, and every way of reading them, with one-line errors.

    Attributes
    ----------
    path, name
        Where it is.
    table
        Its chunks; None for contiguous or no data.
    shape, dtype, chunks
        As declared; ``chunks`` is None for contiguous data.
    filters
        Numbers of its HDF5 filters, in the order of writing.

    Parameters
    ----------
    dataset
        Open h5py dataset.
    max_bytes
        Largest size declared (bytes).
    dtype
        The only type accepted, that of the records of a recording; by default plain numbers.
    holes
        Whether chunks may be missing; they read as the fill value.

    Raises
    ------
    UnsafeFileError
        For external storage, virtual datasets, unknown filters, other types, and sizes beyond ``max_bytes`` or far
        beyond the file's.
    FileFormatError
        If it is damaged or unfinished.
    """

    def __init__(
        self, dataset: Any, *, max_bytes: int = MAX_BYTES, dtype: np.dtype[Any] | None = None, holes: bool = False
    ) -> None:
        self.path = Path(dataset.file.filename)
        self.name = str(dataset.name).lstrip("/")
        self._data = dataset
        with damage(self.path, self.name):
            self._describe(max_bytes, dtype, holes)

    def _describe(self, max_bytes: int, dtype: np.dtype[Any] | None, holes: bool) -> None:
        data = self._data
        plist = data.id.get_create_plist()
        self._check_inside(plist)
        self.dtype: np.dtype[Any] = np.dtype(data.dtype)
        if dtype is not None and self.dtype != dtype:
            raise self._unsafe("the records of a recording", f"dtype {self.dtype}", "take it from its source again")
        if dtype is None and self.dtype.kind not in "iufcb":
            raise self._unsafe("plain numbers", f"dtype {self.dtype}", "store it as numbers")
        if dtype is None:
            self.dtype = np.dtype(self.dtype.str)  # without the names of an enumeration, which NPY files cannot keep
        if data.shape is None:
            raise FileFormatError.expected(self.where, "numbers", "an empty dataset", "take it from its source again")
        self.shape = tuple(int(n) for n in data.shape)
        self.chunks = None if data.chunks is None else tuple(int(n) for n in data.chunks)
        self.filters = tuple(int(plist.get_filter(k)[0]) for k in range(plist.get_nfilters()))
        if set(self.filters) - KNOWN_FILTERS:
            raise self._unsafe("gzip, lzf, zstd, blosc or lz4", f"HDF5 filter {self.filters}", "repack the file")
        self._check_size(max_bytes)
        self._holes = holes
        self.table: ChunkTable | None = None
        self._check_stored()

    def _check_inside(self, plist: Any) -> None:
        import h5py

        # both may lead to any file of this machine
        if plist.get_external_count():
            raise self._unsafe("data stored in the file itself", "external storage", "copy it in")
        if plist.get_layout() == h5py.h5d.VIRTUAL:
            raise self._unsafe("stored data", "a virtual dataset", "copy the data in")

    def _check_size(self, max_bytes: int) -> None:
        stored = self._file_size()
        if self.nbytes > max_bytes:
            raise self._unsafe(f"at most {format_bytes(max_bytes)}", format_bytes(self.nbytes), "check the file")
        if self.nbytes > MAX_EXPANSION * stored + (1 << 20):
            raise self._unsafe(
                "a size the file can hold",
                f"{format_bytes(self.nbytes)} declared in a file of {format_bytes(stored)}",
                "the header is wrong; take it from its source again",
            )

    def _check_stored(self) -> None:
        """Raise unless all data are there, and every chunk lies within the file."""
        if not self.nbytes:
            return
        if self.chunks is None:
            have = self._data.id.get_storage_size()
            if have < self.nbytes and not self._holes:
                raise self._unfinished(f"{format_bytes(self.nbytes)} of data", format_bytes(have))
            return
        self.table = ChunkTable(self._data, self.path, self.where)
        if self.table.missing and not self._holes:
            raise self._unfinished("all chunks written", f"{self.table.missing} missing")

    def _file_size(self) -> int:
        # of a file that is being written, HDF5 knows of more bytes than the system
        return int(self._data.file.id.get_filesize())

    @property
    def where(self) -> str:
        """File and name, for messages."""
        return f"{self.path}:/{self.name}"

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """Number of samples."""
        return int(np.prod(self.shape, dtype=object))

    @property
    def nbytes(self) -> int:
        """Bytes of all samples, as declared."""
        return self.size * self.dtype.itemsize

    @property
    def attributes(self) -> Attributes:
        """Its attributes."""
        return Attributes(self.path, self._data, self.name)

    @property
    def is_open(self) -> bool:
        """Whether its file is open."""
        return bool(self._data.id.valid)

    @property
    def offset(self) -> int | None:
        """Byte of the file at which contiguous data begin, None for chunks."""
        with damage(self.path, self.name):
            found = None if self.chunks is not None else self._data.id.get_offset()
        return None if found is None else int(found)

    def read(self, index: Index = ()) -> NDArray[Any]:
        """Return the part ``index``, an integer or a slice per axis, all of it by default, as a new array.

        Raises `IndexError` beyond the dataset.
        """
        if not self.is_open:
            raise FileFormatError(f"{self.where}: its file is closed; open it again")
        box, key = _box(index, self.shape)
        with damage(self.path, self.name):
            if self.table is None or self.table.filters is None:
                values = np.asarray(self._data[box])
            else:
                values = self.table.read(box)
        return np.asarray(values[key], self.dtype)  # numpy turns single values to the native order

    def close_file(self) -> None:
        """Close the file it lies in; may be called twice."""
        self.release()
        with damage(self.path, self.name):
            if self.is_open:
                self._data.file.close()

    def release(self) -> None:
        """Close what reading opened beside HDF5's own file."""
        if self.table is not None:
            self.table.close()

    def _unsafe(self, wanted: str, got: str, remedy: str) -> UnsafeFileError:
        return UnsafeFileError.expected(self.where, wanted, got, remedy)

    def _unfinished(self, wanted: str, got: str) -> FileFormatError:
        return FileFormatError.expected(self.where, wanted, got, "the file is unfinished; write it again")


def _box(index: Index, shape: tuple[int, ...]) -> tuple[tuple[slice, ...], tuple[int | slice, ...]]:
    """Return the smallest box of samples that holds ``index``, and the index within that box."""
    given = index if isinstance(index, tuple) else (index,)
    if len(given) > len(shape):
        raise IndexError(f"{len(given)} indices for {len(shape)} axes")
    box: list[slice] = []
    within: list[int | slice] = []
    for part, n in zip((*given, *[slice(None)] * (len(shape) - len(given))), shape, strict=True):
        if isinstance(part, slice):
            picked = range(n)[part]
            first, last = (min(picked[0], picked[-1]), max(picked[0], picked[-1]) + 1) if picked else (0, 0)
            box.append(slice(first, last))
            within.append(slice(None, None, part.step) if picked else slice(None))
        else:
            at = range(n)[part]
            box.append(slice(at, at + 1))
            within.append(0)
    return tuple(box), tuple(within)
