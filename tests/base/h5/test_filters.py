"""The filters of a chunk are those of the HDF5 library, and find damage."""

from __future__ import annotations

import zlib

import numpy as np
import pytest

from lfcal.base.errors import FileFormatError
from lfcal.base.h5.filters import decode_chunk, encode_chunk, fletcher32


def sample(shape: tuple[int, ...]) -> np.ndarray:
    return np.floor(np.random.default_rng(0).random(shape) ** 4 * 250).astype("f4")


def plain_fletcher32(data: bytes) -> int:
    """Return the closed form: sums modulo 65535 of big-endian words, where a non-zero sum is never 0."""
    padded = data + b"\0" * (len(data) % 2)
    words = [int.from_bytes(padded[k : k + 2], "big") for k in range(0, len(padded), 2)]
    first = sum(words)
    second = sum((len(words) - k) * word for k, word in enumerate(words))
    one, two = (v % 65535 or (65535 if v else 0) for v in (first, second))
    return two << 16 | one


@pytest.mark.parametrize("length", [0, 1, 2, 3, 7, 719, 720, 721, 722, 5001, 100_003])
def test_fletcher32_equals_its_closed_form(length: int) -> None:
    data = np.random.default_rng(length).integers(0, 256, length, dtype=np.uint8).tobytes()
    assert fletcher32(data) == plain_fletcher32(data)
    assert fletcher32(b"\xff" * length) == plain_fletcher32(b"\xff" * length)


@pytest.mark.parametrize("position", [0, 7, -1])
def test_every_byte_counts(position: int) -> None:
    raw = bytearray(encode_chunk(sample((9, 7))))
    raw[position] ^= 1
    with pytest.raises(FileFormatError):
        decode_chunk(bytes(raw), "f4", (9, 7))


def test_damage_without_a_checksum() -> None:
    filters = ("shuffle", "deflate")
    array = sample((9, 7))
    raw = encode_chunk(array, filters=filters)
    with pytest.raises(FileFormatError, match="expected 252 bytes"):
        decode_chunk(raw[:-20], "f4", (9, 7), filters=filters)
    with pytest.raises(FileFormatError, match="damaged bytes"):
        decode_chunk(b"\0" + raw, "f4", (9, 7), filters=filters)
    bomb = zlib.compress(bytes(10_000_000))
    with pytest.raises(FileFormatError, match="expected 252 bytes, got 253"):
        decode_chunk(bomb, "f4", (9, 7), filters=filters)
    with pytest.raises(FileFormatError, match="checksum"):
        decode_chunk(b"ab", "f4", (9, 7), filters=("fletcher32",))


def test_swapped_checksums_of_old_files_are_read() -> None:
    array = sample((9, 7))
    raw = encode_chunk(array)
    a, b, c, d = raw[-4:]
    assert np.array_equal(decode_chunk(raw[:-4] + bytes((b, a, d, c)), "f4", (9, 7)), array)
    with pytest.raises(FileFormatError):
        decode_chunk(raw[:-4] + bytes((d, c, b, a)), "f4", (9, 7))
