"""Compress and decompress HDF5 chunks outside of HDF5, so that several threads can work.

HDF5 runs its filters on one thread. Here, shuffle, deflate and fletcher32 run in worker threads (libdeflate and the
kernels release the GIL). Finished chunks are written through h5py, from the caller's thread; reading bypasses HDF5.
The files are ordinary HDF5 files.
"""

from __future__ import annotations

import itertools
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, worker_count
from lfcal.base.h5 import FILTER_NAMES, H5Data, encode_chunk

__all__ = ["chunk_pipeline", "copy_plane", "parallel_read", "parallel_write"]

_BATCH_BYTES = 1 << 19  # chunks are handed to threads in batches of about this size


def chunk_pipeline(dataset: Any) -> tuple[str, ...] | None:
    """Return the filters of an h5py dataset in order, or None if this module cannot compress its chunks.

    The module handles chunks ``(1, 1, 1, nt, ns)`` over whole cutouts with any of shuffle, deflate and fletcher32.
    """
    if not _one_pattern_each(dataset.shape, dataset.chunks):
        return None
    plist = dataset.id.get_create_plist()
    names = [FILTER_NAMES.get(plist.get_filter(k)[0]) for k in range(plist.get_nfilters())]
    return None if None in names else tuple(name for name in names if name)


def _one_pattern_each(shape: tuple[int, ...], chunks: tuple[int, ...] | None) -> bool:
    return len(shape) == 5 and chunks == (1, 1, 1, *shape[3:])


def _check_plane_number(dataset: Any, z: int) -> None:
    if not 0 <= z < dataset.shape[0]:
        raise InputError.expected(
            "depth plane", f"0 to {dataset.shape[0] - 1}", z, "choose one of the planes of the file"
        )


