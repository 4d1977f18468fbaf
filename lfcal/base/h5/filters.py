"""The filters of one HDF5 chunk: shuffle, deflate and fletcher32, as the HDF5 library defines them."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lfcal.base.compiled import njit
from lfcal.base.errors import FileFormatError

__all__ = ["PIPELINE", "decode_chunk", "encode_chunk", "fletcher32"]

PIPELINE = ("shuffle", "deflate", "fletcher32")
"""The filters of an H file, in the order in which they are applied on writing."""


@njit()
def _fletcher32(data: NDArray[np.uint8]) -> int:
    """Return sum2 << 16 | sum1: sum1 the sum of the words, sum2 that of all sum1 so far, both modulo 65535.

    A carry out of 16 bits is added back (65536 = 1 modulo 65535), by the block and twice more at the end, as the HDF5
    library does: 65535 is then never reduced to 0, and the bits are those it stores.
    """
    words = data.size // 2
    sum1 = np.uint32(0)
    sum2 = np.uint32(0)
    start = 0
    while start < words:
        stop = min(start + 360, words)  # as many words as sum2 holds in 32 bits without overflow
        for k in range(start, stop):
            sum1 += np.uint32((np.uint32(data[2 * k]) << np.uint32(8)) | np.uint32(data[2 * k + 1]))
            sum2 += sum1
        sum1 = (sum1 & np.uint32(0xFFFF)) + (sum1 >> np.uint32(16))
        sum2 = (sum2 & np.uint32(0xFFFF)) + (sum2 >> np.uint32(16))
        start = stop
    if data.size % 2:  # an odd last byte is the high one of a word
        sum1 += np.uint32(data[data.size - 1]) << np.uint32(8)
        sum2 += sum1
        sum1 = (sum1 & np.uint32(0xFFFF)) + (sum1 >> np.uint32(16))
        sum2 = (sum2 & np.uint32(0xFFFF)) + (sum2 >> np.uint32(16))
    sum1 = (sum1 & np.uint32(0xFFFF)) + (sum1 >> np.uint32(16))
    sum2 = (sum2 & np.uint32(0xFFFF)) + (sum2 >> np.uint32(16))
    return int((sum2 << np.uint32(16)) | sum1)


@njit()
def _shuffle(data: NDArray[np.uint8], size: int, out: NDArray[np.uint8]) -> None:
    """Write all first bytes of the values, then all second ones, ...: like bytes side by side compress better."""
    n = data.size // size
    for b in range(size):
        for k in range(n):
            out[b * n + k] = data[k * size + b]


@njit()
def _unshuffle(data: NDArray[np.uint8], size: int, out: NDArray[np.uint8]) -> None:
    """Undo `_shuffle` for values of ``size`` bytes."""
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
        pass  # zlib says what is wrong with it
    stream = zlib.decompressobj()
    try:
        plain = stream.decompress(data, nbytes + 1)  # never more than the chunk declares
    except zlib.error as error:
        raise FileFormatError.expected(
            where, "compressed data", f"damaged bytes ({error})", "the file is damaged; copy it again"
        ) from error
    return plain


def _check_size(data: Any, nbytes: int, where: str) -> None:
    if len(data) != nbytes:
        raise FileFormatError.expected(where, f"{nbytes} bytes", f"{len(data)}", "the file is damaged; copy it again")
