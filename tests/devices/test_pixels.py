"""Samples of GenICam pixel formats, packed and not, against an unpacker that goes bit by bit."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.devices.backends._pixels import PixelFormat

MOSAICS = ("Mono", "BayerGR", "BayerRG", "BayerGB", "BayerBG")
PACKED = ("10p", "12p", "10Packed", "12Packed")
SHAPES = ((6, 8), (5, 7), (9, 5), (4, 13), (7, 6), (1, 1), (1, 9), (8, 1))
"""Rows and columns: whole groups, odd widths, and widths of 4n + 2 pixels, which end within a byte in 10 bits."""


def bit_places(layout: str, pixel: int) -> list[int]:
    """Return where the bits of a pixel lie in the buffer, the lowest first, counted from bit 0 of byte 0."""
    bits = int(layout[:2])
    if layout.endswith("p"):
        return [pixel * bits + k for k in range(bits)]
    first, second = 24 * (pixel // 2), pixel % 2
    low = [first + 8 + 4 * second + k for k in range(bits - 8)]
    return low + [first + 16 * second + k for k in range(8)]


def packed(samples: NDArray[np.uint16], layout: str) -> bytearray:
    """Return one stream of samples in a buffer."""
    places = [bit_places(layout, k) for k in range(samples.size)]
    out = bytearray(max(max(bits) for bits in places) // 8 + 1)
    for value, bits in zip(samples.ravel().tolist(), places, strict=True):
        for k, place in enumerate(bits):
            out[place // 8] |= (value >> k & 1) << place % 8
    return out


def frame(layout: str, shape: tuple[int, int]) -> NDArray[np.uint16]:
    bits = int(layout[:2])
    rng = np.random.default_rng((bits, *shape))
    return rng.integers(0, 1 << bits, shape).astype(np.uint16)


def as_array(data: bytes | bytearray) -> NDArray[np.uint8]:
    return np.frombuffer(bytes(data), np.uint8)


@pytest.mark.parametrize("layout", PACKED)
def test_lines_are_unpacked_exactly_as_one_stream_or_with_bytes_of_their_own(layout: str) -> None:
    for shape in SHAPES:
        expected = frame(layout, shape)
        data = as_array(packed(expected, layout))
        for mosaic in MOSAICS:
            found = PixelFormat.named(mosaic + layout, "camera").samples(data, shape)
            assert found.dtype == np.uint16
            np.testing.assert_array_equal(found, expected, err_msg=f"{mosaic} {shape}")
        form, lines = PixelFormat.named(f"Mono{layout}", "camera"), [packed(row, layout) for row in expected]
        for padding in (0, 1, 6):
            data = as_array(b"".join(bytes(line) + b"\xa5" * padding for line in lines))
            data = data[: len(data) - padding]  # nothing needs to follow the last line
            np.testing.assert_array_equal(form.samples(data, shape, padding), expected, err_msg=f"{padding} {shape}")
    # lines filled up to whole groups are known by the size of the buffer
    shape, size = (6, 7), 5 if layout == "10p" else 3
    expected = frame(layout, shape)
    lines = [bytes(packed(row, layout)) for row in expected]
    data = as_array(b"".join(line + bytes(-len(line) % size) for line in lines))
    np.testing.assert_array_equal(form.samples(data, shape), expected)


def test_known_bytes_give_the_pixels_that_makers_document() -> None:
    known = {
        "Mono12Packed": (b"\xab\x3c\x12", (0xABC, 0x123)),
        "BayerRG12p": (b"\xbc\x3a\x12", (0xABC, 0x123)),
        "Mono10Packed": (b"\xaa\x21\xff", (0x2A9, 0x3FE)),
        "BayerGB10p": (b"\xff\x03\x00\xff\x03", (0x3FF, 0, 0x3F0, 0x00F)),
    }
    for name, (data, pixels) in known.items():
        form = PixelFormat.named(name, "camera")
        assert form.samples(as_array(data), (1, len(pixels))).tolist() == [list(pixels)], name


def test_samples_that_are_not_packed_lose_their_padding() -> None:
    for bits in (8, 10, 12, 14, 16):
        form = PixelFormat.named(f"BayerBG{bits}", "camera")
        expected = np.random.default_rng(bits).integers(0, 1 << bits, (3, 5)).astype(form.dtype)
        plain = np.ascontiguousarray(expected).astype(form.dtype.newbyteorder("<")).tobytes()
        np.testing.assert_array_equal(form.samples(as_array(plain), (3, 5)), expected)
        size = len(plain) // 3
        padded = b"".join(plain[size * k : size * (k + 1)] + b"\xff\xff\xff" for k in range(3))
        np.testing.assert_array_equal(form.samples(as_array(padded), (3, 5), 3), expected)


def test_samples_are_a_new_array() -> None:
    for name in ("Mono8", "Mono16", "Mono12p", "Mono12Packed"):
        data = np.zeros(48, np.uint8)
        found = PixelFormat.named(name, "camera").samples(data, (4, 6))
        data[:] = 255
        assert not found.any(), name


def test_a_buffer_that_is_too_short_is_named_with_both_sizes() -> None:
    for layout in ("8", "16", *PACKED):
        form = PixelFormat.named(f"Mono{layout}", "camera")
        needed = -(-35 * form.stored_bits // 8)
        words = f"expected {needed} bytes of Mono{layout} for 5 x 7 pixels, got {needed - 1}"
        with pytest.raises(ValueError, match=words):
            form.samples(np.zeros(needed - 1, np.uint8), (5, 7))


def test_bit_depth_follows_the_format_and_others_are_refused_with_the_supported_ones() -> None:
    for name, *bits in (("Mono8", 8, 8), ("Mono14", 14, 16), ("BayerGR10p", 10, 10), ("Mono10Packed", 10, 12)):
        form = PixelFormat.named(name, "camera")
        assert [form.bits, form.stored_bits] == bits
    words = r"Cam 7: expected Mono or Bayer .* 10p, 12p, .*12Packed, got .*; set the device"
    for name in ("RGB8", "YUV422_8", "Mono1p", "Mono32", "Mono14p", "BayerXY8", "Mono12c3a32p", ""):
        with pytest.raises(InputError, match=words):
            PixelFormat.named(name, "Cam 7")
