"""Pixel formats of GenICam cameras, and the samples in their buffers.

Names and layouts follow the GenICam Pixel Format Naming Convention (PFNC). Formats such as ``Mono12p`` are one
stream of bits, least significant first. ``Mono12Packed`` is the older layout of GigE Vision: two pixels in three
bytes. The outer bytes contain the high bits of one pixel each. The middle byte contains the low bits of the first
pixel, and above them the low bits of the second.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError

__all__ = ["PixelFormat"]

NAME = re.compile(r"(?:Mono|Bayer(?:GR|RG|GB|BG))(?:(8|10|12|14|16)|(10|12)p|(10|12)packed)", re.IGNORECASE)
SUPPORTED = "Mono or Bayer (GR, RG, GB, BG), with 8, 10, 12, 14, 16, 10p, 12p, 10Packed or 12Packed"


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """Layout of the samples of a frame in its buffer.

    Attributes
    ----------
    name
        Name in the PFNC, such as ``"BayerRG12p"``.
    bits
        Bits per sample.
    stored_bits
        Bits per pixel in the buffer, from the PFNC number of the format.
    group
        Number of pixels and of bytes after which the layout repeats; (1, 1) or (1, 2) if samples are not packed.
    legacy
        Whether the format has the older packing of GigE Vision.
    """

    name: str
    bits: int
    stored_bits: int
    group: tuple[int, int]
    legacy: bool = False

    @classmethod
    def named(cls, name: str, camera: str) -> PixelFormat:
        """Return the format ``name`` of ``camera``; raises `InputError` if it is not supported."""
        match = NAME.fullmatch(name)
        if match is None:
            raise InputError.expected(
                f"pixel format of {camera}", SUPPORTED, name, "set the device option format to one of these"
            )
        plain, stream, legacy = (int(bits or 0) for bits in match.groups())
        if plain:
            size = 1 if plain == 8 else 2
            return cls(name, plain, 8 * size, (1, size))
        if legacy:
            return cls(name, legacy, 12, (2, 3), legacy=True)
        return cls(name, stream, stream, (4, 5) if stream == 10 else (2, 3))

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the samples: uint8 or uint16."""
        return np.dtype(np.uint8 if self.bits == 8 else np.uint16)

    def samples(self, data: NDArray[np.uint8], shape: tuple[int, int], padding: int = 0) -> NDArray[Any]:
        """Decode ``data``, the bytes of a buffer, into a new array of samples of ``shape`` (rows, columns).

        A line of packed pixels may begin in the middle of a byte. Lines begin at a new byte if ``padding`` bytes
        follow each line, or if the buffer has the size of such lines.

        Raises
        ------
        ValueError
            If the buffer is too short; the message gives both sizes.
        """
        rows, columns = shape
        line = -(-columns * self.stored_bits // 8)
        stream = -(-rows * columns * self.stored_bits // 8)
        # the buffer may contain all bytes of an incomplete last group
        lengths = (line, -(-columns // self.group[0]) * self.group[1])
        filled = next((n for n in lengths if len(data) == rows * n != stream), 0)
        step = line + padding if padding else filled
        needed = (rows - 1) * step + line if step else stream
        if len(data) < needed:
            raise ValueError(f"expected {needed} bytes of {self.name} for {rows} x {columns} pixels, got {len(data)}")
        if not step:
            return self._unpacked(data[None, :stream], rows * columns).reshape(shape)
        lines = np.lib.stride_tricks.as_strided(data, (rows, line), (step, 1), writeable=False)
        return self._unpacked(lines, columns)

    def _unpacked(self, lines: NDArray[np.uint8], count: int) -> NDArray[Any]:
        """Return ``count`` samples of each line of bytes, a new array."""
        pixels, size = self.group
        if pixels == 1:
            return np.ascontiguousarray(lines).view(self.dtype.newbyteorder("<")).astype(self.dtype)
        groups, left = divmod(count, pixels)
        out = np.empty((len(lines), count), np.uint16)
        whole = lines[:, : groups * size].reshape(len(lines), groups, size)
        self._unpack(whole, out[:, : groups * pixels].reshape(len(lines), groups, pixels))
        if left:
            last = np.zeros((len(lines), 1, size), np.uint8)
            rest = lines[:, groups * size :]
            last[:, 0, : rest.shape[1]] = rest
            end = np.empty((len(lines), 1, pixels), np.uint16)
            self._unpack(last, end)
            out[:, groups * pixels :] = end[:, 0, :left]
        return out

    def _unpack(self, groups: NDArray[np.uint8], out: NDArray[np.uint16]) -> None:
        """Write the samples of ``groups`` (lines, groups, bytes) into ``out`` (lines, groups, pixels)."""
        mask = np.uint16((1 << self.bits) - 1)
        for k in range(out.shape[2]):
            if self.legacy:
                high, low, shift = groups[..., 2 * k], groups[..., 1] >> np.uint8(4 * k), self.bits - 8
                low = low & np.uint8((1 << shift) - 1)
                out[..., k] = high.astype(np.uint16) << np.uint16(shift) | low
                continue
            # a sample of 10 or 12 bits always spans two bytes
            first, shift = divmod(k * self.bits, 8)
            value = groups[..., first + 1].astype(np.uint16)
            value <<= np.uint16(8)
            value |= groups[..., first]
            value >>= np.uint16(shift)
            value &= mask
            out[..., k] = value
