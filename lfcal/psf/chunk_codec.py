"""HDF5 chunks coded outside of HDF5, so that threads can compress and decompress at once.

HDF5 runs its filters on one thread. Here a chunk passes shuffle, deflate and fletcher32 in worker threads
(zlib and the kernels release the GIL), and only the finished bytes pass through h5py, from the caller's thread.
What is written is an ordinary HDF5 file.
"""

from __future__ import annotations

import itertools
import math
import zlib
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lfcal.errors import FileFormatError, InputError, expectation
from lfcal.threads import njit, worker_count

__all__ = [
    "PIPELINE",
    "chunk_pipeline",
    "decode_chunk",
    "encode_chunk",
    "fletcher32",
    "parallel_read",
    "parallel_write",
]

PIPELINE = ("shuffle", "deflate", "fletcher32")
"""The filters of an H file, in the order in which they are applied on writing."""

_FILTERS = {1: "deflate", 2: "shuffle", 3: "fletcher32"}
_BATCH_BYTES = 1 << 19  # chunks are handed to threads in batches of about this size

Index = tuple[int, ...]


@njit()
def _fletcher32(data: NDArray[np.uint8]) -> int:
    words = data.size // 2
    sum1 = np.uint32(0)
    sum2 = np.uint32(0)
    start = 0
    while start < words:
        stop = min(start + 360, words)  # as many words as 32 bits hold without overflow
        for k in range(start, stop):
            sum1 += np.uint32((np.uint32(data[2 * k]) << np.uint32(8)) | np.uint32(data[2 * k + 1]))
            sum2 += sum1
        sum1 = (sum1 & np.uint32(0xFFFF)) + (sum1 >> np.uint32(16))
        sum2 = (sum2 & np.uint32(0xFFFF)) + (sum2 >> np.uint32(16))
        start = stop
    if data.size % 2:
        sum1 += np.uint32(data[data.size - 1]) << np.uint32(8)
        sum2 += sum1
        sum1 = (sum1 & np.uint32(0xFFFF)) + (sum1 >> np.uint32(16))
        sum2 = (sum2 & np.uint32(0xFFFF)) + (sum2 >> np.uint32(16))
    sum1 = (sum1 & np.uint32(0xFFFF)) + (sum1 >> np.uint32(16))
    sum2 = (sum2 & np.uint32(0xFFFF)) + (sum2 >> np.uint32(16))
    return int((sum2 << np.uint32(16)) | sum1)


@njit()
def _shuffle(data: NDArray[np.uint8], size: int, out: NDArray[np.uint8]) -> None:
    n = data.size // size
    for b in range(size):
        for k in range(n):
            out[b * n + k] = data[k * size + b]


@njit()
def _unshuffle(data: NDArray[np.uint8], size: int, out: NDArray[np.uint8]) -> None:
    n = data.size // size
    for b in range(size):
        for k in range(n):
            out[k * size + b] = data[b * n + k]


def fletcher32(data: bytes) -> int:
    """Return the checksum HDF5 keeps with a chunk: Fletcher's sums of big-endian 16-bit words.

    An odd last byte counts as the high byte of a word (HDF5 library, `H5_checksum_fletcher32`).
    """
    return int(_fletcher32(np.frombuffer(data, np.uint8)))


