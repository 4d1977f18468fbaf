"""Left-aligned samples, such as a camera's 12 bits in the upper bits of 16."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, Region, StorageError, check_number, format_count
from lfcal.frames.source import FrameMetadata, Frames, FrameSource, Samples
from lfcal.frames.view import SourceView

__all__ = ["ShiftedSource", "chosen_shift", "find_shift", "shifted"]

SAMPLED_FRAMES = 6
"""Number of frames from which the alignment of samples is found."""
MIN_VALUES = 16
"""Number of different values that a frame needs to show the alignment."""


def find_shift(source: FrameSource) -> int:
    """Return the number of bits by which the samples of ``source`` are left-aligned; 0 if they are not.

    Up to six frames, evenly spread over the source, are read completely. The result is the number of low bits
    that are 0 in all their samples. Unreadable frames, and those with few different values, are ignored.

    Raises
    ------
    InputError
        If the number of bits differs between frames.
    """
    if source.dtype.kind not in "iu" or not len(source):
        return 0
    found: dict[int, str] = {}
    for index in sorted({round(k) for k in np.linspace(0, len(source) - 1, SAMPLED_FRAMES)}):
        try:
            values = source.read(index)
        except (FileFormatError, StorageError):
            continue  # a damaged frame is refused or left out later, when all frames are read
        used = int(np.bitwise_or.reduce(values, axis=None))
        # a few different values, as in a dark frame, may be even by chance
        if used and len(np.unique(values[:: max(1, values.shape[0] // 512)])) >= MIN_VALUES:
            found.setdefault((used & -used).bit_length() - 1, source.info(index).label)
    if len(found) > 1:
        (least, one), *_, (most, other) = sorted(found.items())
        raise InputError.expected(
            "alignment of the samples",
            "the same in all frames",
            f"{format_count(least, 'unused low bit', 'unused low bits')} in {one} and {most} in {other}",
            "record all frames with the same camera settings",
        )
    return next(iter(found), 0)


def chosen_shift(text: str, source: FrameSource) -> tuple[int, str]:
    """Return the number of bits by which samples must be shifted right, and a note or ``""``.

    The number is that in ``text`` or, for ``"auto"``, the result of `find_shift`. With ``"0"``, the note warns if the
    samples appear to be left-aligned.

    Raises
    ------
    InputError
        If ``text`` is neither an integer nor ``"auto"``, or if `find_shift` raises it with ``"auto"``.
    """
    if text != "auto":
        try:
            bits = int(text)
        except ValueError:
            raise InputError.expected(
                "shift", "auto or a number of bits", repr(text), "write auto or a whole number"
            ) from None
        try:
            found = 0 if bits else find_shift(source)
        except InputError as error:
            return bits, f"samples: {error}"
        return bits, f"samples: all are multiples of {1 << found}; shift them down (--shift auto)" if found else ""
    bits = find_shift(source)
    width = 8 * source.dtype.itemsize
    words = f"left-aligned, shifted down to {width - bits} bits" if bits else "not left-aligned, not shifted"
    return bits, f"samples: {words}"


def shifted(values: NDArray[Any], bits: int, what: str) -> NDArray[Any]:
    """Return integer ``values`` shifted right by ``bits``; ``what`` is their name in error messages.

    Raises
    ------
    InputError
        If the values are not integers, or the dropped bits are not zero.
    """
    if values.dtype.kind not in "iu":
        raise InputError.expected(f"{what}, samples to shift", "integers", values.dtype, "leave the shift out")
    if np.any(values & values.dtype.type((1 << bits) - 1)):
        wanted = f"samples with {format_count(bits, 'unused low bit', 'unused low bits')}"
        got = "samples that use it" if bits == 1 else "samples that use them"
        raise InputError.expected(what, wanted, got, "correct the shift, or leave it out")
    moved: NDArray[Any] = values >> values.dtype.type(bits)
    return moved


class ShiftedSource(SourceView):
    """View of a source whose left-aligned samples are shifted right by ``bits`` to the values of the camera's ADC.

    The shift is 1 … 15 bits.
    """

    def __init__(self, source: FrameSource, bits: int) -> None:
        super().__init__(source)
        check_number("shift of the samples (bits)", bits, at_least=1, at_most=15, integer=True)
        self.bits = bits

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return the metadata ``known`` with the shift, and with bit depth, levels and noise adapted to it."""
        width, unit = 8 * self.source.dtype.itemsize, 1 << self.bits
        bit_depth = min(known.bit_depth or width, width) - self.bits
        black = known.black_level
        return replace(
            known,
            bit_depth=bit_depth,
            saturation=float((1 << bit_depth) - 1) if known.saturation is None else known.saturation / unit,
            black_level=tuple(n / unit for n in black) if isinstance(black, tuple) else black and black / unit,
            noise=None if known.noise is None else known.noise.scaled(0.5**self.bits),
            shift=self.bits,
        )

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index``, or only the part of it in ``region``, with samples shifted right."""
        return shifted(self.source.read(index, region), self.bits, self.info(index).label)

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the samples of frame ``index``, or of the part of it in ``region``, shifted right."""
        return Frames.samples(self, index, region)