def _batch_size(dataset: Any) -> int:
    return max(1, _BATCH_BYTES // int(dataset.dtype.itemsize * dataset.shape[3] * dataset.shape[4]))


def _batches(items: Iterable[Any], count: int) -> Iterator[list[Any]]:
    iterator = iter(items)
    while batch := list(itertools.islice(iterator, count)):
        yield batch


def parallel_write(
    dataset: Any,
    z: int,
    plane: NDArray[Any],
    *,
    convert: Callable[[NDArray[Any]], NDArray[Any]] | None = None,
    checksums: NDArray[np.uint32] | None = None,
    workers: int | None = None,
) -> int:
    """Write depth plane ``z`` of an H dataset, compressing in threads; return the number of bytes stored.

    Datasets that `chunk_pipeline` does not handle are written through HDF5. In addition to the plane, at most a few
    batches of half a megabyte per worker are in memory.

    Parameters
    ----------
    dataset
        Open h5py dataset ``(nz, ny, nx, nt, ns)``.
    z
        Index of the depth plane.
    plane
        Values of the plane ``(ny, nx, nt, ns)``, in a dtype that converts to the dataset's dtype without loss.
    convert
        Function that converts a pattern to its stored form, called in the compressing threads. None: patterns are
        stored unchanged.
    checksums
        Array ``(ny, nx)`` to fill with the CRC-32 of every stored pattern, little-endian.
    workers
        Number of compressing threads. None: one for each available CPU core.

    Raises
    ------
    InputError
        If the plane has another shape, or a dtype that would lose values, or there is no plane ``z``.
    """
    _check_plane_number(dataset, z)
    dtype, shape = dataset.dtype, tuple(dataset.shape[1:])
    if plane.shape != shape or (convert is None and not np.can_cast(plane.dtype, dtype, "safe")):
        raise InputError.expected(
            f"plane {z}",
            f"{dtype} of shape {shape}",
            f"{plane.dtype} of shape {plane.shape}",
            "convert the plane to this shape and type first",
        )
    # little-endian on every machine, so that the checksum of a file does not depend on where it was written
    little = dtype.newbyteorder("<")

    def stored_pattern(y: int, x: int) -> NDArray[Any]:
        pattern = plane[y, x] if convert is None else convert(plane[y, x])
        pattern = np.ascontiguousarray(pattern, dtype)
        if checksums is not None:
            checksums[y, x] = zlib.crc32(pattern.astype(little, copy=False).data)
        return pattern

    filters = chunk_pipeline(dataset)
    if filters is None:
        before = dataset.id.get_storage_size()
        for y, x in np.ndindex(*shape[:2]):
            dataset[z, y, x] = stored_pattern(y, x)
        return int(dataset.id.get_storage_size() - before)
    level = dataset.compression_opts if isinstance(dataset.compression_opts, int) else 1

    def encode(batch: list[tuple[int, int]]) -> list[tuple[int, int, bytes]]:
        return [(y, x, encode_chunk(stored_pattern(y, x), level, filters)) for y, x in batch]

    stored = 0
    batches = _batches(np.ndindex(*shape[:2]), _batch_size(dataset))
    # HDF5 is called from one thread, in file order: only coding runs in parallel
    for coded in _in_threads(encode, batches, worker_count(workers)):
        for y, x, raw in coded:
            dataset.id.write_direct_chunk((z, y, x, 0, 0), raw)
            stored += len(raw)
    return stored


def parallel_read(data: H5Data, z: int, *, out: NDArray[Any] | None = None, workers: int | None = None) -> NDArray[Any]:
    """Return depth plane ``z`` of an H dataset, ``(ny, nx, nt, ns)``, decompressed in threads.

    Datasets stored in another way are read through HDF5. Chunks that were never written contain the fill value.

    Parameters
    ----------
    data
        Dataset ``(nz, ny, nx, nt, ns)``.
    z
        Index of the depth plane.
    out
        Array to fill, ``(ny, nx, nt, ns)``.
    workers
        Number of threads that decompress. None: one for each available CPU core.

    Raises
    ------
    FileFormatError
        If a chunk is damaged; the message names it.
    """
    _check_plane_number(data, z)
    ny, nx, nt, ns = data.shape[1:]
    plane = np.empty((ny, nx, nt, ns), data.dtype) if out is None else out
    table = data.table
    if table is None or table.filters is None or not _one_pattern_each(data.shape, data.chunks):
        plane[...] = data.read(z)
        return plane

    def decode(batch: list[tuple[int, ...]]) -> None:
        for y, x in batch:
            plane[y, x] = table.decoded((z, y, x, 0, 0))[0, 0, 0]

    for _ in _in_threads(decode, _batches(np.ndindex(ny, nx), _batch_size(data)), worker_count(workers)):
        pass
    return plane


def copy_plane(source: H5Data, dataset: Any, z: int) -> None:
    """Copy the encoded chunks of the only plane of ``source`` to plane ``z`` of an open h5py dataset.

    Raises
    ------
    InputError
        If the two datasets are not stored in the same way.
    """
    plist = dataset.id.get_create_plist()
    filters = tuple(int(plist.get_filter(k)[0]) for k in range(plist.get_nfilters()))
    theirs = (source.dtype, source.chunks, source.filters)
    if theirs != (dataset.dtype, tuple(dataset.chunks), filters) or source.table is None:
        raise InputError.expected(
            source.where, f"{dataset.dtype} values stored like the other planes", str(theirs), "write the plane again"
        )
    places = [(0, y, x, 0, 0) for y, x in np.ndindex(*source.shape[1:3])]
    write = dataset.id.write_direct_chunk
    for (_, y, x, t, s), left_out, stored in source.table.each_stored(places):
        write((z, y, x, t, s), stored, left_out)


def _in_threads(function: Any, batches: Iterator[Any], workers: int) -> Iterator[Any]:
    """Yield ``function(batch)`` in order, at most two batches per worker ahead; one worker is the caller's thread."""
    if workers == 1:
        yield from map(function, batches)
        return
    pending: deque[Future[Any]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for batch in batches:
                pending.append(pool.submit(function, batch))
                # a full pool waits here, which limits the memory used by compressed chunks
                if len(pending) > 2 * workers:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            # a fault in one batch, or a caller that stops early, must not wait for all the others
            for future in pending:
                future.cancel()
