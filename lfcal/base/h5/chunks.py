"""Chunks of a dataset, which are located, read and decoded without HDF5.

HDF5's own look-up and filters can crash the process on a damaged index. Here the index is read once, and every entry
must be within the file. The chunks are read as plain bytes.
"""

from __future__ import annotations

import math
import os
import threading
import weakref
import zlib
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lfcal.base.errors import FileFormatError
from lfcal.base.files import storage_errors
from lfcal.base.system import OPEN_FLAGS, read_at

__all__ = ["FILTER_NAMES", "PIPELINE", "ChunkTable", "decode_chunk", "encode_chunk", "fletcher32"]

PIPELINE = ("shuffle", "deflate", "fletcher32")
"""Filters of an H file, in the order in which they are applied on writing."""


def fletcher32(data: bytes) -> int:
    """Return the checksum that HDF5 stores with a chunk: Fletcher's sums of big-endian 16-bit words.

    If the number of bytes is odd, the last one counts as the high byte of a word (HDF5 library,
    `H5_checksum_fletcher32`).
    """
    from imagecodecs import h5checksum_fletcher32

    return int(h5checksum_fletcher32(data))


def encode_chunk(array: NDArray[Any], level: int = 1, filters: Sequence[str] = PIPELINE) -> bytes:
    """Return the bytes that HDF5 stores for a chunk with the given values.

    Parameters
    ----------
    array
        Values of the complete chunk, of any shape, in the dataset's dtype.
    level
        Compression level of deflate, 0 to 9.
    filters
        Filters of the dataset in the order in which they are applied, each of them ``"shuffle"``, ``"deflate"`` or
        ``"fletcher32"``.
    """
    contiguous = np.ascontiguousarray(array)
    data: Any = contiguous.reshape(-1).view(np.uint8)
    for name in filters:
        if name == "shuffle":
            if contiguous.itemsize > 1:
                # the first bytes of all values, then all second bytes, and so on, which improves compression
                data = data.reshape(-1, contiguous.itemsize).T.copy().reshape(-1)
        elif name == "deflate":
            from imagecodecs import deflate_encode  # libdeflate: the same format in half zlib's time

            data = deflate_encode(data, level=level)
        else:
            raw = bytes(data)
            data = raw + fletcher32(raw).to_bytes(4, "little")
    return bytes(data)