def encode_chunk(array: NDArray[Any], level: int = 1, filters: Sequence[str] = PIPELINE) -> bytes:
    """Return the bytes HDF5 stores for a chunk with these values.

    Parameters
    ----------
    array
        The whole chunk, any shape, of the dataset's dtype.
    level
        Level of deflate, 0 to 9.
    filters
        The dataset's filters in order, of ``shuffle``, ``deflate`` and ``fletcher32``.
    """
    contiguous = np.ascontiguousarray(array)
    data: Any = contiguous.reshape(-1).view(np.uint8)
    for name in filters:
        if name == "shuffle":
            if contiguous.itemsize > 1:
                shuffled = np.empty_like(data)
                _shuffle(data, contiguous.itemsize, shuffled)
                data = shuffled
        elif name == "deflate":
            data = zlib.compress(data, level)
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
        Those of the chunk.
    filter_mask
        Bit k set: filter k was left out for this chunk.
    filters
        The dataset's filters in order.
    where
        Names the chunk in an error.

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
            plain = np.empty(nbytes, np.uint8)
            _unshuffle(np.frombuffer(data, np.uint8), dtype.itemsize, plain)
            data = plain.data
    _check_size(data, nbytes, where)
    return np.frombuffer(data, dtype).reshape(tuple(shape))


def _verified(data: bytes, where: str) -> bytes:
    body, stored = data[:-4], int.from_bytes(data[-4:], "little")
    found = fletcher32(body)
    # HDF5 before 1.6.3 stored the bytes of each half swapped on little-endian machines; it still reads them.
    swapped = ((found & 0x00FF00FF) << 8) | (found >> 8 & 0x00FF00FF)
    if len(data) < 4 or stored not in (found, swapped):
        raise FileFormatError(
            expectation(where, f"checksum {stored:08x}", f"{found:08x}", "the file is damaged; copy it again")
        )
    return body


def _inflated(data: bytes, nbytes: int, where: str) -> bytes:
    stream = zlib.decompressobj()
    try:
        plain = stream.decompress(data, nbytes + 1)  # never more than the chunk declares
    except zlib.error as error:
        raise FileFormatError(
            expectation(where, "compressed data", f"damaged bytes ({error})", "the file is damaged; copy it again")
        ) from error
    return plain


def _check_size(data: Any, nbytes: int, where: str) -> None:
    if len(data) != nbytes:
        raise FileFormatError(
            expectation(where, f"{nbytes} bytes", f"{len(data)}", "the file is damaged; copy it again")
        )


def chunk_pipeline(dataset: Any) -> tuple[str, ...] | None:
    """Return the filters of an HDF5 dataset in order, or None where this module does not code its chunks.

    It does for chunks ``(1, 1, 1, nt, ns)`` over whole cutouts with any of shuffle, deflate and fletcher32.
    """
    if dataset.ndim != 5 or dataset.chunks != (1, 1, 1, *dataset.shape[3:]):
        return None
    plist = dataset.id.get_create_plist()
    names = [_FILTERS.get(plist.get_filter(k)[0]) for k in range(plist.get_nfilters())]
    return None if None in names else tuple(name for name in names if name)


def _check_plane_number(dataset: Any, z: int) -> None:
    if not 0 <= z < dataset.shape[0]:
        raise InputError(
            expectation("depth plane", f"0 to {dataset.shape[0] - 1}", z, "choose one of the file's planes")
        )


def _batch_size(dataset: Any) -> int:
    return max(1, _BATCH_BYTES // int(dataset.dtype.itemsize * dataset.shape[3] * dataset.shape[4]))


def _batches(items: Iterable[Any], count: int) -> Iterator[list[Any]]:
    iterator = iter(items)
    while batch := list(itertools.islice(iterator, count)):
        yield batch


def parallel_write(dataset: Any, z: int, plane: NDArray[Any], *, workers: int | None = None) -> int:
    """Write depth plane ``z`` of an H dataset, compressing in threads; return the bytes stored.

    Datasets that `chunk_pipeline` does not know are written through HDF5. At most a few batches of half a
    megabyte per worker are held besides the plane.

    Parameters
    ----------
    dataset
        Open h5py dataset ``(nz, ny, nx, nt, ns)``.
    z
        Depth plane.
    plane
        Its values ``(ny, nx, nt, ns)``, of a dtype that the dataset's holds without loss.
    workers
        Threads that compress; None takes every processor.

    Raises
    ------
    InputError
        If the plane has another shape, or a dtype that would lose values, or there is no plane ``z``.
    """
    _check_plane_number(dataset, z)
    dtype, shape = dataset.dtype, tuple(dataset.shape[1:])
    if plane.shape != shape or not np.can_cast(plane.dtype, dtype, "safe"):
        raise InputError(
            expectation(f"plane {z}", f"{shape} {dtype}", f"{plane.shape} {plane.dtype}", "convert it first")
        )
    filters = chunk_pipeline(dataset)
    if filters is None:
        before = dataset.id.get_storage_size()
        dataset[z] = plane
        return int(dataset.id.get_storage_size() - before)
    level = dataset.compression_opts if isinstance(dataset.compression_opts, int) else 1

    def encode(batch: list[tuple[int, int]]) -> list[tuple[int, int, bytes]]:
        return [(y, x, encode_chunk(plane[y, x].astype(dtype, copy=False), level, filters)) for y, x in batch]

    stored = 0
    batches = _batches(np.ndindex(*shape[:2]), _batch_size(dataset))
    for coded in _in_threads(encode, batches, worker_count(workers)):
        for y, x, raw in coded:
            dataset.id.write_direct_chunk((z, y, x, 0, 0), raw)
            stored += len(raw)
    return stored


def parallel_read(dataset: Any, z: int, *, out: NDArray[Any] | None = None, workers: int | None = None) -> NDArray[Any]:
    """Return depth plane ``z`` of an H dataset, ``(ny, nx, nt, ns)``, decompressed in threads.

    Datasets that are stored otherwise are read through HDF5. Chunks that were never written hold the fill value.

    Parameters
    ----------
    dataset
        Open h5py dataset ``(nz, ny, nx, nt, ns)``.
    z
        Depth plane.
    out
        Array to fill, ``(ny, nx, nt, ns)``.
    workers
        Threads that decompress; None takes every processor.

    Raises
    ------
    FileFormatError
        If a chunk is damaged; it is named.
    """
    _check_plane_number(dataset, z)
    ny, nx, nt, ns = dataset.shape[1:]
    plane = np.empty((ny, nx, nt, ns), dataset.dtype) if out is None else out
    filters = chunk_pipeline(dataset)
    if filters is None:
        plane[...] = dataset[z]
        return plane
    dtype, where = dataset.dtype, f"{dataset.file.filename}:{dataset.name}"

    def decode(batch: list[tuple[int, int, tuple[int, bytes] | None]]) -> None:
        for y, x, stored in batch:
            if stored is None:
                plane[y, x] = dataset.fillvalue
            else:
                name = f"{where} chunk (z={z}, y={y}, x={x})"
                plane[y, x] = decode_chunk(stored[1], dtype, (nt, ns), stored[0], filters, where=name)

    stored = ((y, x, _stored_chunk(dataset, (z, y, x), where)) for y in range(ny) for x in range(nx))
    for _ in _in_threads(decode, _batches(stored, _batch_size(dataset)), worker_count(workers)):
        pass
    return plane


def _stored_chunk(dataset: Any, index: Index, where: str) -> tuple[int, bytes] | None:
    offset = (*index, 0, 0)
    try:
        if dataset.id.get_chunk_info_by_coord(offset).byte_offset is None:
            return None  # asked first: h5py reads a size for it that was never set
        mask, raw = dataset.id.read_direct_chunk(offset)
    except (OSError, RuntimeError, ValueError) as error:
        raise FileFormatError(
            expectation(f"{where} chunk {index}", "a readable chunk", str(error), "the file is damaged; copy it again")
        ) from error
    return mask, raw


def _in_threads(function: Any, batches: Iterator[Any], workers: int) -> Iterator[Any]:
    """Yield ``function(batch)`` in order, at most two batches per worker ahead."""
    pending: deque[Future[Any]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for batch in batches:
                pending.append(pool.submit(function, batch))
                if len(pending) > 2 * workers:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()