def decode_chunk(
    raw: bytes,
    dtype: DTypeLike,
    shape: Sequence[int],
    filter_mask: int = 0,
    filters: Sequence[str] = PIPELINE,
    *,
    where: str = "HDF5 chunk",
) -> NDArray[Any]:
    """Return the values of a stored chunk; the inverse of `encode_chunk`.

    Parameters
    ----------
    raw
        The stored bytes.
    dtype, shape
        Type and shape of the chunk.
    filter_mask
        Bit k is set if filter k was not applied to this chunk.
    filters
        The dataset's filters, as in `encode_chunk`.
    where
        Name of the chunk in errors.

    Raises
    ------
    FileFormatError
        If the checksum is wrong, the compressed data are damaged, or the size is not that of the chunk.
    """
    dtype = np.dtype(dtype)
    nbytes = dtype.itemsize * math.prod(shape)
    data: Any = raw
    for k in reversed(range(len(filters))):
        if filter_mask >> k & 1:
            continue
        if filters[k] == "fletcher32":
            data = _verified(data, where)
        elif filters[k] == "deflate":
            data = _inflated(data, nbytes, where)
        elif dtype.itemsize > 1:
            _check_size(data, nbytes, where)
            plain = np.empty((nbytes // dtype.itemsize, dtype.itemsize), np.uint8)
            for b, part in enumerate(np.frombuffer(data, np.uint8).reshape(dtype.itemsize, -1)):
                plain[:, b] = part  # faster than copying the transpose
            data = plain.reshape(-1)
    _check_size(data, nbytes, where)
    return np.frombuffer(data, dtype).reshape(tuple(shape))


def _verified(data: bytes, where: str) -> bytes:
    body, stored = data[:-4], int.from_bytes(data[-4:], "little")
    found = fletcher32(body)
    # HDF5 before 1.6.3 stored the bytes of each half swapped on little-endian machines; it still reads them.
    swapped = ((found & 0x00FF00FF) << 8) | (found >> 8 & 0x00FF00FF)
    if len(data) < 4 or stored not in (found, swapped):
        raise FileFormatError.expected(
            where, f"checksum {stored:08x}", f"{found:08x}", "the file is damaged; copy it again"
        )
    return body


def _inflated(data: bytes, nbytes: int, where: str) -> bytes:
    from imagecodecs import DeflateError, deflate_decode

    try:
        quick = bytes(deflate_decode(data, out=nbytes))
        if len(quick) == nbytes:
            return quick
    except DeflateError:
        pass  # zlib reports what is wrong
    stream = zlib.decompressobj()
    try:
        plain = stream.decompress(data, nbytes + 1)  # never much more than the chunk declares
    except zlib.error as error:
        raise FileFormatError.expected(
            where, "compressed data", f"damaged bytes ({error})", "the file is damaged; copy it again"
        ) from error
    return plain


def _check_size(data: Any, nbytes: int, where: str) -> None:
    if len(data) != nbytes:
        raise FileFormatError.expected(where, f"{nbytes} bytes", f"{len(data)}", "the file is damaged; copy it again")


FILTER_NAMES = {1: "deflate", 2: "shuffle", 3: "fletcher32"}
"""HDF5 filters that are decoded here, by their numbers in H5Zpublic.h."""

BLOCK_ENTRIES = 1 << 14
"""Number of index entries that are processed together."""

READ_AHEAD = 1 << 20
"""Number of bytes read at a time for consecutive chunks."""

Start = tuple[int, ...]


def _numbers(chunk: Any) -> tuple[int, int, int]:
    return chunk.byte_offset, chunk.size, chunk.filter_mask


class ChunkTable:
    """Locations in the file of the chunks of a dataset.

    Parameters
    ----------
    dataset
        Open, chunked h5py dataset.
    path, where
        Path of the file, and name of file and dataset for messages.

    Raises
    ------
    FileFormatError
        If the index contains an invalid chunk, the same chunk twice, or a chunk outside the file.
    """

    def __init__(self, dataset: Any, path: Path, where: str) -> None:
        self._path, self._where = path, where
        self._shape = tuple(int(n) for n in dataset.shape)
        self._chunk = tuple(int(n) for n in dataset.chunks)
        self._dtype = np.dtype(dataset.dtype)
        self._grid = tuple(-(-n // c) for n, c in zip(self._shape, self._chunk, strict=True))
        plist = dataset.id.get_create_plist()
        numbers = [int(plist.get_filter(k)[0]) for k in range(plist.get_nfilters())]
        self.filters: tuple[str, ...] | None = None
        """Names of the filters in the order of writing; None if HDF5 must decode them."""
        if set(numbers) <= set(FILTER_NAMES):
            self.filters = tuple(FILTER_NAMES[number] for number in numbers)
        self._at = np.full(self._grid, -1, np.int64)
        self._size = np.zeros(self._grid, np.int64)
        self._filter_masks = np.zeros(self._grid, np.uint32)
        self._fill = dataset.fillvalue
        self._lock = threading.Lock()
        self._walk(dataset)
        self._closer: weakref.finalize[..., Any] | None = None

    def _walk(self, dataset: Any) -> None:
        # while a file is being written, HDF5 may know of more bytes than the system
        if dataset.file.mode != "r":
            dataset.file.flush()
        end = dataset.file.id.get_filesize()
        largest = min(end, 2 * int(np.prod(self._chunk, dtype=np.int64)) * self._dtype.itemsize + 4096)
        found: list[Any] = []

        def collect(chunk: Any) -> None:
            found.append(chunk)
            if len(found) == BLOCK_ENTRIES:  # a circular index contains an entry twice
                self._take(found, end, largest)
                found.clear()

        dataset.id.chunk_iter(collect)
        self._take(found, end, largest)

    def _take(self, found: list[Any], end: int, largest: int) -> None:
        """Add entries of the index; raise an error for the first that is invalid or a duplicate."""
        if not found:
            return
        # unsigned, as in HDF5: damaged numbers can have any size
        starts = np.array([chunk.chunk_offset for chunk in found], np.uint64)
        at, size, mask = (np.array(column, np.uint64) for column in zip(*(_numbers(c) for c in found), strict=True))
        places = starts // np.array(self._chunk, np.uint64)
        inside = (places < np.array(self._grid, np.uint64)).all(axis=1)
        fits = (size > 4) & (size <= largest) & (at > 0) & (at <= end - np.minimum(size, end))
        index = tuple(places[inside].astype(np.intp).T)
        new = np.zeros(len(found), bool)
        new[np.flatnonzero(inside)[np.unique(np.ravel_multi_index(index, self._grid), return_index=True)[1]]] = True
        new[inside] &= self._at[index] < 0
        wrong = np.flatnonzero(~(fits & new))
        if wrong.size:
            chunk = found[wrong[0]]
            raise FileFormatError.expected(
                self._where,
                "an index of the chunks in the file",
                f"chunk {tuple(chunk.chunk_offset)} of {chunk.size} bytes at {chunk.byte_offset}",
                "copy the file again from its source",
            )
        self._at[index], self._size[index], self._filter_masks[index] = at, size, mask

    @property
    def missing(self) -> int:
        """Number of chunks that were never written."""
        return int((self._at < 0).sum())

    @property
    def first_rows(self) -> int:
        """Number of indices of the first axis, from 0, for which all chunks were written.

        It is 0 if chunks were written for any later index: the writing was not in order.
        """
        lost = (self._at < 0).reshape(self._grid[0], -1)
        first = int(lost.any(axis=1).argmax()) if lost.any() else self._grid[0]
        return min(first * self._chunk[0], self._shape[0]) if lost[first:].all() else 0

    def stored(self, start: Start) -> tuple[int, bytes] | None:
        """Return the ``filter_mask`` of a chunk for `decode_chunk`, and its stored bytes; None if it was never written.

        ``start`` contains the indices of the chunk's first sample. The method is thread-safe.
        """
        place = tuple(k // length for k, length in zip(start, self._chunk, strict=True))
        at, size = int(self._at[place]), int(self._size[place])
        if at < 0:
            return None
        with storage_errors(self._path):
            raw = read_at(self._open(), size, at)
        return int(self._filter_masks[place]), raw

    def each_stored(self, starts: Iterable[Start]) -> Iterator[tuple[Start, int, memoryview]]:
        """Yield start, ``filter_mask`` and stored bytes of the chunks at ``starts``, without those never written.

        Chunks that are adjacent in the file are read together. The method is not thread-safe.
        """
        asked = list(starts)
        # look up all together: for small chunks, the look-up takes as long as reading
        places = tuple((np.array(asked, np.intp).reshape(-1, len(self._chunk)) // self._chunk).T)
        columns = (column[places].tolist() for column in (self._at, self._size, self._filter_masks))
        first, last, held = 0, 0, memoryview(b"")
        for start, at, size, left_out in zip(asked, *columns, strict=True):
            if at < 0:
                continue
            if at < first or at + size > last:
                with storage_errors(self._path):
                    first, held = at, memoryview(read_at(self._open(), max(size, READ_AHEAD), at))
                last = first + len(held)
            yield start, left_out, held[at - first : at - first + size]

    def _open(self) -> int:
        """Return a descriptor of the file: the position of HDF5's own must not change."""
        with self._lock:
            if self._closer is None:
                self._descriptor = os.open(self._path, os.O_RDONLY | OPEN_FLAGS)
                self._closer = weakref.finalize(self, os.close, self._descriptor)
            return self._descriptor

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        with self._lock:
            if self._closer is not None:
                self._closer()
                self._closer = None

    def decoded(self, start: Start) -> NDArray[Any]:
        """Return the values of the chunk with the first sample at ``start``; fill values if it was never written.

        `filters` must not be None.
        """
        stored = self.stored(start)
        if stored is None:
            return np.full(self._chunk, self._fill, self._dtype)
        assert self.filters is not None
        name = f"{self._where}, chunk {start}"
        return decode_chunk(stored[1], self._dtype, self._chunk, stored[0], self.filters, where=name)

    def read(self, slices: tuple[slice, ...]) -> NDArray[Any]:
        """Return the samples in a box; ``slices`` has one slice per axis, with start and stop, and without a step.

        `filters` must not be None.
        """
        out = np.empty([s.stop - s.start for s in slices], self._dtype)
        starts = [range(s.start - s.start % c, s.stop, c) for s, c in zip(slices, self._chunk, strict=True)]
        for start in product(*starts):
            values = self.decoded(start)
            ends = [a + n for a, n in zip(start, self._chunk, strict=True)]
            both = [(max(s.start, a), min(s.stop, b)) for s, a, b in zip(slices, start, ends, strict=True)]
            there = tuple(slice(a - s.start, b - s.start) for (a, b), s in zip(both, slices, strict=True))
            here = tuple(slice(a - first, b - first) for (a, b), first in zip(both, start, strict=True))
            out[there] = values[here]
        return out
